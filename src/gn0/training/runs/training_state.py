"""The whole state of a training run on disk: all of it or nothing, the last two kept.

A state is a folder: `model/` is a checkpoint as `save_checkpoint` writes it, beside it lie
averaged weights, the optimiser's states, generators and other tensors as safetensors, and
`state.json`, which is written last and states size and SHA-256 of every file.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from gn0.config import load_json
from gn0.errors import CheckpointError, FormatError, StorageError, brief
from gn0.policies.bae.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from gn0.policies.bae.shard_file import count_bytes, write_shards
from gn0.policies.qwen.weights import MANIFEST
from gn0.seeds import load_stream, save_stream
from gn0.storage import folder_atomic, plain_path, storage_error
from gn0.training.runs.optimiser_state import OptimiserState
from gn0.training.runs.state_file import (
    FileFacts,
    OptimiserFacts,
    StateFile,
    TrainingCounters,
    check_files,
    list_files,
    read_state_file,
    sync_file,
    sync_folder,
    write_state_file,
)
from gn0.training.runs.state_folder import (
    STATE,
    find_latest,
    keep_last_states,
    list_states,
    name_state,
    read_step,
)

SHARD_MB = 2000
MODEL = "model"
_AVERAGED, _OPTIMISER, _GENERATORS, _ARRAYS = "averaged", "optimiser", "generators", "arrays"
_SPARE = 16 << 20  # bytes beside the tensors: tokenizer, JSON, the file system's own


@dataclass(frozen=True)
class TrainingState:
    """All that a run needs to go on as if it had never stopped.

    Attributes:
        checkpoint: model and tokenizer, as `load_checkpoint` gives them, or of another kind that
            has a `model`; it may be on a card and in training.
        counters: how far it has come.
        recipe: as `describe_recipe` gives it.
        corpus: hash of what it learns from.
        device: what it runs on, as `name_device` says it.
        averaged: exponential means of the weights, by the weights' names; may be empty.
        optimiser: None where it was left behind; a run then begins with re-warming.
        generators: of torch, as `capture_generators` gives them.
        streams: named streams of numpy.
        source: where the source of samples stands; anything that JSON holds.
        arrays: other tensors, such as an auxiliary head's weights.
        versions: of the packages that wrote it; filled in on saving.
    """

    checkpoint: Any
    counters: TrainingCounters
    recipe: Mapping[str, Any]
    corpus: str
    device: str
    averaged: Mapping[str, Tensor] = field(default_factory=dict)
    optimiser: OptimiserState | None = None
    generators: Mapping[str, Tensor] = field(default_factory=dict)
    streams: Mapping[str, np.random.Generator] = field(default_factory=dict)
    source: Any = None
    arrays: Mapping[str, Tensor] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)


def name_device(device: torch.device | str) -> str:
    """A device as a state remembers it: "cpu, 2 threads", or the card's name."""
    device = torch.device(device)
    if device.type == "cuda":
        return str(torch.cuda.get_device_name(device))
    return f"{device.type}, {torch.get_num_threads()} threads"


