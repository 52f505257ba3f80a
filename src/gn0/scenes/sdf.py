"""SDF worlds (Gazebo): which meshes stand where. Models come from the world's folder only.

Poses are `x y z roll pitch yaw`, metres and radians, nested world → model → link → visual. An
`<include>` with a pose replaces the pose of the model that it includes (SDF 1.6).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np

from gn0.errors import FormatError, StorageError
from gn0.geometry import F64
from gn0.scenes.xml import load_xml
from gn0.storage import safe_join

_NEST_MAX = 16
_PARTS_MAX = 100_000
_BUILTIN = {"sun", "ground_plane"}  # model:// names that every Gazebo brings along

Role = Literal["visual", "collision"]


@dataclass(frozen=True, eq=False)
class SdfPart:
    """One geometry of a model, placed in the world.

    Attributes:
        role: what is seen, or what is bumped into.
        shape: "mesh", "box", "sphere", "cylinder" or "plane".
        mesh: the mesh file, for a mesh.
        model: the model folder, where textures are looked up.
        size: scale of a mesh (x, y, z); extents of a box [m]; (radius, length, 0) of a cylinder;
            (radius, 0, 0) of a sphere; (width, depth, 0) of a plane.
        pose: model-to-world transform [4, 4] without the scale.
        colour: diffuse colour (r, g, b) of the SDF's own material, if any.
    """

    role: Role
    shape: str
    mesh: Path | None
    model: Path
    size: tuple[float, float, float]
    pose: F64
    colour: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class SdfInstance:
    """A model of the world: its name there, the name of its kind, its parts."""

    name: str
    kind: str
    parts: tuple[SdfPart, ...]


@dataclass(frozen=True, eq=False)
class SdfLight:
    """A light: type "point", "spot" or "directional", position [m], direction, colour."""

    name: str
    kind: str
    position: tuple[float, float, float]
    direction: tuple[float, float, float]
    colour: tuple[float, float, float]


@dataclass(eq=False)
class SdfWorld:
    """What a world file describes."""

    root: Path
    file: Path
    instances: list[SdfInstance] = field(default_factory=list)
    lights: list[SdfLight] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def find_world_file(path: Path) -> Path | None:
    """The world file meant by a path: the file itself, or the one in its folder or `worlds/`.

    With several, the one named like the folder, else the first by name.
    """
    if path.is_file():
        return path if path.suffix.lower() in (".world", ".sdf") else None
    if not path.is_dir():
        return None
    found = [
        candidate
        for pattern in ("worlds/*.world", "*.world", "worlds/*.sdf", "*.sdf")
        for candidate in sorted(path.glob(pattern))
        if candidate.is_file() and candidate.name.lower() != "model.sdf"
    ]
    named = [f for f in found if f.stem == path.resolve().name]
    return next(iter(named or found), None)


def load_sdf(file: Path) -> SdfWorld:
    """Read a world and every model it includes.

    Raises:
        StorageError: a model is missing, or a path climbs out of the world's folder.
        FormatError: a file is not SDF, or a number in it is no number.
    """
    root = file.parent.parent if file.parent.name == "worlds" else file.parent
    world = SdfWorld(root=root, file=file)
    tree = load_xml(file)
    node = tree.find("world") if tree.tag == "sdf" else None
    if node is None:
        raise FormatError(
            "no <sdf><world> in this file", file=file, remedy="give a Gazebo .world or .sdf file"
        )
    reader = _Reader(world)
    for child in node:
        if child.tag == "model":
            reader.add_instance(child)
        elif child.tag == "include":
            reader.add_include(child)
        elif child.tag == "light":
            reader.add_light(child)
    return world


class _Reader:
    def __init__(self, world: SdfWorld) -> None:
        self.world = world
        self.cache: dict[Path, Element] = {}
        self.parts = 0

    def add_instance(self, node: Element) -> None:
        name = node.get("name") or f"model_{len(self.world.instances)}"
        kinds: list[str] = []
        parts = tuple(
            self._parts(node, _pose(node, self.world.file), self.world.file, kinds, depth=0)
        )
        self._append(name, kinds[0] if kinds else name, parts)

    def add_include(self, node: Element) -> None:
        uri = _text(node, "uri")
        if _builtin(uri):
            if uri.endswith("ground_plane"):
                self._append("ground_plane", "ground_plane", (_plane(self.world.root),))
            return
        kinds: list[str] = []
        parts = tuple(self._included(node, np.eye(4), self.world.file, kinds, depth=0))
        name = _text(node, "name") or (kinds[0] if kinds else "model")
        self._append(name, kinds[0] if kinds else name, parts)

    def add_light(self, node: Element) -> None:
        file = self.world.file
        pose = _pose(node, file)
        direction = _numbers(_text(node, "direction") or "0 0 -1", 3, file, "direction")
        colour = _numbers(_text(node, "diffuse") or "1 1 1 1", 3, file, "diffuse")
        self.world.lights.append(
            SdfLight(
                name=node.get("name") or "light",
                kind=node.get("type") or "point",
                position=_triple(pose[:3, 3]),
                direction=_triple(pose[:3, :3] @ direction),
                colour=_triple(np.clip(colour, 0, 100)),
            )
        )

    def _append(self, name: str, kind: str, parts: tuple[SdfPart, ...]) -> None:
        taken = {instance.name for instance in self.world.instances}
        unique, number = name, 2
        while unique in taken:
            unique, number = f"{name}_{number}", number + 1
        self.world.instances.append(SdfInstance(unique, kind, parts))

    def _parts(
        self, model: Element, pose: F64, file: Path, kinds: list[str], depth: int
    ) -> Iterator[SdfPart]:
        """Every geometry of a model element standing at `pose`."""
        if depth > _NEST_MAX:
            raise FormatError(
                f"models are nested deeper than {_NEST_MAX}",
                file=file,
                remedy="a model must not include itself",
            )
        for child in model:
            if child.tag == "include" and not _builtin(_text(child, "uri")):
                yield from self._included(child, pose, file, kinds, depth + 1)
            elif child.tag == "model":
                yield from self._parts(child, pose @ _pose(child, file), file, kinds, depth + 1)
            elif child.tag == "link":
                link = pose @ _pose(child, file)
                for role in ("visual", "collision"):
                    for item in child.findall(role):
                        part = self._part(item, role, link, file)
                        if part is not None:
                            yield part

    def _included(
        self, node: Element, pose: F64, file: Path, kinds: list[str], depth: int
    ) -> Iterator[SdfPart]:
        folder, sdf_file = self._find_model(_text(node, "uri"), file)
        self._count(file)
        kinds.append(folder.name)
        if sdf_file not in self.cache:
            self.cache[sdf_file] = load_xml(sdf_file)
        model = self.cache[sdf_file].find("model")
        if model is None:
            raise FormatError("no <sdf><model> in this file", file=sdf_file)
        own = _pose(node, file) if node.find("pose") is not None else _pose(model, sdf_file)
        yield from self._parts(model, pose @ own, sdf_file, kinds, depth)

    def _count(self, file: Path) -> None:
        self.parts += 1
        if self.parts > _PARTS_MAX:
            raise FormatError(
                f"more than {_PARTS_MAX} models and geometries",
                file=file,
                remedy="a model must not include itself",
            )

    def _find_model(self, uri: str, file: Path) -> tuple[Path, Path]:
        """The folder and SDF file of a `model://` address."""
        folder = self._resolve(uri, file)
        config = folder / "model.config"
        name = "model.sdf"
        if config.is_file():
            entry = load_xml(config, 2**20).find("sdf")
            if entry is not None and (entry.text or "").strip():
                name = (entry.text or "").strip()
        return folder, safe_join(folder, name)

    def _resolve(self, uri: str, file: Path) -> Path:
        scheme, _, rest = uri.partition("://")
        if scheme not in ("model", "package") or not rest:
            raise StorageError(
                f"address {uri!r} is not of the form model://NAME/…",
                where=file,
                remedy="put the model under models/ beside the world and use model://",
            )
        for base in (self.world.root / "models", self.world.root):
            path = safe_join(base, rest)
            if path.exists():
                return path
        raise StorageError(
            f"{uri} is not in the world's folder",
            where=file,
            remedy=f"put it under {self.world.root / 'models'}",
        )

    def _part(self, item: Element, role: Role, link: F64, file: Path) -> SdfPart | None:
        geometry = item.find("geometry")
        if geometry is None or not len(geometry):
            return None
        self._count(file)
        shape = geometry[0]
        size = {
            "mesh": lambda: _numbers(_text(shape, "scale") or "1 1 1", 3, file, "scale"),
            "box": lambda: _numbers(_text(shape, "size"), 3, file, "size"),
            "plane": lambda: np.append(_numbers(_text(shape, "size"), 2, file, "size"), 0),
            "sphere": lambda: np.append(
                _numbers(_text(shape, "radius"), 1, file, "radius"), (0, 0)
            ),
            "cylinder": lambda: np.array(
                (
                    _numbers(_text(shape, "radius"), 1, file, "radius")[0],
                    _numbers(_text(shape, "length"), 1, file, "length")[0],
                    0.0,
                )
            ),
        }.get(shape.tag)
        if size is None:
            self.world.notes.append(f"{file.parent.name}: <{shape.tag}> geometry is left out")
            return None
        mesh = self._resolve(_text(shape, "uri"), file) if shape.tag == "mesh" else None
        diffuse = item.find("material/diffuse")
        colour = None
        if diffuse is not None:
            colour = _triple(np.clip(_numbers(diffuse.text or "", 3, file, "diffuse"), 0, 1))
        return SdfPart(
            role=role,
            shape=shape.tag,
            mesh=mesh,
            model=file.parent,
            size=_triple(size()),
            pose=link @ _pose(item, file),
            colour=colour,
        )


def _builtin(uri: str) -> bool:
    return uri.removeprefix("model://").strip("/") in _BUILTIN


def _plane(root: Path) -> SdfPart:
    return SdfPart(
        "visual", "plane", None, root, (100.0, 100.0, 0.0), np.eye(4), (0.45, 0.45, 0.45)
    )


def _text(node: Element, tag: str) -> str:
    return (node.findtext(tag) or "").strip()


def _triple(values: F64) -> tuple[float, float, float]:
    a, b, c = (float(v) for v in values)
    return a, b, c


def _numbers(text: str, least: int, file: Path, field_: str) -> F64:
    """The first `least` numbers of a text.

    Raises:
        FormatError: fewer, or not finite.
    """
    try:
        values = [float(token) for token in text.split()[:least]]
    except ValueError:
        values = []
    if len(values) < least or not all(math.isfinite(v) and abs(v) < 1e7 for v in values):
        raise FormatError(
            f"expected {least} finite numbers, found {text[:80]!r}",
            file=file,
            field=field_,
            remedy="correct the numbers",
        )
    return np.array(values)


def _pose(node: Element, file: Path) -> F64:
    """The transform [4, 4] of an element's `<pose>`, identity without one."""
    text = _text(node, "pose")
    out = np.eye(4)
    if text:
        x, y, z, roll, pitch, yaw = _numbers(text, 6, file, "pose")
        cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
        cy, sy = math.cos(yaw), math.sin(yaw)
        out[:3, :3] = (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
        out[:3, 3] = (x, y, z)
    return out
