"""Addresses in imported worlds, looked up only inside the world's folder.

Gazebo finds files through search paths of the machine that the world was made on: `model://`,
`package://`, `file://` with a stranger's home folder, addresses of the internet, paths relative to
the model, names in another letter case. Whatever an address says, only files in the folder are
opened: its end is matched against what lies there.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from gn0.errors import StorageError, brief
from gn0.storage import find_path_fault, safe_join

_PARTS_MAX = 32
_MESHES = ("", "meshes", "mesh", "visual", "collision")


@dataclass(eq=False)
class WorldFiles:
    """The folder of a world, as addresses see it.

    Attributes:
        root: the folder; nothing outside it is ever opened.
    """

    root: Path
    _listing: dict[Path, dict[str, str]] = field(default_factory=dict)

    def find(self, uri: str, near: Path, file: Path) -> tuple[Path, bool]:
        """What an address means, and whether it says so itself: `model://NAME/…`, letter by letter.

        Args:
            uri: the address as written.
            near: the folder of the model that it stands in.
            file: the file that it stands in, for errors.

        Raises:
            StorageError: nothing in the folder fits, or the address leads out of it.
        """
        scheme, rest = _split(uri)
        parts = [part for part in rest.split("/") if part not in ("", ".")]
        bases = (self.root / "models", self.root)
        if scheme in ("model", "package") and uri.startswith(f"{scheme}://") and rest:
            for base in bases:
                path = safe_join(base, uri.partition("://")[2])
                if path.exists():
                    return path, True
        if not parts or len(parts) > _PARTS_MAX:
            raise StorageError(
                f"address {brief(uri)} names no file",
                where=file,
                remedy="put the model under models/ beside the world and use model://NAME/…",
            )
        if scheme and ".." in parts:
            raise StorageError(
                f"address {brief(uri)} climbs out of its folder",
                where=file,
                remedy="put the model under models/ beside the world and use model://NAME/…",
            )
        for fold in (False, True):
            for base, relative in self._candidates(scheme, parts, near):
                found = self._at(base, relative, fold=fold)
                if found is not None:
                    return found, False
        raise StorageError(
            f"{uri if len(uri) <= 200 else uri[:199] + '…'} is not in the world's folder",
            where=file,
            remedy=f"put it under {self.root / 'models'}",
        )

    def _candidates(
        self, scheme: str, parts: list[str], near: Path
    ) -> Iterator[tuple[Path, list[str]]]:
        """Where an address may lie, the likeliest first: (folder, path in it)."""
        inside = near.resolve().is_relative_to(self.root.resolve())
        if not scheme and inside:
            own = near.resolve().relative_to(self.root.resolve()).as_posix()
            path = posixpath.normpath(posixpath.join(own, *parts))
            if not path.startswith(".."):
                yield self.root, path.split("/")
        if ".." in parts:
            return
        for start in range(len(parts)):
            yield self.root / "models", parts[start:]
            yield self.root, parts[start:]
        if inside:
            for folder in _MESHES:
                yield near, [*folder.split(), parts[-1]]

    def _at(self, base: Path, relative: list[str], *, fold: bool) -> Path | None:
        """An existing file or folder below `base`, or None; `fold` forgives the letter case."""
        names = relative
        if fold:
            names, folder = [], base
            for part in relative:
                name = self._names(folder).get(part.casefold())
                if name is None:
                    return None
                names.append(name)
                folder = folder / name
        path = "/".join(names)
        if find_path_fault(path):
            return None
        try:
            found = safe_join(base, path)
            inside = found.resolve().is_relative_to(self.root.resolve())
            return found if inside and found.exists() else None
        except (StorageError, OSError):
            return None

    def _names(self, folder: Path) -> dict[str, str]:
        """The names in a folder by their case-folded form; the first by name where two agree."""
        if folder not in self._listing:
            try:
                inside = folder.resolve().is_relative_to(self.root.resolve())
                names = sorted(item.name for item in folder.iterdir()) if inside else []
            except OSError:
                names = []
            self._listing[folder] = {name.casefold(): name for name in reversed(names)}
        return self._listing[folder]


def _split(uri: str) -> tuple[str, str]:
    """The scheme in lower case ("" for a plain relative path) and the path of an address."""
    text = uri.strip().replace("\\", "/")
    match = re.match(r"([A-Za-z][A-Za-z0-9+.-]*):/*", text)
    if match:
        return match[1].lower(), unquote(text[match.end() :])
    return ("file", text) if text.startswith(("/", "~")) else ("", text)