def save_state(
    folder: Path | str,
    state: TrainingState,
    *,
    keep: int = 2,
    shard_mb: int = SHARD_MB,
    without_optimiser: bool = False,
    without_model: bool = False,
    dtype: torch.dtype = torch.float32,
    beside: Callable[[Path], None] | None = None,
    write: Callable[..., None] = save_checkpoint,
) -> Path:
    """Write a state as FOLDER/step-NNNNNNNNN, all of it or nothing; then remove the oldest.

    Killed at any moment, the folder holds this state or the one before.

    Args:
        folder: of the run's states; made where it is not there.
        state: what to write.
        keep: how many states stay.
        shard_mb: bytes of a file at most, in 10⁶; a single array may be larger.
        without_optimiser: leave the optimiser's states behind, two thirds of the bytes or more.
        without_model: leave the model out: its weights are frozen, and what learns is in `arrays`.
        dtype: of model and averaged weights; another than float32 is not exact.
        beside: writes more files into the folder of the model, such as its prompt.
        write: writes the checkpoint, as `save_checkpoint` does with Qwen3-VL's.

    Returns:
        The folder of the state.

    Raises:
        StorageError: the disk is full or refuses, or states of later steps are there.
        CheckpointError: the source is nothing that JSON holds.
    """
    folder, step = plain_path(folder), state.counters.step
    if keep < 1:
        raise CheckpointError("no state would be kept", remedy="keep 1 or more")
    ahead = [path.name for path in list_states(folder) if read_step(path) > step]
    if ahead:
        raise StorageError(
            f"{ahead[-1]} is there, a state of a later step than {step}",
            where=folder,
            remedy="resume from it, or give it up: discard_states_after",
        )
    optimiser = None if without_optimiser else state.optimiser
    _check_room(folder, state, optimiser, dtype, without_model)
    out = folder / name_state(step)
    limit = shard_mb * 1_000_000
    try:
        with folder_atomic(out, overwrite=True, marker=STATE) as made:
            hashes: dict[str, str] = {}
            if not without_model:
                write(made / MODEL, state.checkpoint, shard_mb=shard_mb, dtype=dtype)
                if beside is not None:
                    beside(made / MODEL)
                stated = load_json(made / MODEL / MANIFEST, dict[str, str])
                hashes = {f"{MODEL}/{name}": value for name, value in stated.items()}
            for name, arrays, kind in (
                (_AVERAGED, state.averaged, dtype),
                (_OPTIMISER, optimiser.arrays if optimiser else {}, None),
                (_GENERATORS, state.generators, None),
                (_ARRAYS, state.arrays, None),
            ):
                if arrays:
                    hashes |= write_shards(made, name, arrays.items(), limit, kind)[0]
            facts = {name: sync_file(made, name, hashes.get(name)) for name in list_files(made)}
            write_state_file(made, _describe(state, optimiser, dtype, facts))
            if not without_model:
                sync_folder(made / MODEL)
            sync_folder(made)
    except OSError as error:
        raise storage_error(error, out, "write") from error
    except StorageError:
        raise
    except Exception as error:  # the tokenizer's writer has no error of its own for a full disk
        if "os error" in str(error) or isinstance(error, SafetensorError):
            raise StorageError(
                f"cannot write: {brief(str(error))}",
                where=out,
                remedy="free some space or choose another --out",
            ) from error
        raise
    keep_last_states(folder, keep)
    return out


def load_state(
    folder: Path | str,
    load: Callable[..., Any] = load_checkpoint,
    *,
    base: Callable[[], Checkpoint] | None = None,
) -> TrainingState:
    """Load a state, the model on the CPU and in evaluation mode; every byte is checked first.

    Args:
        folder: of a state, or of a run's states: the last one.
        load: loads the checkpoint, as `load_checkpoint` does with Qwen3-VL's.
        base: loads the model of states that were saved without theirs.

    Raises:
        CheckpointError: there is none, it has no model and there is no `base`, or it is
            half-written, altered or of another kind.
        StorageError: the system refuses.
    """
    folder = plain_path(folder)
    if not (folder / STATE).is_file():
        latest = find_latest(folder)
        if latest is None:
            raise CheckpointError(
                f"no state of a training run: there is no {STATE}",
                where=folder,
                remedy="give the folder of a run's checkpoints, or of one of them",
            )
        folder = latest
    try:
        file = read_state_file(folder)
        check_files(folder, file.files)
        return _build_state(folder, file, load, base)
    except CheckpointError as error:
        raise _with_fellow(error, folder) from None
    except OSError as error:
        raise storage_error(error, folder, "read") from error


def measure_state(folder: Path) -> int:
    """Bytes of a state's files.

    Raises:
        StorageError: the system refuses.
    """
    try:
        return sum((folder / name).stat().st_size for name in [*list_files(folder), STATE])
    except OSError as error:
        raise storage_error(error, folder, "read") from error


def list_versions() -> dict[str, str]:
    """Versions of the packages on which a run's numbers depend."""
    return {name: metadata.version(name) for name in ("gn0", "numpy", "torch", "transformers")}


