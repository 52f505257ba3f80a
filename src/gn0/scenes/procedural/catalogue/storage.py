"""Storage and beds: bookshelves with their books, wardrobes, dressers, racks, shelves, beds."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.seats import build_folded, build_legs, leaning
from gn0.scenes.procedural.catalogue.tables import build_carcass, build_fronts
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import (
    BLACK,
    LINEN,
    MIRROR,
    PAPER,
    WICKER,
    Palette,
    linear_colour,
    plain,
    shade,
)
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_moulding,
    build_panel,
    build_rod,
    build_tube,
)
from gn0.scenes.procedural.shapes_soft import build_cushion, build_drape

SPINES = (
    "#7a2f2a",
    "#2c4a63",
    "#3f5c43",
    "#b9893c",
    "#d9cdb2",
    "#5b3f52",
    "#26282c",
    "#8c4a2f",
    "#a9b3b0",
    "#c9c2b3",
    "#47626b",
    "#8a7a52",
    "#b8432f",
    "#e6e1d6",
)


def spine_material(rng: np.random.Generator) -> Material:
    """The cloth and title of one of a few dozen book covers."""
    colour = linear_colour(SPINES[int(rng.integers(len(SPINES)))])
    return Material(
        name="book",
        pattern="book_spine",
        colour=colour,
        colour2=shade(colour, 0.5) if sum(colour) > 1 else (0.7, 0.62, 0.4),
        scale=0.2,
        contrast=0.5,
        seed=int(rng.integers(3)),
        detail=0.7,
    )


def build_books(rng: np.random.Generator, length: float, height: float, depth: float = 0.2) -> Item:
    """A row of standing books along x, spines towards −y, the last ones leaning."""
    shapes: list[Shape] = []
    x = -length / 2
    while True:
        thick = float(rng.uniform(0.014, 0.045))
        tall = float(np.clip(rng.normal(0.75, 0.12), 0.5, 0.97)) * height
        deep = float(rng.uniform(0.62, 0.95)) * depth
        if x + thick > length / 2:
            break
        cover = spine_material(rng)
        book = build_box((thick - 0.001, deep, tall), cover, at=(0, 0, 0))
        pages = build_box((thick - 0.007, deep - 0.008, 0.002), PAPER, at=(0, 0.003, tall - 0.001))
        lean = 0.0
        if rng.random() < 0.05 and x + thick + tall * 0.2 < length / 2:
            lean = float(rng.uniform(0.1, 0.18))
        y = -depth / 2 + deep / 2 + float(rng.uniform(0, 0.015))
        for s in (book, pages):
            shapes.append(s.tilted("y", lean).moved(x + thick / 2, y, math.sin(lean) * thick / 2))
        x += thick + (math.sin(lean) * tall + 0.004 if lean else 0.0)
        if rng.random() < 0.03:
            x += float(rng.uniform(0.02, 0.08))
    return Item("books", tuple(shapes))


def build_book_stack(rng: np.random.Generator, count: int | None = None) -> Item:
    """Two to five books lying on one another."""
    shapes, z = [], 0.0
    count = int(rng.integers(2, 6)) if count is None else count
    size = float(rng.uniform(0.2, 0.27))
    for _ in range(count):
        t = float(rng.uniform(0.014, 0.034))
        size *= float(rng.uniform(0.9, 1.0))
        turn = float(rng.uniform(-0.25, 0.25))
        cover = spine_material(rng)
        shapes.append(build_box((size, size * 0.7, t), cover, bevel=0.002).moved(z=z, yaw=turn))
        pages = build_box(
            (size - 0.006, size * 0.7 - 0.004, t - 0.006), PAPER, at=(0.004, 0, 0.003)
        )
        shapes.append(pages.moved(z=z, yaw=turn))
        z += t + 0.0005
    return Item("books", tuple(shapes), (Support(-0.06, 0.06, -0.05, 0.05, z),))


def build_bookshelf(rng: np.random.Generator, palette: Palette, width: float | None = None) -> Item:
    """A bookshelf filled with books; the free compartments are supports."""
    w = float(rng.uniform(0.75, 1.2)) if width is None else width
    d, rows = float(rng.uniform(0.26, 0.32)), int(rng.integers(4, 7))
    gap = float(rng.uniform(0.32, 0.37))
    body = palette.wood(rng) if rng.random() < 0.7 else palette.painted(rng)
    h = rows * gap + 0.06
    t = 0.02
    shapes = build_carcass(w, d, h - 0.04, body, z=0.04)
    shapes.append(build_box((w - 0.02, d - 0.03, 0.04), body, at=(0, 0.01, 0)))
    columns = 2 if w > 0.95 and rng.random() < 0.5 else 1
    if columns == 2:
        shapes.append(build_box((t, d - 0.012, h - 0.08), body, at=(0, 0, 0.06)))
    inner = (w - 2 * t - (columns - 1) * t) / columns
    parts: list[Placed] = []
    free: list[Support] = []
    for j in range(rows):
        z = 0.06 + j * gap
        if j:
            shapes.append(build_box((w - 2 * t, d - 0.012, t), body, bevel=0.002, at=(0, 0, z - t)))
        for i in range(columns):
            x = (i - (columns - 1) / 2) * (inner + t)
            clear = gap - t - 0.02
            kind = rng.random()
            if (kind < 0.55 and j < rows - 1) or kind < 0.45:
                share = float(rng.uniform(0.7, 0.97))
                row = build_books(rng, inner * share, clear, d - 0.08)
                side = float(rng.choice([-1, 1])) * inner * (1 - share) / 2
                parts.append(Placed(row, x + side, -0.01, z))
                if share < 0.8:
                    edge = -math.copysign(inner / 2 - 0.09, side) + x
                    free.append(
                        Support(edge - 0.06, edge + 0.06, -d / 2 + 0.06, d / 2 - 0.06, z, clear)
                    )
            elif kind < 0.8:
                half = build_books(rng, inner * 0.45, clear, d - 0.08)
                side = float(rng.choice([-1, 1]))
                parts.append(Placed(half, x + side * inner * 0.26, -0.01, z))
                free.append(
                    Support(
                        x - side * inner * 0.25 - 0.1,
                        x - side * inner * 0.25 + 0.1,
                        -d / 2 + 0.06,
                        d / 2 - 0.08,
                        z,
                        clear,
                    )
                )
            else:
                free.append(
                    Support(
                        x - inner / 2 + 0.06,
                        x + inner / 2 - 0.06,
                        -d / 2 + 0.06,
                        d / 2 - 0.08,
                        z,
                        clear,
                    )
                )
    free.append(Support(-w / 2 + 0.1, w / 2 - 0.1, -d / 2 + 0.06, d / 2 - 0.06, h, 0.35))
    return Item("bookshelf", tuple(shapes), tuple(free), tuple(parts))


def build_wardrobe(rng: np.random.Generator, palette: Palette) -> Item:
    """A wardrobe with two to four doors, one of them sometimes a mirror."""
    doors = int(rng.choice([2, 3, 4], p=[0.35, 0.4, 0.25]))
    w, d, h = doors * float(rng.uniform(0.46, 0.54)), 0.6, float(rng.uniform(2.0, 2.25))
    body = palette.wood(rng, 0) if rng.random() < 0.5 else palette.painted(rng)
    shapes = [build_box((w, d - 0.02, h), body, bevel=0.004, at=(0, 0.01, 0))]
    shapes += build_fronts(
        w - 0.02,
        h - 0.09,
        1,
        doors,
        -d / 2 + 0.02,
        0.07,
        body,
        palette.metal(),
        vertical=True,
        thick=0.02,
    )
    if doors == 3 and rng.random() < 0.6:
        shapes.append(
            build_panel(
                (-w / 6 + 0.05, -d / 2 - 0.001, 0.2), (w / 3 - 0.1, 0, 0), (0, 0, h - 0.4), MIRROR
            )
        )
    elif palette.style.name in ("classic", "warm wood"):
        for k in range(doors):
            x = -w / 2 + (k + 0.5) * w / doors
            for z, tall in ((0.16, h * 0.32), (h * 0.32 + 0.28, h * 0.5)):
                frame = build_moulding(w / doors - 0.16, tall, body)
                shapes += [m.moved(x, -d / 2, z) for m in frame]
    return Item(
        "wardrobe", tuple(shapes), (Support(-w / 2 + 0.15, w / 2 - 0.15, -0.15, 0.15, h, 0.3),)
    )


def build_dresser(rng: np.random.Generator, palette: Palette) -> Item:
    """A chest of drawers."""
    w, d, h = (
        float(rng.uniform(0.85, 1.25)),
        float(rng.uniform(0.42, 0.48)),
        float(rng.uniform(0.78, 0.95)),
    )
    body = palette.wood(rng, 0)
    front = palette.painted(rng) if rng.random() < 0.35 else body
    leg = float(rng.choice([0.06, 0.14]))
    shapes = build_carcass(w, d, h - leg, body, z=leg)
    shapes.append(build_box((w + 0.02, d + 0.01, 0.02), body, bevel=0.005, at=(0, 0, h - 0.019)))
    shapes += build_fronts(
        w - 0.04,
        h - leg - 0.05,
        int(rng.integers(3, 5)),
        2 if w > 1.0 else 1,
        -d / 2 + 0.018,
        leg + 0.02,
        front,
        palette.metal(),
        knob=rng.random() < 0.5,
    )
    shapes += build_legs(w - 0.1, d - 0.08, leg + 0.004, body, radius=0.022, splay=0.01)
    return Item(
        "dresser",
        tuple(shapes),
        (Support(-w / 2 + 0.08, w / 2 - 0.08, -d / 2 + 0.08, d / 2 - 0.06, h),),
    )


def build_sideboard(rng: np.random.Generator, palette: Palette) -> Item:
    """A long cabinet with doors."""
    w, d, h = (
        float(rng.uniform(1.3, 1.75)),
        float(rng.uniform(0.4, 0.46)),
        float(rng.uniform(0.72, 0.86)),
    )
    body = palette.wood(rng, 0)
    leg = 0.16
    shapes = build_carcass(w, d, h - leg, body, z=leg)
    front = palette.painted(rng) if rng.random() < 0.4 else body
    shapes += build_fronts(
        w - 0.04,
        h - leg - 0.04,
        1,
        int(rng.integers(3, 5)),
        -d / 2 + 0.018,
        leg + 0.02,
        front,
        palette.metal(),
        vertical=True,
    )
    shapes += build_legs(
        w - 0.24,
        d - 0.12,
        leg + 0.005,
        palette.metal() if rng.random() < 0.4 else body,
        radius=0.02,
        splay=0.03,
    )
    return Item(
        "cabinet",
        tuple(shapes),
        (Support(-w / 2 + 0.08, w / 2 - 0.08, -d / 2 + 0.08, d / 2 - 0.06, h),),
    )


def build_shoe(rng: np.random.Generator, material: Material) -> list[Shape]:
    """One shoe, toe towards −y."""
    sole = build_box((0.09, 0.26, 0.02), BLACK if rng.random() < 0.5 else PAPER, bevel=0.009)
    toe = build_ball(0.046, material, at=(0, -0.075, 0.03), squash=0.75, segments=10).stretched(
        y=1.15
    )
    heel = build_box((0.075, 0.13, 0.07), material, bevel=0.025, at=(0, 0.055, 0.018))
    return [sole, toe, heel]


def build_shoes(rng: np.random.Generator) -> Item:
    """A pair of shoes standing side by side."""
    material = plain(
        "shoe",
        str(rng.choice(["leather", "fabric"])),
        str(rng.choice(["#2a2624", "#7a4a2c", "#d9d6d0", "#3f4f66", "#9a3b33"])),
        contrast=0.2,
    )
    shapes = []
    for sx in (-1, 1):
        turn = float(rng.uniform(-0.12, 0.12))
        shapes += [
            s.moved(sx * 0.06, float(rng.uniform(-0.015, 0.015)), 0, turn)
            for s in build_shoe(rng, material)
        ]
    return Item("shoes", tuple(shapes))


def build_shoe_rack(rng: np.random.Generator, palette: Palette) -> Item:
    """Two or three slatted shelves with shoes."""
    w, d, rows = float(rng.uniform(0.7, 0.95)), 0.3, int(rng.integers(2, 4))
    wood = palette.wood(rng, 0)
    h = 0.12 + rows * 0.2
    shapes = [
        build_box(
            (0.024, 0.024, h), wood, bevel=0.003, at=(sx * (w / 2 - 0.012), sy * (d / 2 - 0.012), 0)
        )
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    parts = []
    for j in range(rows):
        z = 0.1 + j * 0.2
        for k in range(5):
            shapes.append(
                build_box(
                    (w - 0.03, 0.03, 0.012), wood, bevel=0.002, at=(0, -d / 2 + 0.03 + k * 0.06, z)
                )
            )
        for k in range(int(w / 0.27)):
            if rng.random() < 0.8:
                parts.append(Placed(build_shoes(rng), -w / 2 + 0.15 + k * 0.27, 0.0, z + 0.013))
    shapes.append(build_box((w, d, 0.018), wood, bevel=0.003, at=(0, 0, h)))
    return Item(
        "shoe rack",
        tuple(shapes),
        (Support(-w / 2 + 0.08, w / 2 - 0.08, -0.09, 0.09, h + 0.018),),
        tuple(parts),
    )


def build_coat_rack(rng: np.random.Generator, palette: Palette) -> Item:
    """A wall board with hooks, coats and a bag; its base is the coats' hem."""
    w = float(rng.uniform(0.7, 1.1))
    z = 1.65
    wood, metal = palette.wood(rng, 0), palette.metal()
    shapes = [build_box((w, 0.02, 0.12), wood, bevel=0.004, at=(0, 0.0, z))]
    parts = []
    hooks = int(w / 0.18)
    for k in range(hooks):
        x = -w / 2 + (k + 0.5) * w / hooks
        shapes.append(
            build_tube(
                [(x, -0.01, z + 0.06), (x, -0.06, z + 0.05), (x, -0.07, z + 0.09)],
                0.006,
                metal,
                sides=6,
            )
        )
        if rng.random() < 0.6:
            parts.append(Placed(build_coat(rng, palette), x, -0.085, z + 0.045))
    return Item("coat rack", tuple(shapes), (), tuple(parts))


