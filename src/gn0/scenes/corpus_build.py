"""Make the scenes of a corpus in parallel, going on where an earlier run stopped."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec

from gn0 import __version__
from gn0.config import check_config
from gn0.errors import Gn0Error, SceneError, StorageError
from gn0.jobs import ExecutorName, run_jobs
from gn0.locked_folder import lock_folder, read_begun, sweep_folder
from gn0.progress import Progress, no_progress
from gn0.scenes.corpus import (
    CORPUS_FILE,
    LAYOUT,
    SCENE_FOLDER,
    CorpusFile,
    CorpusPart,
    CorpusScene,
    CorpusSpec,
    held_out_forms,
    plan_corpus,
)
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.procedural.generate import GenerateSettings, generate_scene
from gn0.scenes.scene_sources import import_scene
from gn0.storage import (
    Journal,
    check_contained,
    content_hash,
    plain_path,
    storage_error,
    write_json,
)

JOURNAL_FILE = "corpus.journal"
_BUILD = "gn0.scenes.corpus_build:build_corpus_scene"


def generate_corpus(
    spec: CorpusSpec,
    out: Path | str,
    *,
    base: Path | str = ".",
    workers: int = 1,
    executor: ExecutorName = "process",
    ray_address: str = "",
    skip_failed: bool = False,
    progress: Progress = no_progress,
) -> CorpusFile:
    """Make every scene of a corpus; goes on where an earlier run of the same spec stopped.

    The same spec gives the same bytes for any number of workers.

    Args:
        spec: what to make.
        out: folder of the corpus.
        base: what the paths of imports are relative to.
        workers: scenes at a time.
        executor: "process" or "ray".
        ray_address: address of a running cluster.
        skip_failed: leave out scenes that cannot be made, and name them in the corpus.
        progress: progress sink.

    Raises:
        StorageError: `out` holds something else, or cannot be written.
        ConfigError: `out` holds another corpus, or the spec contradicts itself.
        SceneError, FormatError, JobError: a scene cannot be made; all others are, and are kept.
    """
    out = plain_path(out)
    spec = check_config(spec)
    plan = plan_corpus(spec)
    digest = content_hash(msgspec.json.encode(spec, order="deterministic"))
    check_contained(out)
    _read_journal(out, digest)  # the folder of another is not touched
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(error, out, "make the folder") from error
    with lock_folder(out, writer="corpus"):
        sweep_folder(out)
        done = _read_journal(out, digest)
        todo = [item for item in plan if item[0].id not in done]
        without = held_out_forms(spec)
        payloads = [
            _payload(scene, part, seed, out, Path(base), without) for scene, part, seed in todo
        ]
        failures: dict[str, Gn0Error] = {}
        with Journal(out / JOURNAL_FILE) as journal:
            if not journal.read():
                journal.append({"corpus": digest})

            def note(index: int, answer: dict[str, Any]) -> None:
                done[todo[index][0].id] = answer
                journal.append({"scene": todo[index][0].id, **answer})

            def note_failure(index: int, error: Gn0Error) -> None:
                if isinstance(error, StorageError):  # a full disk fails all that follow
                    raise error
                failures[todo[index][0].id] = error

            run_jobs(
                _BUILD,
                payloads,
                workers=workers,
                executor=executor,
                ray_address=ray_address,
                names=[f"scene {scene.id}" for scene, _, _ in todo],
                done=note,
                failed=note_failure,
                what="scenes",
                progress=progress,
                steps=progress,
            )
        left_out = tuple(scene.id for scene, _, _ in plan if scene.id in failures)
        if failures and not (skip_failed and done):
            raise _tell_failures([failures[id] for id in left_out], left_out, len(plan))
        about = CorpusFile(
            layout=LAYOUT,
            name=spec.name,
            seed=spec.seed,
            spec=digest,
            scenes=tuple(
                msgspec.structs.replace(scene, **done[scene.id])
                for scene, _, _ in plan
                if scene.id in done
            ),
            software=f"gn0 {__version__}",
            without=without,
            left_out=left_out,
        )
        content = msgspec.to_builtins(about)
        if not left_out:
            del content["left_out"]
        write_json(out / CORPUS_FILE, content)
    return about


def _tell_failures(errors: Sequence[Gn0Error], ids: Sequence[str], count: int) -> Gn0Error:
    """The first of them, and what became of the others."""
    first, what = errors[0], errors[0].what
    if len(ids) > 1:
        named = ", ".join(ids[:5]) + (", …" if len(ids) > 5 else "")
        what = f"{len(ids)} of {count} scenes cannot be made: {named}; of the first: {what}"
    remedy = first.remedy  # that of a bug ends with its trace
    if len(ids) < count:
        go_on = "all others are made, and kept: --skip-failed leaves out those that cannot be"
        remedy = f"{go_on}; {remedy}" if remedy else go_on
    return type(first)(what, where=first.where, remedy=remedy)


def _read_journal(out: Path, digest: str) -> dict[str, dict[str, Any]]:
    """What earlier runs of the same spec have made, by scene id."""
    records = read_begun(out, JOURNAL_FILE, "corpus", digest, "spec")
    found = {record.pop("scene"): record for record in records}
    return {id: r for id, r in found.items() if (out / SCENE_FOLDER / id / "scene.json").is_file()}


def _payload(
    scene: CorpusScene,
    part: CorpusPart,
    seed: int,
    out: Path,
    base: Path,
    without: Sequence[str],
) -> dict[str, Any]:
    path = ""
    if part.path:
        expanded = Path(os.path.expandvars(part.path)).expanduser()
        path = str(expanded if expanded.is_absolute() else (base / expanded).resolve())
    return {
        "folder": str((out / scene.folder).resolve()),
        "part": msgspec.to_builtins(part),
        "path": path,
        "seed": seed,
        "style": scene.style or None,
        "without": list(without) if scene.split == "train" else [],
    }


def build_corpus_scene(
    payload: Mapping[str, Any], progress: Progress = no_progress
) -> dict[str, Any]:
    """Make one scene into its folder (a unit of `run_jobs`) and say what is in it."""
    part = msgspec.convert(payload["part"], CorpusPart)
    folder = Path(payload["folder"])
    source = Path(payload["path"])
    if part.kind:
        settings = msgspec.convert(
            {
                "kind": part.kind,
                "seed": payload["seed"],
                "size": part.size,
                "style": payload["style"],
                "density": part.density,
                "light": part.light,
                "refine": part.refine,
                "cloud_form": "packed" if part.packed else "exact",
                "without": payload["without"],
                "open_plan": part.open_plan is True,
            },
            GenerateSettings,
        )
        scene = generate_scene(settings, folder, overwrite=True, progress=progress)
    elif (source / "scene.json").is_file():
        loaded = load_scene(source)
        form: Literal["exact", "packed"] = "packed" if part.packed else "exact"
        scene = save_scene(
            replace(loaded, id=folder.name),
            folder,
            cloud_form=form,
            overwrite=True,
            progress=progress,
        )
    else:
        options: dict[str, Any] = {"height_band": part.height_band} if part.height_band else {}
        options |= {"density": part.density} if part.density else {}
        form = "packed" if part.packed else "exact"
        scene = import_scene(
            source, folder, cloud_form=form, overwrite=True, progress=progress, **options
        )
    if not scene.grid.free_area:
        raise SceneError(
            "nothing is walkable", where=f"scene {scene.id!r}", remedy="see `gn0 scene check`"
        )
    return {
        "hash": scene.content_hash,
        "area": round(scene.grid.free_area, 2),
        "gaussians": len(scene.gaussians),
        "objects": len(scene.objects),
        "rooms": len(scene.rooms),
    }
