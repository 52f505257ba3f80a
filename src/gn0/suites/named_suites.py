"""Suites that have a name instead of a folder: made on first use, the same bytes everywhere.

A suite of a name lies in the cache folder, by what decides it; a folder of that name goes first.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from gn0.missions.generate.settings import MissionSettings
from gn0.progress import Progress, no_progress
from gn0.scenes.procedural.generate import GenerateSettings, generate_scene
from gn0.scenes.procedural.kinds import KindName
from gn0.storage import cache_dir, content_hash
from gn0.suites.generation import generate_missions
from gn0.suites.generation_folder import MANIFEST
from gn0.suites.suite import Suite, load_suite, open_suite
from gn0.version import source_version

_DECIDING = (
    "avatars/identity.py", "avatars/likeness.py", "data", "gaussians", "geometry.py", "maps",
    "missions", "people", "scenes", "seeds.py", "sim", "suites",
)  # fmt: skip


class NamedSuite(NamedTuple):
    """What a suite of a name is made of: scenes, missions, seed; and what it is in words."""

    scenes: tuple[GenerateSettings, ...]
    missions: MissionSettings
    seed: int
    title: str


def _homes(*kinds_and_seeds: tuple[KindName, int]) -> tuple[GenerateSettings, ...]:
    return tuple(
        GenerateSettings(kind=kind, seed=seed, size="small", density=5000.0, light="draft")
        for kind, seed in kinds_and_seeds
    )


NAMED: dict[str, NamedSuite] = {
    "follow-demo": NamedSuite(
        _homes(("apartment", 1), ("residence", 3)),
        MissionSettings(per_scene=6, missions=("follow",), minimum_length=8.0),
        seed=0,
        title="people to follow in two generated homes",
    ),
}


def open_named(
    path: Path | str, beside: Path | str | None = None, *, progress: Progress = no_progress
) -> Suite:
    """A suite by its name, else by its folder as `open_suite` does.

    Args:
        path: a name, a suite or a scene folder.
        beside: the results folder, see `open_suite`.
        progress: progress sink.

    Raises:
        StorageError: neither a name, nor a suite, nor a scene.
    """
    name = str(path)
    if name not in NAMED or Path(path).exists():
        return open_suite(path, beside)
    return make_named(name, NAMED[name], progress)


def make_named(name: str, spec: NamedSuite, progress: Progress = no_progress) -> Suite:
    """The suite of a name in the cache folder; what is there already is not made again."""
    home = cache_dir() / "suites" / f"{name}-{content_hash(repr(spec), source_version(_DECIDING))}"
    if not (home / "suite" / MANIFEST).is_file():
        folders = _make_scenes(home, spec.scenes, progress)
        suite, _ = generate_missions(
            folders, home / "suite", spec.missions, seed=spec.seed, name=name, progress=progress
        )
        return suite
    return load_suite(home / "suite")


def _make_scenes(home: Path, scenes: Sequence[GenerateSettings], progress: Progress) -> list[Path]:
    folders = []
    for settings in scenes:
        folder = home / "scenes" / f"{settings.kind}-{settings.seed}"
        if not (folder / "scene.json").is_file():
            generate_scene(settings, folder, overwrite=True, progress=progress)
        folders.append(folder)
    return folders
