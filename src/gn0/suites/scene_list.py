"""Which scenes a command works on: scene folders, folders of them, or a corpus with its splits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gn0.errors import SceneError
from gn0.progress import Progress, no_progress
from gn0.scenes.corpus import CORPUS_FILE, load_corpus
from gn0.scenes.folder import load_scene
from gn0.storage import plain_path, safe_join


@dataclass(frozen=True)
class SceneEntry:
    """A scene on disk.

    Attributes:
        id: id of the scene.
        folder: where it lies.
        hash: its content hash.
        split: train, val_unseen, test, …
        val_seen: some of its paths are held out as split val_seen.
    """

    id: str
    folder: Path
    hash: str
    split: str
    val_seen: bool = False


def list_scenes(
    paths: Sequence[Path | str], split: str, progress: Progress = no_progress
) -> list[SceneEntry]:
    """The scenes of some folders, sorted by id.

    Args:
        paths: scene folders, folders with scene folders in them, or corpora.
        split: split of scenes whose folder does not say it.
        progress: progress sink.

    Raises:
        SceneError: a folder holds no scene, or two scenes share an id.
        StorageError, FormatError: a scene or `corpus.json` cannot be read.
    """
    folders: list[tuple[Path, str, bool]] = []
    holds_out = split == "train"
    for given in map(plain_path, paths):
        if (given / CORPUS_FILE).is_file():
            folders += [
                (safe_join(given, scene.folder), scene.split, scene.val_seen)
                for scene in load_corpus(given).scenes
            ]
        elif (given / "scene.json").is_file():
            folders.append((given, split, holds_out))
        else:
            below = sorted(p.parent for p in given.glob("*/scene.json"))
            if not below:
                raise SceneError(
                    "no scene (scene.json), no corpus (corpus.json) and no folder of scenes",
                    where=given,
                    remedy="make one with `gn0 scene generate`, `gn0 scene import` or "
                    "`gn0 scene corpus`",
                )
            folders += [(folder, split, holds_out) for folder in below]
    found: dict[str, SceneEntry] = {}
    for number, (folder, part, seen) in enumerate(folders):
        progress("reading scenes", number, len(folders))
        scene = load_scene(folder)
        if scene.id in found and found[scene.id].folder.resolve() != folder.resolve():
            raise SceneError(
                f"scene {scene.id!r} is given twice",
                where=folder,
                remedy=f"the other is {found[scene.id].folder}",
            )
        found[scene.id] = SceneEntry(scene.id, folder, scene.content_hash, part, seen)
    progress("reading scenes", len(folders), len(folders))
    return [found[name] for name in sorted(found)]
