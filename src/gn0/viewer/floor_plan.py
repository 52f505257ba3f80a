"""A floor plan drawn from a scene: rooms, walls, furniture, names, a scale bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gn0.maps.grid import FREE, OCCUPIED
from gn0.scenes.scene import Scene, SceneObject

INK = (38, 42, 48)
MUTED = (112, 118, 126)
PAPER = (252, 251, 249)
_FLOOR = (240, 237, 230)
_WALL = (62, 66, 74)
_ROOM_TINTS = {
    "kitchen": (252, 226, 188),
    "living room": (214, 230, 244),
    "bedroom": (226, 217, 241),
    "dining room": (248, 231, 207),
    "bathroom": (202, 234, 232),
    "study": (219, 236, 211),
    "gym": (245, 219, 214),
    "hallway": (236, 231, 219),
    "balcony": (221, 239, 220),
}
_OTHER_TINTS = ((230, 234, 226), (236, 228, 232), (226, 233, 238), (240, 234, 220))
_HANGING = 1.25  # m: what starts above this hangs
_SUPER = 2  # drawn twice as large, then reduced: smooth lines


@lru_cache(maxsize=32)
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own scalable font."""
    return ImageFont.load_default(size)


def render_plan(
    scene: Scene,
    width: int,
    height: int,
    *,
    keep_clear: Sequence[tuple[float, float]] = (),
    names: bool = True,
) -> Image.Image:
    """The plan as a picture of `width` x `height` pixels: north up, x to the right.

    No name is written over the points `keep_clear` (x, y) [m]. Without `names`, rooms keep theirs,
    each within its room where it fits, and things do not have any: for small pictures.
    """
    return (
        _Plan(scene, width * _SUPER, height * _SUPER, keep_clear)
        .draw(names)
        .resize((width, height), Image.Resampling.LANCZOS)
    )


def plan_bounds(scene: Scene, margin: float = 0.4) -> tuple[float, float, float, float]:
    """What is worth showing [m]: all cells that are not unknown, plus a margin."""
    known = np.argwhere(scene.grid.cells != 2)
    if not len(known):
        return scene.grid.bounds
    (r0, c0), (r1, c1) = known.min(axis=0), known.max(axis=0) + 1
    x, y = scene.grid.origin
    s = scene.grid.resolution
    return (
        float(x + c0 * s - margin),
        float(y + r0 * s - margin),
        float(x + c1 * s + margin),
        float(y + r1 * s + margin),
    )


_Bounds = tuple[float, float, float, float]  # left, bottom, right, top [px]


