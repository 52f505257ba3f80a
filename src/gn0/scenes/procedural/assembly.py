"""Items of furniture and the assembly that turns placed items into one mesh with objects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gn0.geometry import F64
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.procedural.draft import Lamp, Material
from gn0.scenes.procedural.prints import PRINTS
from gn0.scenes.procedural.shapes import Shape
from gn0.scenes.scene import ObjectBox, SceneObject

WHOLE_PICTURE = frozenset(
    {
        *("picture_landscape", "picture_abstract", "picture_portrait", "screen", "sky"),
        *("rug_border", "rug_persian", "scribbles"),
        *("facade_glass", "open_sky"),
        *PRINTS,
    }
)


@dataclass(frozen=True)
class Support:
    """A flat place on an item where small things may stand: rectangle and height [m].

    `head` is the clear height above it [m].
    """

    x0: float
    x1: float
    y0: float
    y1: float
    z: float
    head: float = 0.6


@dataclass(frozen=True, eq=False)
class Item:
    """A thing of one category in its own frame: base centre at the origin, front towards −y.

    Attributes:
        category: lower-case words.
        shapes: its pieces.
        supports: where small things may stand on it.
        parts: other items that come with it (cushions on a sofa).
        lamps: light it gives.
    """

    category: str
    shapes: tuple[Shape, ...]
    supports: tuple[Support, ...] = ()
    parts: tuple[Placed, ...] = ()
    lamps: tuple[Lamp, ...] = ()

    @cached_property
    def _extent(self) -> F64:
        v = np.concatenate([s.vertices for s in self.shapes])
        return np.stack([v.min(axis=0), v.max(axis=0)])

    def extent(self) -> F64:
        """Lower and upper corner [2, 3] m of its own pieces."""
        return self._extent

    def full_extent(self) -> F64:
        """Lower and upper corner [2, 3] m with all its parts."""
        return self._full_extent

    @cached_property
    def _full_extent(self) -> F64:
        boxes = [self.extent()]
        for part in self.parts:
            low, high = part.item.full_extent()
            c, s = math.cos(part.yaw), math.sin(part.yaw)
            for x in (low[0], high[0]):
                for y in (low[1], high[1]):
                    p = (c * x - s * y + part.x, s * x + c * y + part.y)
                    boxes.append(np.array([[*p, low[2] + part.z], [*p, high[2] + part.z]]))
        every = np.concatenate(boxes)
        return np.stack([every.min(axis=0), every.max(axis=0)])

    @property
    def size(self) -> tuple[float, float, float]:
        """Width, depth and height of its own pieces [m]."""
        low, high = self.extent()
        w, d, h = (float(v) for v in high - low)
        return (w, d, h)

    def with_parts(self, parts: Sequence[Placed]) -> Item:
        """The same item with more parts."""
        return replace(self, parts=(*self.parts, *parts))


@dataclass(frozen=True, eq=False)
class Placed:
    """An item at (x, y, z) [m], turned by yaw [rad]."""

    item: Item
    x: float
    y: float
    z: float = 0.0
    yaw: float = 0.0


@dataclass
class Assembly:
    """Collects shell and items; `finish` gives the mesh, materials, objects and lamps."""

    shapes: list[Shape] = field(default_factory=list)
    owners: list[int] = field(default_factory=list)
    objects: list[SceneObject] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    def add_shell(self, *shapes: Shape) -> None:
        """Add pieces of the building itself."""
        self.shapes += shapes
        self.owners += [-1] * len(shapes)

    def add_item(self, placed: Placed, room: str | None) -> None:
        """Add an item and its parts as objects of a room."""
        item, yaw = placed.item, placed.yaw
        c, s = math.cos(yaw), math.sin(yaw)
        number = self.counts[item.category] = self.counts.get(item.category, 0) + 1
        low, high = item.extent()
        middle, size = (low + high) / 2, high - low
        centre = (
            round(float(c * middle[0] - s * middle[1] + placed.x), 5),
            round(float(s * middle[0] + c * middle[1] + placed.y), 5),
            round(float(middle[2] + placed.z), 5),
        )
        w, d, h = (round(float(v) + 1e-4, 5) for v in size)  # the rounding stays inside
        box = ObjectBox(centre=centre, size=(w, d, h), yaw=round(float(yaw), 7))
        me = len(self.objects)
        name = f"{item.category.replace(' ', '_')}_{number}"
        self.objects.append(SceneObject(id=name, category=item.category, box=box, room=room))
        for shape in item.shapes:
            self.shapes.append(shape.moved(placed.x, placed.y, placed.z, yaw))
            self.owners.append(me)
        for lamp in item.lamps:
            x, y, z = lamp.centre
            at = (c * x - s * y + placed.x, s * x + c * y + placed.y, z + placed.z)
            dx, dy, dz = lamp.direction
            way = (c * dx - s * dy, s * dx + c * dy, dz)
            self.lamps.append(
                Lamp(
                    centre=(round(at[0], 5), round(at[1], 5), round(at[2], 5)),
                    size=lamp.size,
                    shape=lamp.shape,
                    colour=lamp.colour,
                    direction=(round(way[0], 6), round(way[1], 6), round(way[2], 6)),
                )
            )
        for part in item.parts:
            self.add_item(
                Placed(
                    part.item,
                    c * part.x - s * part.y + placed.x,
                    s * part.x + c * part.y + placed.y,
                    part.z + placed.z,
                    part.yaw + yaw,
                ),
                room,
            )

    def finish(self) -> tuple[SceneMesh, tuple[Material, ...]]:
        """One mesh of everything and the table of its materials."""
        table: dict[Material, int] = {}
        uvs, materials, starts = [], [], [0]
        for k, shape in enumerate(self.shapes):
            index = table.setdefault(shape.material, len(table))
            materials.append(np.full(len(shape.faces), index, np.int32))
            uv = shape.uv
            if shape.material.pattern not in WHOLE_PICTURE and self.owners[k] >= 0:
                # boards of one wood must not repeat one another
                uv = uv + np.array([(k * 0.618) % 1 * 4, (k * 0.7549) % 1 * 4], np.float32)
            uvs.append(uv)
            starts.append(starts[-1] + len(shape.vertices))
        mesh = SceneMesh(
            # rounded, so that pieces which touch share their vertices exactly
            vertices=np.round(np.concatenate([s.vertices for s in self.shapes]), 5) + 0.0,
            faces=np.concatenate(
                [s.faces + o for s, o in zip(self.shapes, starts, strict=False)]
            ).astype(np.int32),
            uv=np.concatenate(uvs).astype(np.float32),
            material=np.concatenate(materials),
            instance=np.repeat(
                np.array(self.owners, np.int32), [len(s.faces) for s in self.shapes]
            ),
        )
        return mesh, tuple(table)
