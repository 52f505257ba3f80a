"""The folder of a generation: what was asked of it, whether it is done, who is writing there.

While a generation is under way its folder holds `.work/`: the request, a lock, and a part a scene.
`manifest.json` comes last and is the mark of completion.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from gn0.config import Config, load_json
from gn0.errors import BenchError, StorageError
from gn0.locked_folder import check_folder, lock_folder, sweep_folder
from gn0.missions.episode import AgentSpec
from gn0.missions.generate.follow_tracks import TRACKS
from gn0.missions.generate.scene_paths import SceneReport
from gn0.missions.generate.settings import MissionSettings
from gn0.storage import check_contained, storage_error, write_json
from gn0.suites.suite import EPISODE_FILE

MANIFEST, PATHS, TEXTS = "manifest.json", "paths.parquet", "instructions.parquet"
WORK, REQUEST, PARTS, REPORT = ".work", "request.json", "parts", "report.json"
LAYOUT = 1
TABLES = (EPISODE_FILE, PATHS, TEXTS)


def list_tables(settings: MissionSettings) -> tuple[str, ...]:
    """The tables of a generation by name; tracks only where people are followed."""
    return (*TABLES, TRACKS) if "follow" in settings.missions else TABLES


class RequestScene(Config, frozen=True):
    """A scene of a request; `val_seen`: some of its paths are held out as that split."""

    id: str
    hash: str
    split: str
    val_seen: bool = False


class GenerationRequest(Config, frozen=True):
    """Everything that decides the bytes of a generation.

    Attributes:
        layout: version of these files.
        software: version, and digest of the source that decides what is made.
        name: name of the suite.
        seed: root seed.
        camera: camera preset by name.
        agent: the body.
        settings: counts and measures.
        language_options: of the provider, without what is secret or of no effect on texts.
        scenes: sorted by id.
        earlier: digest of the paths of earlier runs; "" when there are none.
    """

    layout: int
    software: str
    name: str
    seed: int
    camera: str
    agent: AgentSpec
    settings: MissionSettings
    language_options: dict[str, str]
    scenes: tuple[RequestScene, ...]
    earlier: str = ""


class Manifest(Config, frozen=True):
    """The content of `manifest.json`.

    Attributes:
        request: what was asked.
        totals: sums over all scenes.
        scenes: what became of each.
        reasons: what the names of filters mean.
        notes: what a reader should know.
        suite: hash of the suite.
        files: digest of the bytes of each table.
    """

    request: GenerationRequest
    totals: Totals
    scenes: tuple[SceneReport, ...]
    reasons: dict[str, str]
    notes: tuple[str, ...]
    suite: str
    files: dict[str, str]


class Totals(Config, frozen=True):
    """Sums over scenes, see `SceneReport`."""

    scenes: int
    asked: int
    paths: int
    candidates: int
    fell: dict[str, int]
    targets: int
    targets_fell: dict[str, int]
    unreachable: int
    episodes: dict[str, int]
    splits: dict[str, int]
    texts: dict[str, int]
    fallbacks: dict[str, int]
    follow_candidates: int = 0
    follow_fell: dict[str, int] = {}  # noqa: RUF012 (msgspec copies it)


def clear_folder(out: Path, request: GenerationRequest) -> None:
    """Remove an earlier generation that was another one.

    Raises:
        StorageError: something else is there.
    """
    check_contained(out)
    check_folder(out)
    marks = (out / MANIFEST, out / WORK / REQUEST)
    if not out.exists() or not any(out.iterdir()) or _request_in(out) == request:
        return
    if not any(mark.is_file() for mark in marks):
        raise StorageError(
            f"the folder holds something else: it has no {MANIFEST}, so it is not replaced",
            where=out,
            remedy="choose another --out",
        )
    shutil.rmtree(out)


def _request_in(out: Path) -> GenerationRequest | None:
    """What the generation in a folder was asked; None when none is there or it is of old."""
    for path, read in ((out / MANIFEST, _request_of), (out / WORK / REQUEST, None)):
        if path.is_file():
            with contextlib.suppress(StorageError, msgspec.MsgspecError, ValueError, KeyError):
                value = load_json(path, dict[str, Any])
                value = read(value) if read is not None else value
                return msgspec.convert(value, GenerationRequest)
            return None
    return None


def _request_of(value: dict[str, Any]) -> Any:
    return value["request"]


def find_finished(out: Path, request: GenerationRequest) -> Manifest | None:
    """The manifest of this very generation, when it is done; None when there is work to do.

    Raises:
        BenchError: another generation is there.
        StorageError: something else is.
    """
    check_folder(out)
    if not out.exists() or not any(out.iterdir()):
        return None
    found = _request_in(out)
    if found is None:
        if (out / MANIFEST).is_file() or (out / WORK / REQUEST).is_file():
            raise BenchError(
                "holds a generation that this version cannot read",
                where=out,
                remedy="choose another --out, or pass --overwrite to replace it",
            )
        if set(os.listdir(out)) == {WORK}:
            return None  # killed before it had written what was asked
        raise StorageError(
            "the output folder exists and is not empty", where=out, remedy="choose another --out"
        )
    if (out / MANIFEST).is_file():  # what is done stays done, also for later versions
        found = msgspec.structs.replace(found, software=request.software)
    if found != request:
        raise BenchError(
            f"holds another generation, which differs in {_differing(found, request)}",
            where=out,
            remedy="choose another --out, or pass --overwrite to replace it",
        )
    if not (out / MANIFEST).is_file():
        return None
    shutil.rmtree(out / WORK, ignore_errors=True)
    return load_json(out / MANIFEST, Manifest)


def _differing(found: GenerationRequest, request: GenerationRequest) -> str:
    a, b = msgspec.to_builtins(found), msgspec.to_builtins(request)
    a, b = {**a.pop("settings"), **a}, {**b.pop("settings"), **b}
    return ", ".join(sorted(k for k in {*a, *b} if a.get(k) != b.get(k)))


@contextlib.contextmanager
def open_work(out: Path, request: GenerationRequest) -> Iterator[Path]:
    """The folder of parts, locked for this process; the lock goes with it, however it ends."""
    work = out / WORK
    try:
        (work / PARTS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(error, work, "write the output folder") from error
    with lock_folder(work, refuse=BenchError, writer="generation", name="lock"):
        sweep_folder(out)
        write_json(work / REQUEST, msgspec.to_builtins(request))
        yield work
    shutil.rmtree(work, ignore_errors=True)
