"""Checkpoints of recurrent baselines: safetensors, `cma.json`, `tokenizer.json`; no pickle."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import msgspec
import torch

from gn0.errors import CheckpointError, FormatError, StorageError, brief
from gn0.policies.bae.shard_file import write_shards
from gn0.policies.bae.tokenizer_file import LIMIT, load_tokenizer
from gn0.policies.cma.cma_settings import FILE, CmaSettings, load_cma_settings
from gn0.policies.cma.efficientnet_lite import EfficientNetLite0, fill_efficientnet
from gn0.policies.cma.recurrent import RecurrentNet
from gn0.policies.qwen.weights import MANIFEST, SINGLE, open_weights
from gn0.storage import folder_atomic, plain_path, read_bytes, write_bytes, write_json

TOKENIZER = "tokenizer.json"


@dataclass(frozen=True, eq=False)
class CmaCheckpoint:
    """A recurrent baseline with its tokenizer.

    Attributes:
        model: the net.
        tokenizer: the bytes of its `tokenizer.json`.
    """

    model: RecurrentNet
    tokenizer: bytes

    @property
    def settings(self) -> CmaSettings:
        """What it is, and what it is shown."""
        return self.model.settings


def build_net(settings: CmaSettings, seed: int) -> RecurrentNet:
    """A net of random weights; the same for the same seed. A frozen encoder has its own.

    Raises:
        ConfigError, CheckpointError, StorageError: as `fill_efficientnet`, where it has one.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed % 2**63)
        net = RecurrentNet(settings)
    for part in net.modules():
        if isinstance(part, EfficientNetLite0):
            fill_efficientnet(part)
    return net


def save_cma_checkpoint(
    folder: Path | str,
    checkpoint: CmaCheckpoint,
    *,
    shard_mb: int = 2000,
    dtype: torch.dtype = torch.float32,
    overwrite: bool = False,
) -> None:
    """Write a folder; all of it or nothing.

    Args:
        folder: where to.
        checkpoint: net and tokenizer.
        shard_mb: bytes of a file at most, in 10⁶; the net is one file, so it is not asked.
        dtype: of the weights in the file.
        overwrite: replace a checkpoint that is there.

    Raises:
        StorageError: the folder cannot be written, or holds something else.
    """
    with folder_atomic(folder, overwrite=overwrite, marker=MANIFEST) as made:
        write_json(made / FILE, msgspec.to_builtins(checkpoint.settings))
        write_bytes(made / TOKENIZER, checkpoint.tokenizer)
        single = SINGLE.removesuffix(".safetensors")
        arrays = checkpoint.model.state_dict().items()
        write_json(made / MANIFEST, write_shards(made, single, arrays, 2**62, dtype)[0])


def load_cma_checkpoint(folder: Path | str, *, dtype: torch.dtype = torch.float32) -> CmaCheckpoint:
    """Load a folder that `save_cma_checkpoint` wrote, on the CPU and in evaluation mode.

    Raises:
        CheckpointError: a file is missing, altered or none; or the weights are those of another
            net than `cma.json` describes.
    """
    folder = plain_path(folder)
    settings = load_cma_settings(folder)
    try:
        tokenizer = read_bytes(folder / TOKENIZER, LIMIT)
        size = len(load_tokenizer(folder))
    except (FormatError, StorageError) as error:
        raise CheckpointError(error.what, where=folder, remedy=error.remedy) from None
    if size != settings.vocabulary:
        raise CheckpointError(
            f"the tokenizer has {size} tokens, the net words for {settings.vocabulary}",
            where=folder,
            remedy="the tokenizer is that of another checkpoint",
        )
    with torch.device("meta"):
        net = RecurrentNet(settings)
    wanted = {name: tuple(array.shape) for name, array in net.state_dict().items()}
    found = open_weights(folder)
    odd = sorted(set(wanted) ^ set(found))
    if odd:
        what = "is missing" if odd[0] in wanted else "does not belong to this net"
        raise CheckpointError(
            f"{brief(odd[0])} {what}",
            where=folder / SINGLE,
            remedy=f"the weights are those of another net than {FILE} describes",
        )
    for name, shape in wanted.items():
        if found.shape_of(name) != shape:
            raise CheckpointError(
                f"{brief(name)} is {found.shape_of(name)}, {FILE} describes {shape}",
                where=folder / SINGLE,
                remedy="the weights are those of another net",
            )
    net.to_empty(device="cpu")
    net.load_state_dict({name: torch.tensor(found[name], dtype=dtype) for name in wanted})
    return CmaCheckpoint(net.to(dtype).eval(), tokenizer)


def digest_cma_checkpoint(folder: Path) -> str:
    """SHA-256 of what actions hang on: settings, tokenizer and weights."""
    whole = hashlib.sha256()
    for name in (FILE, TOKENIZER, SINGLE):
        with (folder / name).open("rb") as file:
            whole.update(f"{name} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return whole.hexdigest()