def build_coat(rng: np.random.Generator, palette: Palette) -> Item:
    """A coat hanging from z = 0 downwards, category "coat"."""
    length, w = float(rng.uniform(0.7, 1.0)), float(rng.uniform(0.13, 0.17))
    colour = plain(
        "coat",
        "fabric",
        str(rng.choice([*palette.style.bright, "#2d3138", "#5c5248"])),
        scale=0.012,
        contrast=0.3,
    )
    body = build_box((w * 2, 0.11, length), colour, bevel=0.05, round_steps=2, inner=4, puff=0.012)
    v = body.vertices.copy()
    t = np.clip(v[:, 2] / length, 0, 1)
    v[:, 0] *= 0.62 + 0.5 * (1 - t) ** 0.8
    v[:, 1] += 0.012 * np.sin(v[:, 0] * 45 + 3 * (1 - t)) * (1 - t)
    shape = Shape(v, body.faces, body.uv, colour).moved(z=-length)
    collar = build_box(
        (w * 0.9, 0.09, 0.07), colour, bevel=0.03, round_steps=2, at=(0, -0.01, -0.05)
    )
    sleeves = [
        build_rod(
            (sx * w * 0.62, -0.02, -0.12),
            (sx * w * 1.0, -0.03, -0.62),
            0.05,
            colour,
            end_radius=0.042,
            sides=10,
        )
        for sx in (-1, 1)
    ]
    return Item("coat", (shape, collar, *sleeves))


