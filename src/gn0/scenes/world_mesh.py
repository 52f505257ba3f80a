"""The meshes of an SDF world, placed: one mesh to see, one to collide with."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gn0.errors import FormatError, Gn0Error
from gn0.gaussians.film import decode_srgb
from gn0.geometry import F64
from gn0.progress import Progress, no_progress
from gn0.scenes.collada import ColladaPart, load_collada
from gn0.scenes.mesh import SceneMesh, join_meshes
from gn0.scenes.sdf import SdfInstance, SdfPart, SdfWorld
from gn0.scenes.textures import Paint, load_texture
from gn0.scenes.world_defects import (
    WorldDefect,
    defect_lines,
    defect_of,
    refuse_defects,
    told_within,
)
from gn0.scenes.world_strays import drop_strays

_SHELL = {"floor", "ground", "wall", "ceiling", "roof", "ground plane"}
_SYNONYMS = {
    "airconditioner": "air conditioner",
    "rangehood": "range hood",
    "portrait": "picture",
    "desk portrait": "photo frame",
    "night stand": "nightstand",
    "trash": "trash can",
    "tv": "television",
    "board": "notice board",
    "light": "lamp",
    "house wall": "wall",
    "room wall": "wall",
    "room ceiling": "ceiling",
    "room window": "window",
    "cluttering": "clutter",
}
# a missing picture gets the colour that its object most likely has (display values)
_PLAUSIBLE = {
    "carpet": (0.55, 0.47, 0.40),
    "photo frame": (0.72, 0.70, 0.66),
    "picture": (0.62, 0.58, 0.52),
    "wall": (0.85, 0.84, 0.81),
    "floor": (0.60, 0.50, 0.40),
}
_GREY = (0.66, 0.64, 0.61)


@dataclass(frozen=True, eq=False)
class WorldMeshes:
    """An SDF world as triangles.

    Attributes:
        visual: what is seen; `material` indexes `paints`, `instance` the categories (−1 shell).
        collision: what is bumped into, same instances.
        paints: materials.
        names, categories: per instance that is an object.
        yaws: heading of the model's own axes per object [rad].
        notes: what was missing, in words.
        defects: what was mended or left out, the world file's own included.
        sky_paint: index of the paint that shows the sky outside, −2 without one.
    """

    visual: SceneMesh
    collision: SceneMesh
    paints: list[Paint]
    names: list[str]
    categories: list[str]
    yaws: list[float]
    notes: list[str]
    defects: list[WorldDefect] = field(default_factory=list)
    sky_paint: int = -2

    def shifted(self, dz: float) -> WorldMeshes:
        """The same, moved up by `dz` [m]."""
        up = np.array((0.0, 0.0, dz))
        return replace(
            self,
            visual=replace(self.visual, vertices=self.visual.vertices + up),
            collision=replace(self.collision, vertices=self.collision.vertices + up),
        )


def category_of(kind: str, prefix: str = "") -> str:
    """A model's name as lower-case words: 'acme_residential_KitchenTable_01' → 'kitchen table'.

    Args:
        kind: name of the model's folder.
        prefix: what all names of the world begin with.
    """
    name = kind.removeprefix(prefix)
    tokens = [token for token in re.split(r"[_\-. ]+", name) if token and not token.isdigit()]
    words: list[str] = []
    for token in tokens:
        pieces = re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+", token)
        if len(pieces) > 1 and re.fullmatch(r"[A-Z]", pieces[-1]):
            pieces.pop()  # the variant letter of 'ChairA'
        words += [piece.lower() for piece in pieces if not piece.isdigit()]
    text = " ".join(words) or "object"
    return _SYNONYMS.get(text, text)


def common_prefix(kinds: list[str]) -> str:
    """The underscore-separated beginning that nearly all model names share."""
    best = ""
    split = [kind.split("_") for kind in kinds]
    for length in range(1, 6):
        heads = ["_".join(tokens[:length]) + "_" for tokens in split if len(tokens) > length]
        if not heads:
            break
        top = max(sorted(set(heads)), key=heads.count)
        if len(kinds) < 3 or heads.count(top) < 0.8 * len(kinds):
            break
        best = top
    return best


def is_shell(category: str) -> bool:
    """Whether a category is part of the building rather than an object in it."""
    return category in _SHELL or category.split()[-1] in _SHELL


def load_world_meshes(world: SdfWorld, progress: Progress = no_progress) -> WorldMeshes:
    """Load and place every mesh of a world.

    What is seen but has no readable mesh is shown by what is bumped into there; parts far from the
    rest or absurdly large are left out. `defects` lists it all.

    Raises:
        FormatError: there is nothing to see; strict: a mesh is damaged.
        StorageError: strict: a mesh is missing; names the file.
        SceneError: strict: there are several such defects; lists them.
    """
    loader = _Loader(world)
    for done, instance in enumerate(world.instances):
        progress("loading meshes", done, len(world.instances))
        loader.add(instance)
    progress("loading meshes", len(world.instances), len(world.instances))
    return loader.finish()


@dataclass(eq=False)
class _Loader:
    world: SdfWorld
    prefix: str = ""
    meshes: dict[str, list[SceneMesh]] = field(
        default_factory=lambda: {"visual": [], "collision": []}
    )
    cache: dict[Path, list[ColladaPart] | Gn0Error] = field(default_factory=dict)
    paints: list[Paint] = field(default_factory=list)
    paint_of: dict[object, int] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    categories: list[str] = field(default_factory=list)
    yaws: list[float] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    defects: list[WorldDefect] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.prefix = common_prefix([instance.kind for instance in self.world.instances])

    def add(self, instance: SdfInstance) -> None:
        category = category_of(instance.kind, self.prefix)
        index = -1
        if not is_shell(category):
            index = len(self.names)
            self.names.append(instance.name)
            self.categories.append(category)
            first = instance.parts[0].pose if instance.parts else np.eye(4)
            self.yaws.append(float(np.arctan2(first[1, 0], first[0, 0])))
        for _, group in groupby(instance.parts, key=lambda part: part.link):
            for part, pieces in self._whole(list(group), instance.name, category):
                for piece in pieces:
                    self.meshes[part.role].append(self._placed(piece, part, index, category))

    def _whole(
        self, parts: list[SdfPart], name: str, category: str
    ) -> Iterator[tuple[SdfPart, list[ColladaPart]]]:
        """The parts of one link with their triangles; stand-ins for meshes that cannot be read."""
        loaded = [(part, *self._pieces(part)) for part in parts]
        seen = [entry for entry in loaded if entry[0].role == "visual"]
        bumped = [entry for entry in loaded if entry[0].role == "collision"]
        paired = len(seen) == len(bumped)
        nothing = not any(pieces for _, pieces, _ in seen)
        spent = False
        for number, (part, pieces, error) in enumerate(seen):
            if error is None:
                yield part, pieces
                continue
            stand_ins = [bumped[number]] if paired else ([] if spent or not nothing else bumped)
            stand_ins = [entry for entry in stand_ins if entry[1]]
            spent = True
            for other, shapes, _ in stand_ins:
                colour = part.colour or _PLAUSIBLE.get(category, _GREY)
                plain = [replace(shape, texture="", colour=colour) for shape in shapes]
                yield replace(other, role="visual", colour=part.colour), plain
            done = "its collision mesh is shown" if stand_ins else f"left out ({name})"
            self.defects.append(defect_of(error, done=done))
        for part, pieces, error in bumped:
            if error is None:
                yield part, pieces
            else:
                self.defects.append(defect_of(error, done=f"left out (what blocks in {name})"))

    def finish(self) -> WorldMeshes:
        defects = told_within([*self.world.defects, *self.defects], self.world.root)
        if not self.meshes["visual"]:
            if self.world.strict:
                refuse_defects(defects, self.world.file)
            told = "; ".join(line.strip() for line in defect_lines(defects))
            raise FormatError(
                "the world has no visible geometry" + (f": {told}" if told else ""),
                file=self.world.file,
                remedy="give a world whose models have visuals",
            )
        visual = join_meshes(self.meshes["visual"])
        collision = join_meshes(self.meshes["collision"] or self.meshes["visual"])
        visual, collision, strays = drop_strays(
            visual, collision, self.names, self.categories, self.world.file.name
        )
        defects += strays
        if self.world.strict:
            refuse_defects(defects, self.world.file)
        return WorldMeshes(
            visual=visual,
            collision=collision,
            paints=self.paints,
            names=self.names,
            categories=self.categories,
            yaws=self.yaws,
            notes=[*self.world.notes, *self.notes],
            defects=defects,
        )

    def _pieces(self, part: SdfPart) -> tuple[list[ColladaPart], Gn0Error | None]:
        """The triangles of a part, or why there are none."""
        if part.fault is not None:
            return [], part.fault
        if part.mesh is None:
            return [_primitive(part)], None
        if part.mesh not in self.cache:
            try:
                self.cache[part.mesh] = _load_mesh(part.mesh)
            except Gn0Error as error:
                self.cache[part.mesh] = error
        found = self.cache[part.mesh]
        return ([], found) if isinstance(found, Gn0Error) else (found, None)

    def _placed(self, piece: ColladaPart, part: SdfPart, index: int, category: str) -> SceneMesh:
        scale = np.asarray(part.size if part.shape == "mesh" else (1.0, 1.0, 1.0))
        vertices = (piece.vertices * scale) @ part.pose[:3, :3].T + part.pose[:3, 3]
        faces = piece.faces if np.prod(scale) > 0 else piece.faces[:, ::-1]
        uv = piece.uv if np.prod(scale) > 0 else piece.uv[:, ::-1]
        paint = 0 if part.role == "collision" else self._paint(piece, part, category)
        n = len(faces)
        return SceneMesh(
            vertices=vertices,
            faces=np.ascontiguousarray(faces),
            uv=np.ascontiguousarray(uv),
            material=np.full(n, paint, np.int32),
            instance=np.full(n, index, np.int32),
        )

    def _paint(self, piece: ColladaPart, part: SdfPart, category: str) -> int:
        colour = part.colour or piece.colour
        key: object = ("colour", colour)
        path: Path | None = None
        if piece.texture:
            path = self._find_texture(piece.texture, part)
            missing = ("missing", piece.texture, part.model)
            key = missing if path is None else path
        if key not in self.paint_of:
            picture = load_texture(path) if path is not None else None
            if piece.texture and picture is None:
                name = Path(piece.texture.replace("\\", "/")).name
                state = "missing" if path is None else "unreadable"
                self.notes.append(f"texture {name} of {part.model.name} is {state}")
                colour = _PLAUSIBLE.get(category, _GREY)
            r, g, b = (float(v) for v in decode_srgb(np.array(colour)))
            tint = (1.0, 1.0, 1.0) if picture is not None else (r, g, b)
            self.paint_of[key] = len(self.paints)
            self.paints.append(Paint(tint, picture))
        return self.paint_of[key]

    def _find_texture(self, written: str, part: SdfPart) -> Path | None:
        """The picture inside the world's folder: beside the mesh, else by its bare name."""
        root = self.world.root.resolve()
        base = part.mesh.parent if part.mesh is not None else part.model
        path = written.replace("\\", "/").removeprefix("file://")
        name = path.rsplit("/", 1)[-1]
        folders = (part.model / "materials" / "textures", part.model, base)
        for candidate in (base / path, *(folder / name for folder in folders)):
            try:
                inside = candidate.resolve().is_relative_to(root)
                if inside and candidate.is_file():
                    return candidate.resolve()
            except (OSError, ValueError, RuntimeError):
                continue
        for folder in folders:  # worlds from Windows do not care about case
            if folder.is_dir():
                for item in sorted(folder.iterdir()):
                    if item.name.lower() == name.lower() and item.is_file():
                        return item.resolve()
        return None


