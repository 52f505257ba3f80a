"""Furniture of offices: desks and what lies on them, screens, cabinets, meeting tables, copiers."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.tables.joinery import build_fronts
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BLACK, CHROME, GREY, PAPER, STEEL, WHITE, Palette, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_extrusion,
    build_panel,
    build_rod,
    build_tube,
    rounded_outline,
)

BINDERS = ("#26282c", "#26282c", "#3a5f9a", "#9a2f2f", "#3f7a4c", "#d8b23a", "#8a8d90", "#e9e6de")
DESK_HEIGHT = 0.73


def without_underside(shape: Shape) -> Shape:
    """A board without its lower face.

    Discs show on both sides: the dark ones below a thin board would shine through its lit top.
    """
    p = shape.vertices[shape.faces]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    keep = normal[:, 2] > -0.9 * np.linalg.norm(normal, axis=1)
    return Shape(shape.vertices, shape.faces[keep], shape.uv[keep], shape.material)


def build_work_desk(top: Material, metal: Material, width: float, depth: float) -> Item:
    """A desk of an open-plan office: a board on two steel frames; the user sits towards −y."""
    h = DESK_HEIGHT
    board = build_box((width, depth, 0.025), top, bevel=0.004, at=(0, 0, h - 0.025))
    shapes = [without_underside(board)]
    for sx in (-1, 1):
        x = sx * (width / 2 - 0.05)
        shapes += [
            build_box((0.05, 0.05, h - 0.05), metal, at=(x, sy * (depth / 2 - 0.06), 0.025))
            for sy in (-1, 1)
        ]
        shapes.append(build_box((0.05, depth - 0.06, 0.025), metal, at=(x, 0, 0)))
    shapes.append(build_box((width - 0.15, 0.03, 0.05), metal, at=(0, 0, h - 0.076)))
    rim = Support(-width / 2 + 0.1, width / 2 - 0.1, -depth / 2 + 0.1, depth / 2 - 0.1, h)
    return Item("desk", tuple(shapes), (rim,))


def build_divider(cloth: Material, width: float) -> Item:
    """A screen of cloth between two facing desks, category "desk divider"."""
    return Item(
        "desk divider",
        (
            build_box((width - 0.04, 0.03, 0.4), cloth, bevel=0.008, at=(0, 0, DESK_HEIGHT + 0.01)),
            *(
                build_box((0.04, 0.05, 0.05), GREY, at=(sx * width * 0.35, 0, DESK_HEIGHT))
                for sx in (-1, 1)
            ),
        ),
    )


def build_cable_tray(width: float) -> Item:
    """A tray of wire under the back edge of a desk; its rim is at z = 0.13."""
    wire = plain("wire", "metal", "#3a3c40", contrast=0.1)
    long = width - 0.3
    shapes = [
        build_box((long, 0.12, 0.008), wire, at=(0, 0, 0)),
        build_box((long, 0.006, 0.1), wire, at=(0, -0.06, 0)),
        build_box((0.5, 0.06, 0.045), WHITE, bevel=0.006, at=(0.05, 0, 0.009)),
    ]
    return Item("cable tray", tuple(shapes))


def build_pedestal(front: Material) -> Item:
    """A drawer unit on castors, category "drawer unit"."""
    w, d, h = 0.41, 0.55, 0.56
    shapes = [build_box((w, d, h - 0.06), front, bevel=0.004, at=(0, 0, 0.06))]
    shapes += build_fronts(w, h - 0.07, 3, 1, -d / 2, 0.065, front, CHROME)
    shapes += [
        build_cylinder(0.03, 0.06, BLACK, at=(sx * 0.16, sy * 0.22, 0), segments=8)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    return Item("drawer unit", tuple(shapes))


def build_tower() -> Item:
    """A computer case, category "computer"."""
    lamp = plain("power light", "plastic", "#7fd0ff", emission=(0.2, 0.4, 0.5))
    return Item(
        "computer",
        (
            build_box((0.18, 0.42, 0.4), BLACK, bevel=0.006),
            build_box((0.15, 0.004, 0.03), GREY, at=(0, -0.211, 0.33)),
            build_box((0.012, 0.004, 0.012), lamp, at=(0.05, -0.211, 0.28)),
        ),
    )


def build_phone() -> Item:
    """A desk telephone."""
    shapes = [
        build_box((0.2, 0.19, 0.03), BLACK, bevel=0.008).tilted("x", 0.12).moved(z=0.014),
        build_box((0.05, 0.2, 0.035), BLACK, bevel=0.014, at=(-0.068, 0, 0.05)),
        build_panel((-0.02, 0.02, 0.062), (0.1, 0, 0), (0, 0.05, 0.006), GREY),
    ]
    shapes += [
        build_box((0.018, 0.014, 0.006), GREY, at=(-0.005 + 0.03 * i, -0.06 + 0.022 * j, 0.044))
        for i in range(3)
        for j in range(3)
    ]
    return Item("telephone", tuple(shapes))


def build_binder(rng: np.random.Generator, thick: float | None = None) -> Item:
    """A lever-arch file standing upright, its back towards −y."""
    t = (0.075 if rng.random() < 0.6 else 0.05) if thick is None else thick
    body = plain("binder", "paper", str(rng.choice(BINDERS)), contrast=0.12, scale=0.01)
    label = plain("label", "paper", "#f2f0e8", contrast=0.45, seed=int(rng.integers(5)))
    ring = build_cylinder(0.014, 0.004, STEEL, segments=10).tilted("x", math.pi / 2)
    return Item(
        "binder",
        (
            build_box((t, 0.27, 0.315), body),
            build_panel((-t * 0.38, -0.1355, 0.15), (t * 0.76, 0, 0), (0, 0, 0.13), label),
            ring.moved(0, -0.1345, 0.055),
        ),
    )


def build_file_shelf(rng: np.random.Generator, palette: Palette, width: float, rows: int) -> Item:
    """An open cabinet of lever-arch files, boxes between them, category "shelf"."""
    d, gap, t = 0.4, 0.36, 0.022
    body = palette.painted(rng) if rng.random() < 0.5 else palette.wood(rng, 0)
    h = rows * gap + 0.07
    shapes = [build_box((t, d, h), body, at=(sx * (width - t) / 2, 0, 0)) for sx in (-1, 1)]
    shapes.append(build_box((width - 2 * t, 0.01, h - 0.05), body, at=(0, d / 2 - 0.005, 0.05)))
    shapes.append(build_box((width, d + 0.004, t), body, bevel=0.003, at=(0, 0, h - t)))
    parts: list[Placed] = []
    free: list[Support] = [Support(-width / 2 + 0.15, width / 2 - 0.15, -0.08, 0.08, h, 0.45)]
    for j in range(rows):
        z = 0.05 + j * gap
        shapes.append(build_box((width - 2 * t, d - 0.02, t), body, at=(0, -0.005, z - t)))
        x, end = -width / 2 + t + 0.01, width / 2 - t - 0.01
        if rng.random() < 0.12:
            free.append(Support(x + 0.1, end - 0.1, -0.08, 0.06, z, gap - t - 0.03))
            continue
        fill = x + (end - x) * float(rng.uniform(0.85, 1.0))
        while True:
            item = build_binder(rng)
            wide = item.size[0] + 0.002
            if x + wide > fill:
                break
            parts.append(Placed(item, x + wide / 2, -0.03, z + 0.001))
            x += wide
            if rng.random() < 0.05:
                x += 0.12
        if end - x > 0.3:
            free.append(Support(x + 0.12, end - 0.1, -0.06, 0.04, z, gap - t - 0.03))
    return Item("shelf", tuple(shapes), tuple(free), tuple(parts))


def build_low_cabinet(rng: np.random.Generator, front: Material, width: float) -> Item:
    """A low cabinet with sliding doors whose top is a support, category "cabinet"."""
    d, h = 0.43, 0.82
    shapes = [
        build_box((width, d, h - 0.05), front, bevel=0.004, at=(0, 0, 0.05)),
        build_box((width - 0.04, d - 0.04, 0.05), BLACK, at=(0, 0.01, 0)),
    ]
    shapes += build_fronts(width, h - 0.09, 1, 2, -d / 2, 0.06, front, CHROME, vertical=True)
    top = Support(-width / 2 + 0.12, width / 2 - 0.12, -d / 2 + 0.12, d / 2 - 0.1, h, 0.7)
    return Item("cabinet", tuple(shapes), (top,))


def build_lockers(rng: np.random.Generator, code: str, columns: int, rows: int) -> Item:
    """A bank of steel lockers on a plinth; each door belongs to a "locker" of its own."""
    w, d, h = 0.32, 0.48, 1.8
    body = plain("locker", "metal", code, contrast=0.1)
    dark = plain("slot", "plastic", "#3a3d40", contrast=0.05)
    parts: list[Placed] = []
    tall = (h - 0.08) / rows
    for i in range(columns):
        for j in range(rows):
            z = 0.08 + j * tall
            shapes = [build_box((w - 0.004, d, tall - 0.004), body, at=(0, 0, 0))]
            shapes += [
                build_box(
                    (w * 0.5, 0.004, 0.008), dark, at=(0, -d / 2 - 0.001, tall - 0.07 - 0.025 * k)
                )
                for k in range(3)
            ]
            shapes.append(
                build_box((0.02, 0.02, 0.07), CHROME, at=(w * 0.36, -d / 2 - 0.008, tall * 0.45))
            )
            number = plain("number", "paper", "#f0efe9", contrast=0.5, seed=int(rng.integers(9)))
            shapes.append(
                build_box((0.06, 0.003, 0.035), number, at=(0, -d / 2 - 0.001, tall * 0.62))
            )
            parts.append(Placed(Item("locker", tuple(shapes)), (i - (columns - 1) / 2) * w, 0.0, z))
    plinth = build_box((columns * w, d - 0.04, 0.08), dark, at=(0, 0.01, 0))
    return Item("plinth", (plinth,), (), tuple(parts))


def build_meeting_table(
    rng: np.random.Generator, palette: Palette, length: float, deep: float
) -> Item:
    """A conference table with rounded ends on two pedestals."""
    wood, metal = palette.wood(rng, 0), palette.metal()
    if rng.random() < 0.35:
        wood = plain("laminate", "plastic", str(rng.choice(["#eceae5", "#d8d5ce"])), contrast=0.06)
    outline = rounded_outline(length, deep, 0.12 if rng.random() < 0.5 else deep * 0.45, 6)
    shapes = [without_underside(build_extrusion(outline, 0.03, wood, at=(0, 0, 0.71)))]
    for sx in (-1, 1):
        x = sx * length * 0.3
        shapes.append(build_box((0.12, 0.4, 0.69), metal, bevel=0.01, at=(x, 0, 0.02)))
        shapes.append(build_box((0.4, 0.7, 0.025), metal, bevel=0.008, at=(x, 0, 0)))
    shapes.append(build_box((0.36, 0.12, 0.012), BLACK, bevel=0.003, at=(0, 0, 0.739)))
    top = Support(-length / 2 + 0.3, length / 2 - 0.3, -deep / 2 + 0.2, deep / 2 - 0.2, 0.74)
    return Item("conference table", tuple(shapes), (top,))


def build_whiteboard(rng: np.random.Generator, width: float = 1.8) -> Item:
    """A whiteboard with writing, a tray with pens and a sponge; back at y = 0, middle at z = 0."""
    h = width * 0.6 if width < 1.9 else 1.2
    board = Material(
        name="whiteboard",
        pattern="scribbles",
        colour=(0.86, 0.87, 0.87),
        colour2=(0.05, 0.12, 0.42),
        scale=round(width / h, 3),
        contrast=0.9,
        seed=int(rng.integers(99)),
    )
    frame = plain("aluminium", "metal", "#b9bcc0", contrast=0.2)
    shapes = [
        build_box((width, 0.018, h), frame, bevel=0.004, at=(0, -0.009, -h / 2)),
        build_panel(
            (-width / 2 + 0.02, -0.0185, -h / 2 + 0.02),
            (width - 0.04, 0, 0),
            (0, 0, h - 0.04),
            board,
            fit=True,
        ),
        build_box((width * 0.5, 0.07, 0.012), frame, at=(0, -0.035, -h / 2 - 0.012)),
    ]
    parts = []
    for k, code in enumerate(("#1c1c1e", "#1f4fa0", "#b3201d", "#2f7a3f")):
        pen = build_rod(
            (-0.06, 0, 0.008), (0.06, 0, 0.008), 0.008, plain("marker", "plastic", code), sides=6
        )
        parts.append(Placed(Item("marker", (pen,)), -width * 0.2 + k * 0.14, -0.045, -h / 2))
    sponge = build_box((0.11, 0.05, 0.035), plain("felt", "fabric", "#3a5f7a"), bevel=0.006)
    parts.append(Placed(Item("board eraser", (sponge,)), width * 0.2, -0.045, -h / 2))
    return Item("whiteboard", tuple(shapes), (), tuple(parts))


def build_flip_chart(rng: np.random.Generator) -> Item:
    """A flip chart on three legs."""
    paper = Material(
        name="flip chart",
        pattern="scribbles",
        colour=(0.84, 0.84, 0.82),
        colour2=(0.03, 0.03, 0.04),
        scale=0.7,
        contrast=0.9,
        seed=int(rng.integers(99)),
    )
    shapes = [
        build_rod((sx * 0.36, -0.2, 0), (sx * 0.1, 0.02, 1.85), 0.013, GREY, sides=6)
        for sx in (-1, 1)
    ]
    shapes.append(build_rod((0, 0.42, 0), (0, 0.02, 1.8), 0.013, GREY, sides=6))
    sheet = build_box((0.68, 0.015, 0.98), WHITE, at=(0, -0.02, 0.9)).tilted("x", -0.0)
    face = build_panel((-0.33, -0.0285, 0.91), (0.66, 0, 0), (0, 0, 0.95), paper, fit=True)
    return Item("flip chart", (*shapes, sheet, face))


def build_copier(rng: np.random.Generator) -> Item:
    """A floor-standing copier, category "printer"."""
    light = plain("copier", "plastic", "#dfe1e2", contrast=0.05)
    panel = plain("panel", "plastic", "#6fa8d0", emission=(0.15, 0.3, 0.4))
    shapes = [
        build_box((0.62, 0.64, 0.72), light, bevel=0.012, at=(0, 0, 0.03)),
        build_box((0.6, 0.6, 0.03), BLACK, at=(0, 0, 0)),
        build_box((0.6, 0.6, 0.14), WHITE, bevel=0.015, at=(0, 0.01, 0.86)),
        build_box((0.08, 0.6, 0.12), light, at=(-0.27, 0.01, 0.74)),
        build_box((0.56, 0.05, 0.12), light, at=(0.02, 0.28, 0.74)),
        build_box((0.4, 0.4, 0.012), PAPER, at=(0.04, 0, 0.755)),
        build_box((0.24, 0.12, 0.02), BLACK, bevel=0.004).tilted("x", 0.5).moved(0.12, -0.34, 0.93),
        build_panel((0.03, -0.385, 0.925), (0.16, 0, 0), (0, 0.07, 0.04), panel),
        build_box((0.3, 0.4, 0.015), light, at=(0.45, 0, 0.55)).tilted("y", 0.0),
    ]
    for z in (0.1, 0.26, 0.42, 0.58):
        shapes.append(build_box((0.58, 0.012, 0.14), WHITE, bevel=0.003, at=(0, -0.322, z)))
        shapes.append(build_box((0.16, 0.01, 0.025), GREY, at=(0, -0.33, z + 0.08)))
    return Item("printer", tuple(shapes))


def build_paper_pack(rng: np.random.Generator) -> Item:
    """A packet of copying paper."""
    code = str(rng.choice(["#2f6fb0", "#e8ebee", "#3f8f5c", "#d8dde2"]))
    return Item(
        "paper pack",
        (build_box((0.21, 0.297, 0.052), plain("wrapper", "paper", code, contrast=0.25)),),
    )


def build_server_rack(rng: np.random.Generator) -> Item:
    """A cabinet of servers with small lights."""
    w, d, h = 0.6, 0.8, 1.95
    shapes = [build_box((w, d, h), BLACK, bevel=0.006)]
    for k in range(12):
        z = 0.12 + k * 0.145
        if rng.random() < 0.15:
            continue
        unit = GREY if rng.random() < 0.3 else plain("server", "metal", "#3b3e43", contrast=0.2)
        shapes.append(build_box((w - 0.08, 0.012, 0.115), unit, at=(0, -d / 2 - 0.004, z)))
        for i in range(3):
            code, level = ("#37d67a", 0.25) if rng.random() < 0.8 else ("#f0a52e", 0.3)
            led = plain("led", "plastic", code, emission=(level, level, level))
            shapes.append(
                build_box(
                    (0.014, 0.004, 0.014), led, at=(-0.2 + 0.03 * i, -d / 2 - 0.011, z + 0.05)
                )
            )
    return Item("server rack", tuple(shapes))


def build_reception_desk(rng: np.random.Generator, palette: Palette, width: float) -> Item:
    """A counter with a high front towards −y and a working level behind it."""
    wood, body = palette.wood(rng, 0), palette.painted(rng)
    d = 0.85
    shapes = [
        build_box((width, 0.08, 1.06), wood, bevel=0.006, at=(0, -d / 2 + 0.04, 0.03)),
        build_box((width - 0.06, 0.06, 0.03), BLACK, at=(0, -d / 2 + 0.05, 0)),
        without_underside(
            build_box((width + 0.06, 0.34, 0.035), body, bevel=0.006, at=(0, -d / 2 + 0.15, 1.09))
        ),
        without_underside(
            build_box((width - 0.1, 0.66, 0.03), body, bevel=0.004, at=(0, 0.1, 0.71))
        ),
    ]
    for sx in (-1, 1):
        shapes.append(
            build_box(
                (0.05, d - 0.08, 1.06), wood, bevel=0.004, at=(sx * (width - 0.05) / 2, 0.02, 0.03)
            )
        )
    lit = plain("strip", "lampshade", "#fff4dc", emission=(1.2, 1.05, 0.8))
    shapes.append(build_box((width - 0.1, 0.01, 0.02), lit, at=(0, -d / 2 - 0.005, 0.08)))
    bar = Support(-width / 2 + 0.15, width / 2 - 0.15, -d / 2 + 0.06, -d / 2 + 0.2, 1.125, 0.6)
    work = Support(-width / 2 + 0.2, width / 2 - 0.2, 0.05, 0.3, 0.74, 0.6)
    return Item("reception desk", tuple(shapes), (bar, work))


def build_coat_stand(rng: np.random.Generator, palette: Palette) -> Item:
    """A coat stand with a bare pole and hooks."""
    metal = palette.metal()
    shapes: list[Shape] = [
        build_cylinder(0.19, 0.02, metal, bevel=0.006, segments=20),
        build_rod((0, 0, 0.02), (0, 0, 1.72), 0.017, metal),
    ]
    for k in range(6):
        a = k * math.pi / 3
        c, s = math.cos(a), math.sin(a)
        path = [(0, 0, 1.55), (0.1 * c, 0.1 * s, 1.6), (0.15 * c, 0.15 * s, 1.72)]
        shapes.append(build_tube(path, 0.009, metal, sides=5))
    return Item("coat stand", tuple(shapes))