def build_wall_shelf(rng: np.random.Generator, palette: Palette, width: float = 0.8) -> Item:
    """A board on brackets for the wall; its top is a support."""
    wood, metal = palette.wood(rng, 0), palette.metal()
    shapes = [build_box((width, 0.2, 0.024), wood, bevel=0.004)]
    for sx in (-1, 1):
        x = sx * width * 0.36
        shapes.append(
            build_tube(
                [(x, -0.07, -0.005), (x, 0.085, -0.005), (x, 0.085, -0.12)], 0.008, metal, sides=6
            )
        )
    return Item(
        "shelf",
        tuple(shapes),
        (Support(-width / 2 + 0.06, width / 2 - 0.06, -0.07, 0.06, 0.024, 0.32),),
    )


def build_basket(rng: np.random.Generator, palette: Palette, *, filled: bool = True) -> Item:
    """A wicker basket, sometimes with a blanket in it."""
    r, h = float(rng.uniform(0.15, 0.22)), float(rng.uniform(0.24, 0.36))
    rz = [
        (0, 0),
        (r * 0.82, 0),
        (r * 0.9, 0.02),
        (r, h * 0.7),
        (r * 0.96, h),
        (r * 0.92, h + 0.008),
        (r * 0.9, h),
        (r * 0.93, h * 0.7),
        (r * 0.78, 0.03),
        (0, 0.03),
    ]
    body = build_lathe(rz, WICKER, segments=24)
    parts = []
    if filled and rng.random() < 0.7:
        puff = build_cushion(
            r * 1.7, r * 1.5, 0.2, palette.bright(rng, "knit"), pinch=0.02, steps=9
        )
        parts.append(Placed(Item("blanket", (puff,)), 0, 0, h - 0.14))
    return Item("basket", (body,), (), tuple(parts))


