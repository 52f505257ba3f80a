"""Paths of earlier runs, which must not be repeated: from generations, or from any suite."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gn0.errors import StorageError
from gn0.geometry import polyline_length
from gn0.missions.generate.path_pool import PathRecord, load_paths, paths_table, save_table
from gn0.storage import content_hash
from gn0.suites.suite import SUITE_FILE, load_suite

PATHS = "paths.parquet"


@dataclass(frozen=True)
class EarlierPaths:
    """Accepted paths of earlier runs.

    Attributes:
        paths: by scene id.
        digest: digest of all of them; "" when there are none.
        notes: what was left out.
    """

    paths: dict[str, list[PathRecord]] = field(default_factory=dict)
    digest: str = ""
    notes: tuple[str, ...] = ()

    def file(self, work: Path, scene: str) -> Path:
        """Where the paths of a scene are kept for its worker."""
        return work / "earlier" / f"{content_hash(scene)[:16]}.parquet"


def load_earlier(folders: Sequence[Path | str], hashes: Mapping[str, str]) -> EarlierPaths:
    """The paths of earlier runs in these scenes.

    Those of another version of a scene are left out and noted: the ground there was another.

    Args:
        folders: of `gn0 missions generate`, or any suites.
        hashes: content hash of each scene by its id.

    Raises:
        StorageError: neither a generation nor a suite.
        FormatError: a file is damaged.
    """
    paths: dict[str, list[PathRecord]] = {}
    changed: Counter[str] = Counter()
    for folder in map(Path, folders):
        for record in _load(folder):
            if hashes.get(record.scene_id) == record.scene_hash:
                paths.setdefault(record.scene_id, []).append(record)
            elif record.scene_id in hashes:
                changed[record.scene_id] += 1
    notes = tuple(
        f"{scene}: {n} earlier paths are of another version of the scene and were left out"
        for scene, n in sorted(changed.items())
    )
    if not paths:
        return EarlierPaths(notes=notes)
    known = sorted(content_hash(r.scene_id, r.array) for group in paths.values() for r in group)
    return EarlierPaths(paths, content_hash(*known), notes)


def _load(folder: Path) -> list[PathRecord]:
    if (folder / PATHS).is_file():
        return load_paths(folder / PATHS)
    if not (folder / SUITE_FILE).is_file():
        raise StorageError(
            f"neither a generation ({PATHS}) nor a suite ({SUITE_FILE})",
            where=folder,
            remedy="give a folder of `gn0 missions generate` or `gn0 bench suite` to --against",
        )
    suite = load_suite(folder)
    found: dict[tuple[str, tuple[tuple[float, float], ...]], PathRecord] = {}
    for episode in suite.episodes:
        if len(episode.path) < 2:
            continue
        found.setdefault(
            (episode.scene_id, episode.path),
            PathRecord(
                path_id=episode.path_id or episode.id,
                scene_id=episode.scene_id,
                scene_hash=suite.scene_hash(episode.scene_id),
                split=episode.split,
                target_id="",
                target_kind="",
                category="",
                room="",
                component=0,
                start=episode.start,
                goal=episode.goal,
                length=polyline_length(episode.path),  # type: ignore[arg-type]
                points=episode.path,
                keypoints=(),
            ),
        )
    return list(found.values())


def save_earlier(work: Path, earlier: EarlierPaths, scenes: Sequence[str]) -> None:
    """A file a scene for its worker.

    Raises:
        StorageError: it cannot be written.
    """
    for scene in scenes:
        if scene in earlier.paths:
            save_table(earlier.file(work, scene), paths_table(earlier.paths[scene]))
