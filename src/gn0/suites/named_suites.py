"""Suites that have a name instead of a folder: made on first use, the same bytes everywhere.

A suite of a name lies in the cache folder, by what decides it; a folder of that name goes first.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from gn0.missions.generate.settings import MissionSettings
from gn0.progress import Progress, no_progress
from gn0.storage import cache_dir, content_hash
from gn0.suites.generation import generate_missions
from gn0.suites.generation_folder import MANIFEST
from gn0.suites.suite import Suite, load_suite, open_suite
from gn0.version import source_version

if TYPE_CHECKING:
    from gn0.scenes.procedural.kinds import KindName

_DECIDING = (
    "avatars/identity.py", "avatars/likeness.py", "data", "gaussians", "geometry.py", "maps",
    "missions", "people", "scenes", "seeds.py", "sim", "suites",
)  # fmt: skip


class NamedSuite(NamedTuple):
    """What a suite of a name is made of: homes, missions, seed; and what it is in words."""

    homes: tuple[tuple[KindName, int], ...]  # kind and seed: small ones, quickly made
    missions: MissionSettings
    seed: int
    title: str


NAMED: dict[str, NamedSuite] = {
    "follow-demo": NamedSuite(
        (("apartment", 1), ("residence", 3)),
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
        folders = _make_homes(home, spec.homes, progress)
        suite, _ = generate_missions(
            folders, home / "suite", spec.missions, seed=spec.seed, name=name, progress=progress
        )
        return suite
    return load_suite(home / "suite")


def _make_homes(
    home: Path, homes: Sequence[tuple[KindName, int]], progress: Progress
) -> list[Path]:
    # here, so that who opens a suite does not load all that makes scenes
    from gn0.scenes.procedural.generate import GenerateSettings, generate_scene

    folders = []
    for kind, seed in homes:
        folder = home / "scenes" / f"{kind}-{seed}"
        if not (folder / "scene.json").is_file():
            settings = GenerateSettings(
                kind=kind, seed=seed, size="small", density=5000.0, light="draft"
            )
            generate_scene(settings, folder, overwrite=True, progress=progress)
        folders.append(folder)
    return folders