def build_bed(rng: np.random.Generator, palette: Palette, double: bool = True) -> Item:
    """A bed with headboard, mattress, duvet, pillows and often a throw; head towards +y."""
    w = float(rng.choice([1.4, 1.6, 1.8])) if double else float(rng.choice([0.9, 1.0]))
    long = 2.0
    frame_w, frame_l = w + 0.08, long + 0.1
    wood = palette.wood(rng, 0)
    upholstered = rng.random() < 0.45
    cloth = palette.cloth(rng)
    frame = cloth if upholstered else wood
    shapes: list[Shape] = []
    z0 = 0.2
    bevel = 0.02 if upholstered else 0.006
    for sx in (-1, 1):
        shapes.append(
            build_box(
                (0.04, frame_l - 0.02, 0.16),
                frame,
                at=(sx * (frame_w / 2 - 0.02), 0, z0 - 0.04),
                bevel=bevel,
                round_steps=2,
            )
        )
    shapes.append(
        build_box(
            (frame_w, 0.04, 0.16),
            frame,
            at=(0, -frame_l / 2 + 0.02, z0 - 0.04),
            bevel=bevel,
            round_steps=2,
        )
    )
    head = float(rng.uniform(0.92, 1.15))
    back = frame_l / 2
    if upholstered:
        shapes.append(
            build_box(
                (frame_w + 0.06, 0.1, head),
                frame,
                bevel=0.04,
                round_steps=2,
                inner=2,
                puff=0.01,
                at=(0, back, 0),
            )
        )
        if rng.random() < 0.5:
            n = max(2, int(frame_w / 0.28))
            for k in range(n):
                x = -frame_w / 2 + (k + 0.5) * frame_w / n
                shapes.append(
                    build_box(
                        (frame_w / n - 0.012, 0.06, head - 0.5),
                        frame,
                        bevel=0.028,
                        round_steps=2,
                        inner=1,
                        puff=0.012,
                        at=(x, back - 0.05, 0.45),
                    )
                )
    elif rng.random() < 0.5:
        shapes.append(
            build_box(
                (frame_w, 0.04, head - 0.24), wood, bevel=0.012, round_steps=2, at=(0, back, 0.2)
            )
        )
        shapes += [
            build_box((0.06, 0.06, head), wood, bevel=0.01, at=(sx * (frame_w / 2 - 0.03), back, 0))
            for sx in (-1, 1)
        ]
    else:
        shapes += [
            build_rod(
                (sx * (frame_w / 2 - 0.03), back, 0),
                (sx * (frame_w / 2 - 0.03), back, head),
                0.026,
                wood,
                sides=10,
            )
            for sx in (-1, 1)
        ]
        shapes += [
            build_box((frame_w - 0.06, 0.026, 0.09), wood, bevel=0.008, at=(0, back, z))
            for z in (head - 0.12, head - 0.32, head - 0.52)
        ]
    shapes += build_legs(frame_w - 0.16, frame_l - 0.16, z0, wood, radius=0.03)
    sheet = LINEN
    shapes.append(
        build_box(
            (w, long, 0.2),
            sheet,
            bevel=0.05,
            round_steps=2,
            inner=1,
            puff=0.006,
            at=(0, 0, z0 + 0.04),
        )
    )
    top = z0 + 0.24
    duvet_colour = (
        palette.bright(rng, "linen")
        if rng.random() < 0.65
        else plain(
            "duvet",
            "linen",
            str(rng.choice(["#eeeae2", "#dfe2e2", "#cdd3d6", "#e6dccb"])),
            contrast=0.2,
            scale=0.01,
        )
    )
    fold = long * 0.68
    duvet = build_drape(
        w + 0.02,
        fold,
        (0.24, 0.24, 0.06, 0.0),
        duvet_colour,
        rng,
        ripple=0.025,
        lift=0.035,
        step=0.06,
    )
    shapes.append(duvet.moved(0, -long / 2 + fold / 2 + 0.01, top + 0.05))
    lip = build_box((w + 0.1, 0.34, 0.06), sheet, bevel=0.028, round_steps=2, inner=2, puff=0.008)
    shapes.append(lip.moved(0, -long / 2 + fold - 0.1, top + 0.045))
    parts: list[Placed] = []
    count = 2 if double else 1
    for k in range(count):
        x = (k - (count - 1) / 2) * w * 0.48
        case = plain(
            "pillow case",
            "linen",
            str(rng.choice(["#f2efe8", "#e6e8e8", "#ece5d8"])),
            contrast=0.2,
            scale=0.01,
        )
        pillow = Item("pillow", (build_cushion(0.66, 0.44, 0.19, case, pinch=0.06),))
        parts.append(
            Placed(
                leaning(pillow, 0.28),
                x,
                long / 2 - 0.3,
                top - 0.01,
                float(rng.uniform(-0.05, 0.05)),
            )
        )
        if rng.random() < 0.6:
            extra = Item(
                "cushion",
                (
                    build_cushion(
                        0.44,
                        0.42,
                        0.15,
                        palette.bright(rng, str(rng.choice(["fabric", "knit"]))),
                        pinch=0.1,
                    ),
                ),
            )
            parts.append(
                Placed(
                    leaning(extra, 1.0),
                    x * 0.8,
                    long / 2 - 0.56,
                    top + 0.01,
                    float(rng.uniform(-0.2, 0.2)),
                )
            )
    if rng.random() < 0.65:
        throw = build_drape(
            w + 0.09,
            0.55,
            (0.3, 0.3, 0.0, 0.0),
            palette.bright(rng, "knit"),
            rng,
            ripple=0.03,
            lift=0.04,
        )
        parts.append(
            Placed(
                Item("blanket", (throw,)),
                0,
                -long / 2 + 0.42,
                top + 0.085,
                float(rng.uniform(-0.04, 0.04)),
            )
        )
    return Item("bed", tuple(shapes), (), tuple(parts))


