"""Which scenes a command works on: scene folders, folders of them, or a corpus with its splits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from gn0.config import load_json
from gn0.errors import SceneError
from gn0.progress import Progress, no_progress
from gn0.scenes.folder import load_scene
from gn0.storage import safe_join

CORPUS_FILE = "corpus.json"


class _CorpusScene(msgspec.Struct, frozen=True):
    id: str
    folder: str
    split: str


class _CorpusView(msgspec.Struct, frozen=True):
    """The part of `corpus.json` that is needed here."""

    scenes: tuple[_CorpusScene, ...]


@dataclass(frozen=True)
class SceneEntry:
    """A scene on disk: id, folder, content hash, split."""

    id: str
    folder: Path
    hash: str
    split: str


def list_scenes(
    paths: Sequence[Path | str], split: str, progress: Progress = no_progress
) -> list[SceneEntry]:
    """The scenes of some folders, sorted by id.

    Args:
        paths: scene folders, folders with scene folders in them, or corpora.
        split: of scenes whose folder does not say it.
        progress: progress sink.

    Raises:
        SceneError: a folder holds no scene, or two scenes share an id.
        StorageError, FormatError: a scene or `corpus.json` cannot be read.
    """
    folders: list[tuple[Path, str]] = []
    for given in map(Path, paths):
        if (given / CORPUS_FILE).is_file():
            about = load_json(given / CORPUS_FILE, _CorpusView)
            folders += [(safe_join(given, s.folder), s.split) for s in about.scenes]
        elif (given / "scene.json").is_file():
            folders.append((given, split))
        else:
            below = sorted(p.parent for p in given.glob("*/scene.json"))
            if not below:
                raise SceneError(
                    "no scene (scene.json), no corpus (corpus.json) and no folder of scenes",
                    where=given,
                    remedy="make one with `gn0 scene generate`, `gn0 scene import` or "
                    "`gn0 scene corpus`",
                )
            folders += [(folder, split) for folder in below]
    found: dict[str, SceneEntry] = {}
    for number, (folder, part) in enumerate(folders):
        progress("reading scenes", number, len(folders))
        scene = load_scene(folder)
        if scene.id in found and found[scene.id].folder.resolve() != folder.resolve():
            raise SceneError(
                f"scene {scene.id!r} is given twice",
                where=folder,
                remedy=f"the other is {found[scene.id].folder}",
            )
        found[scene.id] = SceneEntry(scene.id, folder, scene.content_hash, part)
    progress("reading scenes", len(folders), len(folders))
    return [found[name] for name in sorted(found)]