class _Plan:
    def __init__(
        self,
        scene: Scene,
        width: int,
        height: int,
        keep_clear: Sequence[tuple[float, float]] = (),
    ) -> None:
        self.scene = scene
        x0, y0, x1, y1 = plan_bounds(scene)
        self.scale = min(width / (x1 - x0), height / (y1 - y0))  # pixels a metre
        self.x = x0 - (width / self.scale - (x1 - x0)) / 2
        self.y = y0 - (height / self.scale - (y1 - y0)) / 2
        self.height = height
        self.image = Image.new("RGB", (width, height), PAPER)
        self.pen = ImageDraw.Draw(self.image)
        self.labels: list[tuple[float, float, float, float]] = []
        self.pixel = _SUPER
        for x, y in keep_clear:
            px, py = self.at(x, y)
            reach = 30 * _SUPER
            self.labels.append((px - reach, py - reach, px + reach, py + reach))

    def at(self, x: float, y: float) -> tuple[float, float]:
        return (x - self.x) * self.scale, self.height - (y - self.y) * self.scale

    def draw(self, names: bool = True) -> Image.Image:
        self._cells(FREE, _FLOOR)
        self._rooms()
        low = [t for t in self.scene.objects if _bottom(t) < _HANGING]
        things = sorted(low, key=lambda t: (t.box.centre[2], t.id))
        for thing in things:
            if _is_flat(thing):
                self._box(thing, fill=None)
        self._cells(OCCUPIED, _WALL)
        for thing in things:
            if not _is_flat(thing):
                self._box(thing, fill=_furniture_colour(thing))
        for thing in self.scene.objects:
            if _bottom(thing) >= _HANGING:
                self._hanging(thing)
        self._openings()
        self._room_names(within=not names)
        if names:
            for thing in sorted(things, key=lambda t: -t.box.size[0] * t.box.size[1]):
                self._name(thing)
        self._scale_bar()
        return self.image

    def _cells(self, value: int, colour: tuple[int, int, int]) -> None:
        grid = self.scene.grid
        mask = (grid.cells == value)[::-1]
        x0, y0, x1, y1 = grid.bounds
        left, top = self.at(x0, y1)
        right, bottom = self.at(x1, y0)
        size = (max(1, round(right - left)), max(1, round(bottom - top)))
        stencil = Image.fromarray((mask * 255).astype(np.uint8)).resize(
            size, Image.Resampling.NEAREST
        )
        self.image.paste(colour, (round(left), round(top)), stencil)

    def _rooms(self) -> None:
        for index, room in enumerate(self.scene.rooms):
            tint = _ROOM_TINTS.get(room.type, _OTHER_TINTS[index % len(_OTHER_TINTS)])
            self.pen.polygon([self.at(x, y) for x, y in room.polygon], fill=tint)

    def _box(self, thing: SceneObject, fill: tuple[int, int, int] | None) -> None:
        corners = [self.at(float(x), float(y)) for x, y, _ in thing.box.corners()[:4]]
        outline = (150, 140, 126) if fill is not None else (196, 188, 176)
        if fill is None:
            self.pen.polygon(corners, fill=(222, 213, 200))
        else:
            self.pen.polygon(corners, fill=fill)
        self.pen.line([*corners, corners[0]], fill=outline, width=self.pixel, joint="curve")

    def _hanging(self, thing: SceneObject) -> None:
        """Lamps and pictures: a dotted outline, for one walks under them."""
        corners = [self.at(float(x), float(y)) for x, y, _ in thing.box.corners()[:4]]
        for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
            dots = max(2, round(math.hypot(bx - ax, by - ay) / (4 * self.pixel)))
            for k in range(dots):
                x, y = ax + (bx - ax) * k / dots, ay + (by - ay) * k / dots
                self.pen.ellipse((x - 1, y - 1, x + 1, y + 1), fill=(150, 140, 126))

    def _openings(self) -> None:
        for opening in self.scene.openings:
            p = np.asarray(opening.polygon)[:, :2]
            low, high = p.min(axis=0), p.max(axis=0)
            colour = (120, 170, 214) if opening.kind == "WINDOW" else (176, 132, 88)
            self.pen.line(
                [self.at(*low.tolist()), self.at(*high.tolist())],
                fill=colour,
                width=max(2, round(0.07 * self.scale)),
            )

    def _room_names(self, within: bool) -> None:
        for room in self.scene.rooms:
            p = np.asarray(room.polygon)
            area = _area(p)
            if area < 1.5:
                continue
            text = f"{room.type.upper()}  {area:.0f} sq m"
            spots = _quiet_spots(self.scene, p)
            sizes = (15, 13, 11, 9)
            tries: list[tuple[str, int, _Bounds | None]] = [(text, size, None) for size in sizes]
            if within:  # a name over the neighbour's floor would be taken for the neighbour's
                name, own = room.type.upper(), (*self.at(*p.min(axis=0)), *self.at(*p.max(axis=0)))
                tries = [(said, size, own) for said in (text, name) for size in sizes]
                tries += [(name, size, None) for size in sizes[::-1]]
            for said, size, bounds in tries:
                if self._place(said, spots, size, (84, 92, 104), halo=2, bounds=bounds):
                    break

    def _name(self, thing: SceneObject) -> None:
        width, depth, _ = thing.box.size
        if max(width, depth) < 0.35 or (min(width, depth) < 0.12 and max(width, depth) < 1.5):
            return
        if thing.category in ("window", "curtain"):
            return
        x, y = thing.box.centre[0], thing.box.centre[1]
        lift = 8 * self.pixel / self.scale
        spots = [(x, y), (x, y + lift), (x, y - lift), (x, y + 2 * lift), (x, y - 2 * lift)]
        for size in (11, 10, 9):
            if self._place(thing.category, spots, size, INK, halo=2):
                return

    def _place(
        self,
        text: str,
        spots: list[tuple[float, float]],
        size: int,
        colour: tuple[int, int, int],
        halo: int,
        bounds: _Bounds | None = None,
    ) -> bool:
        """Write a text at the first spot [m] where it meets no other; False when there is none.

        It stays within `bounds`.
        """
        face = font(size * self.pixel)
        a, b, c, d = self.pen.textbbox((0, 0), text, font=face, anchor="mm")
        for x, y in spots:
            px, py = self.at(x, y)
            box = (px + a - 4, py + b - 3, px + c + 4, py + d + 3)
            inside = box[0] > 0 and box[1] > 0 and box[2] < self.image.width
            if bounds is not None:
                left, bottom, right, top = bounds
                inside &= box[0] > left and box[2] < right and box[1] > top and box[3] < bottom
            clear = all(
                box[2] < o[0] or box[0] > o[2] or box[3] < o[1] or box[1] > o[3]
                for o in self.labels
            )
            if inside and clear and box[3] < self.height:
                self.pen.text(
                    (px, py),
                    text,
                    font=face,
                    fill=colour,
                    anchor="mm",
                    stroke_width=halo * self.pixel // 2,
                    stroke_fill=(255, 255, 255),
                )
                self.labels.append(box)
                return True
        return False

    def _scale_bar(self) -> None:
        metres = next((m for m in (10, 5, 2, 1) if m * self.scale < 0.3 * self.image.width), 1)
        x, y = 14 * self.pixel, self.height - 14 * self.pixel
        length = metres * self.scale
        thick = 5 * self.pixel
        self.pen.rectangle((x, y - thick, x + length / 2, y), fill=INK)
        self.pen.rectangle((x, y - thick, x + length, y), outline=INK, width=self.pixel)
        self.pen.text(
            (x + length + 6 * self.pixel, y - thick / 2),
            f"{metres} m",
            font=font(12 * self.pixel),
            fill=INK,
            anchor="lm",
        )