def build_towel_stack(rng: np.random.Generator, palette: Palette) -> Item:
    """Folded towels."""
    colour = palette.bright(rng, "knit")
    return Item("towel", tuple(build_folded(0.3, 0.2, int(rng.integers(2, 5)), colour)))


def build_storage_box(rng: np.random.Generator, palette: Palette) -> Item:
    """A lidded cardboard or cloth box."""
    w, d, h = (
        float(rng.uniform(0.26, 0.38)),
        float(rng.uniform(0.2, 0.26)),
        float(rng.uniform(0.14, 0.22)),
    )
    body = plain(
        "box",
        str(rng.choice(["paper", "fabric", "wicker"])),
        str(rng.choice([*palette.style.bright, "#c9b08a"])),
        scale=0.02,
        contrast=0.3,
    )
    return Item(
        "storage box",
        (
            build_box((w, d, h), body, bevel=0.006),
            build_box((w + 0.01, d + 0.01, 0.04), body, bevel=0.005, at=(0, 0, h - 0.035)),
        ),
    )


def build_umbrella_stand(rng: np.random.Generator, palette: Palette) -> Item:
    """A cylinder with two umbrellas."""
    metal = palette.metal()
    shapes = [build_cylinder(0.11, 0.48, metal, bevel=0.01, segments=20)]
    for sx in (-1, 1):
        colour = palette.bright(rng)
        x = sx * 0.03
        shapes.append(
            build_rod((x, 0, 0.42), (x + sx * 0.03, 0, 0.78), 0.03, colour, end_radius=0.012)
        )
        hook = [
            (x + sx * 0.03, 0, 0.76),
            (x + sx * 0.035, 0, 0.88),
            (x + sx * 0.05, 0, 0.92),
            (x + sx * 0.08, 0, 0.91),
            (x + sx * 0.09, 0, 0.87),
        ]
        shapes.append(build_tube(hook, 0.009, palette.wood(rng, 0), sides=6))
    return Item("umbrella stand", tuple(shapes))