def _check_room(
    folder: Path,
    state: TrainingState,
    optimiser: OptimiserState | None,
    dtype: torch.dtype,
    without_model: bool,
) -> None:
    model = [] if without_model else state.checkpoint.model.parameters()
    weights = [*model, *state.averaged.values()]
    others = [*state.arrays.values(), *(optimiser.arrays.values() if optimiser else ())]
    needed = _SPARE + sum(one.numel() for one in weights) * dtype.itemsize
    needed += sum(count_bytes(one) for one in others)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise storage_error(error, folder, "write") from error
    if free < needed:
        raise StorageError(
            f"a checkpoint takes {needed / 1e6:,.0f} MB, {free / 1e6:,.0f} MB are free",
            where=folder,
            remedy="free some space, choose another --out, or leave the optimiser behind "
            "(--drop-optimiser); "
            "the checkpoints that are there are whole",
        )


def _describe(
    state: TrainingState,
    optimiser: OptimiserState | None,
    dtype: torch.dtype,
    files: dict[str, FileFacts],
) -> StateFile:
    groups = [dict(group) for group in optimiser.groups] if optimiser else []
    return StateFile(
        counters=state.counters,
        recipe=dict(state.recipe),
        corpus=state.corpus,
        device=state.device,
        dtype=str(dtype).removeprefix("torch."),
        versions=list_versions(),
        streams={name: save_stream(stream) for name, stream in state.streams.items()},
        source=state.source,
        optimiser=OptimiserFacts(kind=optimiser.kind, groups=groups) if optimiser else None,
        files=files,
    )


def _build_state(
    folder: Path,
    file: StateFile,
    load: Callable[..., Any],
    base: Callable[[], Checkpoint] | None,
) -> TrainingState:
    dtype = getattr(torch, file.dtype, None)
    if not isinstance(dtype, torch.dtype):
        raise CheckpointError(f"no type of numbers is called {brief(file.dtype)}", where=folder)
    found = {
        name: dict(_load_arrays(folder, name, file.files))
        for name in (_AVERAGED, _OPTIMISER, _GENERATORS, _ARRAYS)
    }
    try:
        streams = {name: load_stream(text) for name, text in file.streams.items()}
    except FormatError as error:
        raise CheckpointError(f"a stream of random numbers: {error}", where=folder) from None
    optimiser = None
    if file.optimiser is not None:
        groups = tuple(file.optimiser.groups)
        optimiser = OptimiserState(file.optimiser.kind, groups, found[_OPTIMISER])
    if (folder / MODEL).is_dir():
        checkpoint = load(folder / MODEL, dtype=dtype)
    elif base is not None:
        checkpoint = base()
    else:
        raise CheckpointError(
            "a state of adapters, without the model that they belong to",
            where=folder,
            remedy="go on with the command that wrote it: it names the model",
        )
    return TrainingState(
        checkpoint=checkpoint,
        counters=file.counters,
        recipe=file.recipe,
        corpus=file.corpus,
        device=file.device,
        averaged=found[_AVERAGED],
        optimiser=optimiser,
        generators=found[_GENERATORS],
        streams=streams,
        source=file.source,
        arrays=found[_ARRAYS],
        versions=file.versions,
    )


def _load_arrays(
    folder: Path, kind: str, files: Mapping[str, FileFacts]
) -> Iterator[tuple[str, Tensor]]:
    for name in sorted(files):
        if "/" not in name and name.startswith((f"{kind}.", f"{kind}-")):
            try:
                yield from load_file(folder / name).items()
            except SafetensorError as error:
                raise CheckpointError(brief(str(error)), where=folder / name) from None


def _with_fellow(error: CheckpointError, folder: Path) -> CheckpointError:
    """The error, with the state before as what to do where one is there."""
    before = [path for path in list_states(folder.parent) if path.name < folder.name]
    remedy = error.remedy or "it was altered or half-copied"
    if before:
        remedy += f"; the state before is {before[-1]}"
    return CheckpointError(error.what, where=error.where, remedy=remedy)
