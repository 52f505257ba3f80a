"""From a seed to a yard between houses: paths, lawns, trees, a fountain, and the open sky."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from gn0.scenes.procedural import facades, planting
from gn0.scenes.procedural.building import choose_palette
from gn0.scenes.procedural.catalogue.clutter.on_floor import build_ball_toy
from gn0.scenes.procedural.catalogue.depot.loading import build_wheelie_bin
from gn0.scenes.procedural.catalogue.garden import grounds, play, seating, street
from gn0.scenes.procedural.draft import Material, SceneDraft, Sky, Sun
from gn0.scenes.procedural.layout import Rect
from gn0.scenes.procedural.palette import Palette, linear_colour, plain
from gn0.scenes.procedural.plan import FloorPlan, Room, Wall
from gn0.scenes.procedural.plots import Plot, draw_walkable
from gn0.scenes.procedural.shapes import Shape, build_box, build_panel, make_shape
from gn0.scenes.sky import VAULT
from gn0.seeds import random_stream

SIZES = {"small": (300.0, 390.0), "medium": (430.0, 580.0), "large": (650.0, 850.0)}  # m² of yard
RING = 2.7  # width of the walk along the houses [m]
ARM = 2.0  # width of the paths between the lawns [m]
KERB = (0.1, 0.045)  # width and height of edgings, low enough to roll over [m]
BEYOND = 7.0  # from the fronts to the foot of the vault [m]
TOP = 23.0  # height of the vault [m]
OUTSIDE = -0.3  # height of the ground behind the houses: nobody can stand there [m]
QUARTERS = ("lawn", "flower garden", "terrace", "playground", "orchard")


@dataclass(frozen=True)
class Yard:
    """Measures of a yard.

    Attributes:
        plan: the outline; its walls are the fronts.
        zones: walks, square and quarters.
        quarters: zone ids of the four quarters and what each of them is.
        width, depth: of the yard [m].
        square: side of the middle square [m].
        open_side: "north", "south", "east", "west" where a garden wall stands, or "".
    """

    plan: FloorPlan
    zones: tuple[Room, ...]
    quarters: tuple[tuple[Room, str], ...]
    width: float
    depth: float
    square: float
    open_side: str


def plan_yard(seed: int, size: str) -> Yard:
    """Outline and zones of a yard.

    Raises:
        KeyError: no such size.
    """
    rng = random_stream(seed, "courtyard", "plan")
    area = float(rng.uniform(*SIZES[size]))
    ratio = float(rng.uniform(1.0, 1.4))
    w, d = round(math.sqrt(area * ratio), 2), round(math.sqrt(area / ratio), 2)
    square = round(float(rng.uniform(6.2, 7.4)), 2)
    x = (RING, round(w / 2 - square / 2, 3), round(w / 2 + square / 2, 3), round(w - RING, 3))
    y = (RING, round(d / 2 - square / 2, 3), round(d / 2 + square / 2, 3), round(d - RING, 3))
    a0, a1 = round(w / 2 - ARM / 2, 3), round(w / 2 + ARM / 2, 3)
    b0, b1 = round(d / 2 - ARM / 2, 3), round(d / 2 + ARM / 2, 3)
    kinds = [str(k) for k in rng.permutation(np.array(QUARTERS))[:4]]
    if "lawn" not in kinds:
        kinds[0] = "lawn"
    counts: dict[str, int] = {}
    quarters = []
    for kind, (x0, y0, x1, y1) in zip(
        kinds,
        ((x[0], y[0], a0, b0), (a1, y[0], x[3], b0), (x[0], b1, a0, y[3]), (a1, b1, x[3], y[3])),
        strict=True,
    ):
        counts[kind] = counts.get(kind, 0) + 1
        quarters.append(
            (Room(f"{kind.replace(' ', '_')}_{counts[kind]}", kind, x0, y0, x1, y1), kind)
        )
    zones = [
        Room("south_walk", "walkway", 0, 0, w, RING),
        Room("north_walk", "walkway", 0, y[3], w, d),
        Room("west_walk", "walkway", 0, RING, RING, y[3]),
        Room("east_walk", "walkway", x[3], RING, w, y[3]),
        Room("south_path", "garden path", a0, RING, a1, b0),
        Room("north_path", "garden path", a0, b1, a1, y[3]),
        Room("cross_path", "fountain square", RING, b0, x[3], b1),
        *(room for room, _ in quarters),
    ]
    side = str(rng.choice(["north", "south", "east", "west", ""], p=[0.2, 0.2, 0.15, 0.15, 0.3]))
    walls = (
        Wall("x", 0.0, 0.0, w, 0.3, (None, None)),
        Wall("x", d, 0.0, w, 0.3, (None, None)),
        Wall("y", 0.0, 0.0, d, 0.3, (None, None)),
        Wall("y", w, 0.0, d, 0.3, (None, None)),
    )
    plan = FloorPlan((), walls, (), 3.0)
    return Yard(plan, tuple(zones), tuple(quarters), w, d, square, side)


def draft_courtyard(
    seed: int, *, size: str = "medium", style: str | Palette | None = None
) -> SceneDraft:
    """A planted yard under the open sky, before light.

    Args:
        seed: of everything.
        size: "small", "medium" or "large" (see `SIZES`).
        style: taste of small things; drawn when None.

    Raises:
        SceneError: an unknown style, or no walkable layout was found (not known to happen).
    """
    palette = choose_palette("courtyard", seed, style)
    yard = plan_yard(seed, size)
    return draw_walkable(
        f"courtyard {seed}", yard.zones, yard.plan, partial(_draw, seed, yard, palette)
    )


def _draw(seed: int, yard: Yard, palette: Palette, attempt: int, effort: float) -> SceneDraft:
    rng = random_stream(seed, "courtyard", "things", attempt)
    plot = Plot(rng, list(yard.zones), effort)
    fixed = random_stream(seed, "courtyard", "ground")
    _lay_ground(plot, yard, fixed)
    _build_fronts(plot, yard, random_stream(seed, "courtyard", "fronts"))
    _raise_vault(plot, yard, fixed)
    _fill_square(plot, yard)
    for room, kind in yard.quarters:
        _fill_quarter(plot, room, kind, palette)
    _fill_walks(plot, yard, palette)
    sky, sun = _draw_light(random_stream(seed, "courtyard", "sun"))
    return plot.finish(yard.plan, sun=sun, sky=sky)


def _draw_light(rng: np.random.Generator) -> tuple[Sky, Sun]:
    """A clear or lightly clouded day; the sun 32 to 58 degrees high."""
    heading = float(rng.uniform(-math.pi, math.pi))
    height = math.radians(float(rng.uniform(32, 58)))
    c = math.cos(height)
    way = (c * math.cos(heading), c * math.sin(heading), -math.sin(height))
    x, y, z = (round(v, 6) for v in way)
    warm = float(rng.uniform(0.0, 1.0))
    sun = Sun(
        direction=(x, y, z), colour=(5.2, round(4.9 - 0.35 * warm, 3), round(4.3 - 0.6 * warm, 3))
    )
    return Sky(zenith=(0.36, 0.47, 0.72), horizon=(0.62, 0.68, 0.78), shown=1.7), sun


def _floor(room: Room, material: Material, z: float = 0.0) -> Shape:
    """The ground of a zone; its pattern runs on from zone to zone."""
    panel = build_panel((room.x0, room.y0, z), (room.width, 0, 0), (0, room.depth, 0), material)
    return Shape(
        panel.vertices, panel.faces, panel.uv + np.array([room.x0, room.y0], np.float32), material
    )


def _lay_ground(plot: Plot, yard: Yard, rng: np.random.Generator) -> None:
    """Paving, lawns, gravel; edgings between them; the ground outside."""
    k = int(rng.integers(3))
    main, second = (("#a39c8f", "#7f786c"), ("#98948e", "#74706a"), ("#a8937a", "#846f5a"))[k]
    walk = plain("paving", "paving", main, second=second, scale=float(rng.choice([0.6, 0.9])),
                 contrast=0.5, detail=0.8, seed=int(rng.integers(6)))  # fmt: skip
    setts = plain("setts", "cobbles", "#8f887e", second="#5f5a52", scale=0.13, contrast=0.6,
                  detail=1.0, seed=int(rng.integers(6)))  # fmt: skip
    gravel = plain("gravel", "gravel", "#b5a68c", second="#877a64", scale=0.03, contrast=0.5,
                   detail=0.8, seed=int(rng.integers(6)))  # fmt: skip
    grass = plain("grass", "grass", "#57752f", second="#33501f", contrast=0.65, detail=0.9,
                  seed=int(rng.integers(6)))  # fmt: skip
    chips = plain("wood chips", "gravel", "#8f6a44", second="#5f452c", scale=0.05, contrast=0.6,
                  detail=0.8, seed=int(rng.integers(6)))  # fmt: skip
    ground = {
        "walkway": walk, "garden path": walk if k else gravel, "fountain square": setts,
        "lawn": grass, "orchard": grass, "flower garden": gravel, "terrace": gravel,
        "playground": chips,
    }  # fmt: skip
    shell = [_floor(zone, ground[zone.type]) for zone in yard.zones]
    shell += _ground_beyond(yard, grass)
    edge, high = KERB
    stone = plain("kerb", "concrete", "#a8a296", second="#8a8478", contrast=0.4, detail=0.4)
    tufts = []
    for room, kind in yard.quarters:
        for x0, y0, x1, y1 in (
            (room.x0, room.y0, room.x1, room.y0 + edge),
            (room.x0, room.y1 - edge, room.x1, room.y1),
            (room.x0, room.y0 + edge, room.x0 + edge, room.y1 - edge),
            (room.x1 - edge, room.y0 + edge, room.x1, room.y1 - edge),
        ):  # fmt: skip
            kerb = build_box((x1 - x0, y1 - y0, high), stone, at=((x0 + x1) / 2, (y0 + y1) / 2, 0))
            shell.append(kerb)
        if kind in ("lawn", "orchard"):
            count = int(3.2 * room.area)
            spot = np.column_stack([
                rng.uniform(room.x0 + 0.15, room.x1 - 0.15, count),
                rng.uniform(room.y0 + 0.15, room.y1 - 0.15, count), np.zeros(count)])  # fmt: skip
            near = np.minimum(np.minimum(spot[:, 0] - room.x0, room.x1 - spot[:, 0]),
                              np.minimum(spot[:, 1] - room.y0, room.y1 - spot[:, 1]))  # fmt: skip
            spot = spot[(near < 0.5) | (rng.random(count) < 0.5)]
            tufts.append(spot)
    if tufts:
        blade = plain("blades", "leaf", "#6a8a38", second="#3f5f22", contrast=0.4, detail=0.6)
        shell.append(planting.build_grass_tufts(rng, np.concatenate(tufts), blade))
    plot.assembly.add_shell(*shell)


def _ground_beyond(yard: Yard, grass: Material) -> list[Shape]:
    """Grass behind the garden wall, below the yard: one sees it but cannot stand there."""
    w, d, b = yard.width, yard.depth, BEYOND + 3.0
    strip = {
        "south": (-b, -b, w + b, 0.05), "north": (-b, d - 0.05, w + b, d + b),
        "west": (-b, -b, 0.05, d + b), "east": (w - 0.05, -b, w + b, d + b),
    }.get(yard.open_side)  # fmt: skip
    if strip is None:
        return []
    return [_floor(Room("field", "field", *strip), grass, OUTSIDE)]


def _build_fronts(plot: Plot, yard: Yard, rng: np.random.Generator) -> None:
    """A house front on every side, or a garden wall on the open one."""
    w, d = yard.width, yard.depth
    sides = {
        "south": (w / 2, 0.0, math.pi, w), "north": (w / 2, d, 0.0, w),
        "west": (0.0, d / 2, math.pi / 2, d), "east": (w, d / 2, -math.pi / 2, d),
    }  # fmt: skip
    gate = str(rng.choice([s for s in sides if s != yard.open_side]))
    number = int(rng.integers(1, 30))
    for name, (x, y, yaw, length) in sides.items():
        walk = f"{name}_walk"
        if name == yard.open_side:
            wall = facades.build_garden_wall(rng, length + 0.6, float(rng.uniform(1.9, 2.3)))
            plot.put(wall, x, y, yaw, zone=walk)
            _plant_beyond(plot, yard, name, rng)
            continue
        taste = facades.draw_taste(rng)
        front = facades.build_facade_wall(taste, length + 0.7, rng)
        plot.put(front, x, y, yaw, solid=False, zone=walk)

        def hang(item: facades.Item, t: float, z: float, off: float = 0.0) -> None:
            c, s = math.cos(yaw), math.sin(yaw)  # noqa: B023
            plot.put(item, x + c * t + s * off, y + s * t - c * off, yaw, z=z, solid=False,  # noqa: B023
                     zone=walk)  # fmt: skip  # noqa: B023

        count = max(2, int((length - 1.2) / taste.pitch))
        pitch = (length - 1.2) / count
        doors = {1, count - 2} if count > 5 else {0}
        arch = count // 2 if name == gate else -9
        for k in range(count):
            t = -length / 2 + 0.6 + (k + 0.5) * pitch
            for storey in range(taste.storeys):
                z = storey * taste.storey + 0.9
                if storey == 0:
                    if k == arch:
                        hang(facades.build_archway(taste, rng), t, 0.0)
                        continue
                    if abs(k - arch) == 1 and pitch < 2.6:
                        continue
                    if k in doors and abs(k - arch) > 1:
                        number += 2
                        hang(facades.build_front_door(taste, rng, number), t, 0.0)
                        hang(street.build_doormat(rng), t, 0.002, 0.36)
                        hang(facades.build_wall_lantern(), t - 1.05, 1.9)
                        hang(street.build_mailboxes(rng, 6), t + 1.45, 1.0, 0.005)
                        c, s = math.cos(yaw), math.sin(yaw)
                        dx, dy = x + c * t, y + s * t
                        plot.taken.append((dx - 0.9, dy - 0.9, dx + 0.9, dy + 0.9))
                        continue
                balcony = storey > 0 and bool(rng.random() < taste.balconies)
                box = bool(rng.random() < 0.12)
                item = facades.build_facade_window(taste, rng, balcony=balcony, box=box)
                hang(item, t, z - 0.55 if balcony else z)


def _plant_beyond(plot: Plot, yard: Yard, name: str, rng: np.random.Generator) -> None:
    """Trees behind a garden wall: part of the view, not of the scene's objects."""
    w, d = yard.width, yard.depth
    span = w if name in ("north", "south") else d
    count = max(3, int(span / 4.5))
    for k in range(count):
        t = (k + 0.5) * span / count + float(rng.uniform(-0.8, 0.8))
        off = float(rng.uniform(2.2, 4.2))
        x, y = {
            "north": (t, d + off), "south": (t, -off), "west": (-off, t), "east": (w + off, t),
        }[name]  # fmt: skip
        tree = planting.build_tree(rng, int(rng.integers(3)))
        turn = float(rng.uniform(0, 6.28))
        plot.assembly.add_shell(*(s.moved(x, y, OUTSIDE, turn) for s in tree.shapes))


