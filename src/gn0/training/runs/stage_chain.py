"""The stages that a policy went through, told in its own folder, since the runs stay behind.

A run that goes on from a policy of another machine finds here what came before, and its own
policy tells all of it again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import msgspec

from gn0.errors import FormatError
from gn0.policies.bae.shipped import TRAINED
from gn0.storage import read_bytes, write_bytes
from gn0.training.runs.metrics_file import read_metrics
from gn0.training.runs.run_folder import METRICS, RUN, RunRecord, read_run

STAGES = "stages.json"  # in a policy's folder
_CHAIN = 16  # stages at most
_LIMIT = 2**20  # bytes


class StageTold(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One stage.

    Attributes:
        stage: its name, such as `dagger_live`.
        told: data, samples, steps, time, devices, seed and hashes.
        commands: that ran it, each once.
    """

    stage: str
    told: str
    commands: list[str]


def list_stages(run: Path) -> list[StageTold]:
    """The stages of a run's policy, the first one first and the run's own last.

    What its policy tells goes before what lies at the place that it began from: that may be on
    another machine, or another policy by now.

    Raises:
        TrainingError: the folder holds no run.
        StorageError, FormatError: a file cannot be read.
    """
    record = read_run(run)
    told = read_stages(run / TRAINED)
    return [*(told[:-1] if told else list_before(record.recipe)), _tell(record, run)]


def list_before(recipe: Mapping[str, Any], most: int = _CHAIN) -> list[StageTold]:
    """The stages before a run of this recipe, as far as they are told.

    They are told by runs, where these are on this machine, and by the policy that it began from.

    Raises:
        StorageError, FormatError: a file cannot be read.
    """
    start = str(recipe.get("start") or "")
    if not start or not most:
        return []
    place = Path(start)
    home = place.parent if place.name == TRAINED else place
    if not (home / RUN).is_file():
        return read_stages(place)[-most:]
    record = read_run(home)
    return [*list_before(record.recipe, most - 1), _tell(record, home)]


def read_stages(policy: Path) -> list[StageTold]:
    """What a policy's folder tells; nothing where it does not.

    Raises:
        FormatError: it is not readable.
        StorageError: see its text.
    """
    path = policy / STAGES
    if not path.is_file():
        return []
    try:
        return msgspec.json.decode(read_bytes(path, _LIMIT), type=list[StageTold])
    except msgspec.DecodeError as error:
        raise FormatError(
            f"no list of stages: {error}",
            file=path,
            remedy="take the file away, and the card begins with the next stage",
        ) from None


def write_stages(policy: Path, stages: Sequence[StageTold]) -> None:
    """Tell them in a policy's folder."""
    write_bytes(policy / STAGES, msgspec.json.format(msgspec.json.encode(stages)) + b"\n")


def shorten(value: Any) -> Any:
    """The same with absolute paths as their last part: where a machine keeps things is no fact."""
    if isinstance(value, str):
        return f"…/{PurePosixPath(value).name}" if value.startswith("/") else value
    if isinstance(value, Mapping):
        return {name: shorten(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [shorten(one) for one in value]
    return value


def name_data(recipe: Mapping[str, Any], last: Mapping[str, Any]) -> str:
    """What a run learned from, in words; nothing where that is not told.

    Args:
        recipe: of the run.
        last: what its last report tells; suites that did not come in time are not in it.
    """
    names = shorten(list(recipe.get("suites", ())))
    joined = int(last.get("suites", len(names)))
    told = ", ".join(names[:joined])
    return f"{told} ({', '.join(names[joined:])} came too late)" if names[joined:] else told


def _tell(record: RunRecord, home: Path) -> StageTold:
    recipe, lines = record.recipe, read_metrics(home / METRICS)
    last = lines[-1] if lines else {}
    told = [name_data(recipe, last) or "data not told"]
    if "samples" in last:
        told.append(f"{int(last['samples']):,} samples in {int(last['step']):,} steps")
    if last.get("seconds"):
        told.append(f"{last['seconds'] / 60:.1f} min on {record.devices}")
    told.append(f"seed {recipe.get('seed', 'not told')}")
    told += [f"{what} {digest}" for what, digest in sorted(record.hashes.items())]
    words = [
        " ".join(["gn0", *(word or "''" for word in shorten(session.command))])
        for session in record.sessions
    ]
    return StageTold(record.stage, "; ".join(told), list(dict.fromkeys(words)) or ["not told"])
