"""SDF worlds (Gazebo): which meshes stand where. Models come from the world's folder only.

Poses are `x y z roll pitch yaw`, metres and radians, nested world → model → link → visual. An
`<include>` with a pose replaces the pose of the model that it includes (SDF 1.6).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np

from gn0.errors import FormatError, Gn0Error, StorageError
from gn0.geometry import F64
from gn0.scenes.world_defects import WorldDefect, defect_of, refuse_defects
from gn0.scenes.world_files import WorldFiles
from gn0.scenes.xml import load_xml
from gn0.storage import safe_join

_NEST_MAX = 16
_PARTS_MAX = 100_000
_BUILTIN = {"sun", "ground_plane"}  # model:// names that every Gazebo brings along

Role = Literal["visual", "collision"]
_ROLES: tuple[Role, Role] = ("visual", "collision")


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
        link: number of the link that it belongs to; what is seen and what is bumped into share it.
        fault: why a mesh has no file, None when it has.
    """

    role: Role
    shape: str
    mesh: Path | None
    model: Path
    size: tuple[float, float, float]
    pose: F64
    colour: tuple[float, float, float] | None = None
    link: int = -1
    fault: Gn0Error | None = None


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
    """What a world file describes.

    Attributes:
        root: the world's folder; nothing outside it is opened.
        file: the world file.
        strict: whether a defect is an error; else it is mended or left out, and listed.
        instances, lights: what stands and shines in it.
        notes: what is worth saying, in words.
        defects: what was mended or left out.
    """

    root: Path
    file: Path
    strict: bool = True
    instances: list[SdfInstance] = field(default_factory=list)
    lights: list[SdfLight] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    defects: list[WorldDefect] = field(default_factory=list)


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


def load_sdf(file: Path, *, strict: bool = True) -> SdfWorld:
    """Read a world and every model it includes.

    Args:
        file: the world file.
        strict: refuse a world with defects; else what is defective is mended or left out, and
            listed in `defects`.

    Raises:
        StorageError: strict: a model is missing, or a path climbs out of the world's folder.
        FormatError: the world file is not SDF, or holds absurdly much; strict: so is a model, or a
            number in it is no number.
        SceneError: strict: there are several such defects; lists them.
    """
    root = file.parent.parent if file.parent.name == "worlds" else file.parent
    world = SdfWorld(root=root, file=file, strict=strict)
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
    if strict:
        refuse_defects(world.defects, file)
    return world