def _raise_vault(plot: Plot, yard: Yard, rng: np.random.Generator) -> None:
    """The sky over the yard and the ground behind the houses."""
    heaven = Material(
        name="sky",
        pattern=VAULT,
        colour=linear_colour("#3f78bf"),
        colour2=linear_colour("#c9dcea"),
        contrast=round(float(rng.uniform(0.1, 0.5)), 2),
        seed=int(rng.integers(1000)),
        detail=0.3,
    )
    plot.assembly.add_shell(build_vault(yard.width, yard.depth, heaven))


def build_vault(width: float, depth: float, material: Material) -> Shape:
    """The vault of heaven over a yard from (0, 0) to (width, depth) [m], seen from inside.

    Half an ellipsoid on the ground `BEYOND` the houses, `TOP` high; its uv are directions as the
    pattern "open_sky" wants them.
    """
    a, b = (width / 2 + BEYOND) * 1.12, (depth / 2 + BEYOND) * 1.12
    rows, columns = 22, 72
    lift = np.concatenate([[-0.03], np.linspace(0, math.pi / 2, rows - 1)])
    turn = np.linspace(0, 2 * math.pi, columns + 1)
    turn[-1] = 0.0
    e, t = np.meshgrid(lift, turn, indexing="ij")
    p = np.stack([a * np.cos(e) * np.cos(t), b * np.cos(e) * np.sin(t), TOP * np.sin(e)], -1)
    p[..., :2] += (width / 2, depth / 2)
    flat = p.reshape(-1, 3)
    n = columns + 1
    i, j = (g.ravel() for g in np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij"))
    quad = np.stack([i * n + j, i * n + j + 1, (i + 1) * n + j + 1, (i + 1) * n + j], 1)
    f = np.concatenate([quad[:, [0, 2, 1]], quad[:, [0, 3, 2]]])
    way = flat - (width / 2, depth / 2, 1.3)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    uv = way[:, :2] / (np.maximum(way[:, 2:], 0.0) + 0.25)
    return make_shape(flat, f, uv[f], material)


def _fill_square(plot: Plot, yard: Yard) -> None:
    """The fountain or another middle, with benches and planters round it."""
    rng = plot.rng
    x, y, half = yard.width / 2, yard.depth / 2, yard.square / 2
    if rng.random() < 0.75:
        plot.put(grounds.build_fountain(rng, float(rng.uniform(1.25, 1.55))), x, y)
    else:
        plot.put(planting.build_tree(rng, 0), x, y)
        plot.taken[-1] = (x - 1.0, y - 1.0, x + 1.0, y + 1.0)
    plot.keep.append((0, y - ARM / 2 + 0.2, yard.width, y + ARM / 2 - 0.2))
    plot.keep.append((x - ARM / 2 + 0.2, 0, x + ARM / 2 - 0.2, yard.depth))
    for k in range(4):
        a = math.pi / 4 + k * math.pi / 2
        r = half - 0.35
        if rng.random() < 0.8:
            bench = seating.build_garden_bench(rng)
            plot.put(bench, x + r * math.cos(a), y + r * math.sin(a), a - math.pi / 2)
        else:
            plot.put(planting.build_planter(rng), x + r * math.cos(a), y + r * math.sin(a))


def _inner(room: Room, margin: float) -> Rect:
    return (room.x0 + margin, room.y0 + margin, room.x1 - margin, room.y1 - margin)


def _fill_quarter(plot: Plot, room: Room, kind: str, palette: Palette) -> None:
    """What belongs in a quarter."""
    rng = plot.rng
    quarter = (0.0, math.pi / 2, math.pi, -math.pi / 2)
    inner = _inner(room, 0.3)
    trees = {"lawn": 2, "orchard": 5, "flower garden": 1, "terrace": 1, "playground": 1}[kind]
    if kind in ("lawn", "playground", "flower garden") and rng.random() < 0.75:
        _hedge_in(plot, room)
    if kind == "flower garden":
        columns = max(1, int((room.width - 1.0) / 2.9))
        rows = max(1, int((room.depth - 1.0) / 2.3))
        for i in range(columns):
            for j in range(rows):
                x = room.x0 + room.width * (i + 0.5) / columns
                y = room.y0 + room.depth * (j + 0.5) / rows
                bed = planting.build_flower_bed(rng, float(rng.uniform(1.5, 1.8)), 1.0)
                plot.try_put(bed, x, y, 0.0, margin=0.3)
        plot.scatter(grounds.build_sundial, 1, inner, margin=0.5)
        plot.scatter(grounds.build_wheelbarrow, 1, inner, margin=0.5, turn=quarter, jitter=0.3)
        plot.scatter(grounds.build_watering_can, 2, inner, margin=0.4, turn=quarter, jitter=0.5)
    if kind == "terrace":
        _set_tables(plot, room)
    if kind == "playground":
        plot.scatter(
            lambda: play.build_swing(rng), 1, inner, margin=0.7, turn=quarter[:2], tries=60
        )
        plot.scatter(lambda: play.build_slide(rng), 1, inner, margin=0.6, turn=quarter, tries=60)
        plot.scatter(lambda: play.build_sandbox(rng), 1, inner, margin=0.6, tries=60)
        plot.scatter(lambda: build_ball_toy(rng, palette), 2, inner, margin=0.4)
    plot.scatter(
        lambda: planting.build_tree(rng), trees, _inner(room, 0.9), margin=0.9, foot=0.3, tries=60
    )
    if kind == "lawn":
        plot.scatter(play.build_ping_pong, 1, inner, margin=0.7, turn=quarter[:2])
        plot.scatter(lambda: grounds.build_sculpture(rng), 1, inner, margin=0.6)
    if kind in ("lawn", "orchard"):
        plot.scatter(lambda: seating.build_picnic_table(rng), 1, inner, margin=0.7, turn=quarter)
        plot.scatter(lambda: seating.build_deck_chair(rng), 2, inner, margin=0.5, turn=quarter,
                     jitter=0.4)  # fmt: skip
        plot.scatter(grounds.build_bird_bath, 1, inner, margin=0.5)
        plot.scatter(lambda: planting.build_bush(rng, float(rng.uniform(0.35, 0.55))), 4, inner,
                     margin=0.5)  # fmt: skip
        plot.scatter(lambda: grounds.build_clothesline(rng), int(kind == "orchard"), inner,
                     margin=0.5, turn=quarter[:2])  # fmt: skip
    plot.scatter(lambda: seating.build_garden_bench(rng), 1, inner, margin=0.55, turn=quarter)


def _hedge_in(plot: Plot, room: Room) -> None:
    """Hedges along two sides of a quarter, with a gap to walk in."""
    rng = plot.rng
    high = float(rng.uniform(0.7, 1.15))
    low = room.y0 + 0.4 if room.y0 < RING + 0.1 else room.y1 - 0.4
    gap = float(rng.uniform(1.4, 1.9))
    long = (room.width - gap - 0.8) / 2
    if long > 0.8:
        for sx in (-1, 1):
            x = (room.x0 + room.x1) / 2 + sx * (gap / 2 + long / 2)
            plot.put(planting.build_hedge(rng, long, high), x, low)
    side = room.x0 + 0.4 if room.x0 < RING + 0.1 else room.x1 - 0.4
    long = (room.depth - gap - 2.2) / 2
    if long > 0.8:
        for sy in (-1, 1):
            y = (room.y0 + room.y1) / 2 + sy * (gap / 2 + long / 2)
            plot.put(planting.build_hedge(rng, long, high), side, y, math.pi / 2)


def _set_tables(plot: Plot, room: Room) -> None:
    """Bistro tables with chairs, parasols over some; a barbecue."""
    rng = plot.rng
    columns = max(1, int((room.width - 0.8) / 2.9))
    rows = max(1, int((room.depth - 0.8) / 2.9))
    for i in range(columns):
        for j in range(rows):
            if rng.random() > 0.75 * plot.effort + 0.2:
                continue
            x = room.x0 + room.width * (i + 0.5) / columns
            y = room.y0 + room.depth * (j + 0.5) / rows
            plot.put(seating.build_garden_table(rng), x, y, zone=room.id)
            start = float(rng.uniform(0, 6.28))
            count = int(rng.integers(2, 5))
            for k in range(count):
                a = start + 2 * math.pi * k / count + float(rng.normal(0, 0.1))
                r = float(rng.uniform(0.55, 0.72))
                plot.put(seating.build_garden_chair(rng), x + r * math.cos(a), y + r * math.sin(a),
                         a - math.pi / 2, zone=room.id)  # fmt: skip
            if rng.random() < 0.7:
                parasol = seating.build_parasol(rng)
                plot.put(parasol, x + 0.45, y + 0.45, zone=room.id, solid=False)
    inner = _inner(room, 0.3)
    plot.scatter(grounds.build_barbecue, 1, inner, margin=0.35, tries=60)
    plot.scatter(lambda: planting.build_planter(rng), 3, inner, margin=0.3, tries=40)


def _fill_walks(plot: Plot, yard: Yard, palette: Palette) -> None:
    """Along the houses: bicycles, benches, bins, lamps, planters, climbing beds."""
    rng = plot.rng
    w, d = yard.width, yard.depth
    ends = ((0.0, "south", w), (math.pi, "north", w), (math.pi / 2, "west", d),
            (-math.pi / 2, "east", d))  # fmt: skip
    for _, name, length in ends:
        if name == "south":
            strip: Rect = (1.0, 0.1, w - 1.0, 0.95)
            turn = math.pi
        elif name == "north":
            strip, turn = (1.0, d - 0.95, w - 1.0, d - 0.1), 0.0
        elif name == "west":
            strip, turn = (0.1, 1.0, 0.95, d - 1.0), math.pi / 2
        else:
            strip, turn = (w - 0.95, 1.0, w - 0.1, d - 1.0), -math.pi / 2
        turns = (turn,)
        plot.scatter(lambda: seating.build_garden_bench(rng), 1, strip, margin=0.5, turn=turns)
        plot.scatter(lambda: planting.build_planter(rng), int(length / 5), strip, margin=0.5)
        plot.scatter(lambda: street.build_litter_bin(rng), 1, strip, margin=0.3)
        plot.scatter(lambda: build_wheelie_bin(rng), int(rng.integers(0, 4)), strip, margin=0.02,
                     turn=turns)  # fmt: skip
        deep = 1.9
        rack_strip = {
            "south": (1.0, 0.15, w - 1.0, deep), "north": (1.0, d - deep, w - 1.0, d - 0.15),
            "west": (0.15, 1.0, deep, d - 1.0), "east": (w - deep, 1.0, w - 0.15, d - 1.0),
        }[name]  # fmt: skip
        if rng.random() < 0.6:
            count = int(rng.integers(3, 6))
            plot.scatter(
                lambda count=count: street.build_bicycle_rack(rng, count), 1, rack_strip,  # type: ignore[misc]
                margin=0.35, turn=turns,
            )  # fmt: skip
        plot.scatter(lambda: planting.build_flower_bed(rng, float(rng.uniform(1.6, 2.6)), 0.7), 1,
                     strip, margin=0.4, turn=turns)  # fmt: skip
    inset = RING - 0.25
    for _ in range(6):
        x, y = float(rng.uniform(1.2, w - 1.2)), float(rng.choice([RING / 2 + 0.4, d - RING / 2]))
        plot.put(street.build_drain(), x, y, solid=False)
    for x, y in ((inset, inset), (w - inset, inset), (inset, d - inset), (w - inset, d - inset)):
        plot.try_put(street.build_lamp_post(rng), x, y)
    for sx in (-1, 1):
        x = w / 2 + sx * (yard.square / 2 + 1.4)
        plot.try_put(street.build_lamp_post(rng), x, d / 2 + ARM / 2 + 0.05)
    for sx in (-1, 1):
        for y in (RING + 0.1, d - RING - 0.1):
            plot.try_put(street.build_bollard(), w / 2 + sx * (ARM / 2 - 0.15), y)
    wall = next(name for _, name, _ in ends if name != yard.open_side)
    at = {
        "south": (1.1, 0.005, math.pi), "north": (w - 1.1, d - 0.005, 0.0),
        "west": (0.005, d - 1.1, math.pi / 2), "east": (w - 0.005, 1.1, -math.pi / 2),
    }[wall]  # fmt: skip
    plot.put(grounds.build_hose(rng), at[0], at[1], at[2], z=0.5, solid=False, zone=f"{wall}_walk")
    whole = (0.3, 0.3, w - 0.3, d - 0.3)
    quarter = (0.0, math.pi / 2, math.pi, -math.pi / 2)
    plot.scatter(lambda: street.build_bicycle(rng), 2, whole, margin=0.5, turn=quarter, jitter=0.4)
    plot.scatter(lambda: street.build_litter_bin(rng), 2, whole, margin=0.5)
    plot.scatter(street.build_hydrant, 1, whole, margin=0.5)
    plot.scatter(grounds.build_watering_can, 1, whole, margin=0.4, turn=quarter, jitter=0.5)
    if yard.depth > 20 and rng.random() < 0.6:
        long = yard.quarters[0][0].depth * 0.8
        y = (RING + yard.depth / 2 - ARM / 2) / 2
        pergola = seating.build_pergola(rng, round(long, 2))
        if plot.is_free((w / 2 - 0.9, y - long / 2, w / 2 + 0.9, y + long / 2), ignore_keep=True):
            plot.put(pergola, w / 2, y, math.pi / 2, solid=False)