def _load_mesh(path: Path) -> list[ColladaPart]:
    if path.suffix.lower() == ".dae":
        return load_collada(path)
    if path.suffix.lower() not in (".stl", ".obj"):
        raise FormatError(
            f"meshes of type {path.suffix!r} are not supported",
            file=path,
            remedy="use COLLADA (.dae), .obj or .stl",
        )
    try:
        mesh: Any = trimesh.load(path, force="mesh", process=False, skip_materials=True)
        vertices = np.asarray(mesh.vertices, np.float64)
        faces = np.asarray(mesh.faces, np.int32)
    except Exception as error:  # trimesh lets its parsers' errors through
        raise FormatError(f"not a readable mesh: {error}", file=path) from None
    if not len(faces) or not np.isfinite(vertices).all() or faces.max() >= len(vertices):
        raise FormatError("the mesh is empty or not finite", file=path)
    return [_plain(vertices, faces)]


def _plain(vertices: F64, faces: np.ndarray) -> ColladaPart:
    uv = np.zeros((len(faces), 3, 2), np.float32)
    return ColladaPart(vertices, np.ascontiguousarray(faces, np.int32), uv, (0.7, 0.7, 0.7), "")


def _primitive(part: SdfPart) -> ColladaPart:
    a, b, c = part.size
    if part.shape == "box":
        mesh = trimesh.creation.box(extents=(a, b, c))
    elif part.shape == "sphere":
        mesh = trimesh.creation.uv_sphere(radius=a, count=(24, 24))
    elif part.shape == "cylinder":
        mesh = trimesh.creation.cylinder(radius=a, height=b, sections=48)
    else:
        x, y = a / 2, b / 2
        corners = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
        return _plain(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    return _plain(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32))