def _bottom(thing: SceneObject) -> float:
    return thing.box.centre[2] - thing.box.size[2] / 2


def _is_flat(thing: SceneObject) -> bool:
    """Carpets and the like: drawn under everything else."""
    return thing.box.size[2] < 0.06 and thing.box.centre[2] < 0.2


def _furniture_colour(thing: SceneObject) -> tuple[int, int, int]:
    """A calm colour per category; higher things a little darker."""
    hue = sum((i + 1) * ord(c) for i, c in enumerate(thing.category)) % 24
    angle = hue / 24 * 2 * math.pi
    tall = min(thing.box.centre[2] + thing.box.size[2] / 2, 2.2) / 2.2
    base = 226 - 34 * tall
    r = base + 12 * math.cos(angle)
    g = base + 8 * math.cos(angle - 2.1) - 4
    b = base + 14 * math.cos(angle + 2.1) - 14
    return round(r), round(g), round(b)


def _area(polygon: np.ndarray) -> float:
    x, y = polygon.T
    return abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2


def _quiet_spots(scene: Scene, polygon: np.ndarray) -> list[tuple[float, float]]:
    """Places in a room with much free floor round them, best first."""
    from scipy import ndimage

    grid = scene.grid
    free = grid.cells == FREE
    space = ndimage.distance_transform_edt(free)
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    cells = np.argwhere(free)
    xy = grid.centres_of(cells)
    inside = ((xy > low) & (xy < high)).all(axis=1)
    cells, xy = cells[inside][::7], xy[inside][::7]
    if not len(cells):
        return []
    middle = (low + high) / 2
    rank = space[cells[:, 0], cells[:, 1]] * grid.resolution - 0.12 * np.hypot(*(xy - middle).T)
    best = np.argsort(-rank, kind="stable")[:400:8]
    return [(float(x), float(y)) for x, y in xy[best]]