class _Reader:
    def __init__(self, world: SdfWorld) -> None:
        self.world = world
        self.files = WorldFiles(world.root)
        self.cache: dict[Path, Element] = {}
        self.parts = 0
        self.links = 0
        self.inside: list[Path] = []  # models that the one being read is included by

    def add_instance(self, node: Element) -> None:
        name = node.get("name") or f"model_{len(self.world.instances)}"
        kinds: list[str] = []
        file = self.world.file
        with self._leaving_out(name):
            parts = tuple(self._parts(node, _pose(node, file), file, kinds, depth=0))
            self._append(name, kinds[0] if kinds else name, parts)

    def add_include(self, node: Element) -> None:
        uri = _text(node, "uri")
        if _builtin(uri):
            if uri.endswith("ground_plane"):
                self._append("ground_plane", "ground_plane", (_plane(self.world.root),))
            return
        kinds: list[str] = []
        with self._leaving_out(_text(node, "name") or uri or "include"):
            parts = tuple(self._included(node, np.eye(4), self.world.file, kinds, depth=0))
            name = _text(node, "name") or (kinds[0] if kinds else "model")
            self._append(name, kinds[0] if kinds else name, parts)

    def add_light(self, node: Element) -> None:
        file = self.world.file
        with self._leaving_out(node.get("name") or "light"):
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

    @contextmanager
    def _leaving_out(self, what: str) -> Iterator[None]:
        """Go on without a piece that cannot be read, and say so; absurd amounts still end it."""
        try:
            yield
        except Gn0Error as error:
            if self.parts > _PARTS_MAX:
                raise
            found = defect_of(error, done=f"left out ({what[:80]})" if what else "left out")
            self.world.defects.append(found)

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
            with self._leaving_out(child.get("name") or _text(child, "uri")):
                yield from list(self._child(child, pose, file, kinds, depth))

    def _child(
        self, child: Element, pose: F64, file: Path, kinds: list[str], depth: int
    ) -> Iterator[SdfPart]:
        if child.tag == "include" and not _builtin(_text(child, "uri")):
            yield from self._included(child, pose, file, kinds, depth + 1)
        elif child.tag == "model":
            yield from self._parts(child, pose @ _pose(child, file), file, kinds, depth + 1)
        elif child.tag == "link":
            link = pose @ _pose(child, file)
            self.links += 1
            number = self.links
            for role in _ROLES:
                for item in child.findall(role):
                    with self._leaving_out(item.get("name") or role):
                        part = self._part(item, role, link, file, number)
                        if part is not None:
                            yield part

    def _included(
        self, node: Element, pose: F64, file: Path, kinds: list[str], depth: int
    ) -> Iterator[SdfPart]:
        folder, sdf_file = self._find_model(_text(node, "uri"), file)
        self._count(file)
        if sdf_file in self.inside:
            raise FormatError("a model must not include itself", file=sdf_file)
        kinds.append(folder.name)
        if sdf_file not in self.cache:
            self.cache[sdf_file] = load_xml(sdf_file)
        model = self.cache[sdf_file].find("model")
        if model is None:
            raise FormatError("no <sdf><model> in this file", file=sdf_file)
        own = _pose(node, file) if node.find("pose") is not None else _pose(model, sdf_file)
        self.inside.append(sdf_file)
        try:
            yield from list(self._parts(model, pose @ own, sdf_file, kinds, depth))
        finally:
            self.inside.pop()

    def _count(self, file: Path) -> None:
        self.parts += 1
        if self.parts > _PARTS_MAX:
            raise FormatError(
                f"more than {_PARTS_MAX} models and geometries",
                file=file,
                remedy="a model must not include itself",
            )

    def _find_model(self, uri: str, file: Path) -> tuple[Path, Path]:
        """The folder and SDF file of a model's address."""
        found = self._find(uri, file)
        if found.is_file():
            return found.parent, found
        name = self._sdf_named(found / "model.config") or "model.sdf"
        path = safe_join(found, name)
        if not path.is_file():
            others = sorted(item for item in found.glob("*.[sS][dD][fF]") if item.is_file())
            if others:
                path = safe_join(found, others[-1].name)
                self._mended(found, f"it has no {name}", f"{path.name} is read")
        return found, path

    def _sdf_named(self, config: Path) -> str:
        if not config.is_file():
            return ""
        try:
            entry = load_xml(config, 2**20).find("sdf")
        except FormatError as error:
            self.world.defects.append(defect_of(error, done="model.sdf is read"))
            return ""
        return (entry.text or "").strip() if entry is not None else ""

    def _find(self, uri: str, file: Path) -> Path:
        """The file or folder of an address; says so when it took a guess.

        Raises:
            StorageError: there is nothing of that name in the world's folder.
        """
        path, exact = self.files.find(uri, file.parent, file)
        if not exact:
            short = path.resolve().relative_to(self.world.root.resolve())
            error = StorageError(
                f"address {uri[:200]!r} is not of the form model://NAME/…",
                where=file,
                remedy="put the model under models/ beside the world and use model://",
            )
            self._mended(file, f"address {uri[:200]}", f"read as {short}", error)
        return path

    def _mended(self, file: Path, what: str, done: str, error: Gn0Error | None = None) -> None:
        self.world.defects.append(WorldDefect(str(file), what, done, error))

    def _part(
        self, item: Element, role: Role, link: F64, file: Path, number: int
    ) -> SdfPart | None:
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
        mesh: Path | None = None
        fault: Gn0Error | None = None
        if shape.tag == "mesh":
            try:
                mesh = self._find(_text(shape, "uri"), file)
                if not mesh.is_file():
                    fault = StorageError("the mesh is not a file", where=mesh)
            except StorageError as error:
                fault = error
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
            link=number,
            fault=fault,
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
