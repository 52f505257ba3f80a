"""From a seed to a warehouse: pallet racks, a packing area, loading docks, a glazed office."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.building import choose_palette
from gn0.scenes.procedural.catalogue.clutter.on_floor import build_bin
from gn0.scenes.procedural.catalogue.depot import loading, pallets, racks, trucks
from gn0.scenes.procedural.catalogue.fixtures import (
    build_extinguisher,
    build_notice_board,
    build_vending_machine,
)
from gn0.scenes.procedural.catalogue.light import glow
from gn0.scenes.procedural.catalogue.office import build_lockers
from gn0.scenes.procedural.catalogue.seats.chairs import build_bench
from gn0.scenes.procedural.catalogue.shop.signs import build_sign
from gn0.scenes.procedural.draft import Lamp, Material, SceneDraft, Sun
from gn0.scenes.procedural.groups import light_ceiling, place_corner_things, place_desk
from gn0.scenes.procedural.layout import RoomLayout
from gn0.scenes.procedural.palette import STEEL, Palette, plain
from gn0.scenes.procedural.plan import FloorPlan, Opening, Room, Wall
from gn0.scenes.procedural.plots import Plot, draw_walkable, plan_hall
from gn0.scenes.procedural.shapes import Shape, build_box, build_panel, build_rod
from gn0.scenes.procedural.shell import (
    SIDES,
    RoomFinish,
    build_door,
    build_opening_shell,
    build_room_shell,
    build_window,
)
from gn0.seeds import random_stream

SIZES = {"small": (300.0, 390.0), "medium": (430.0, 560.0), "large": (620.0, 800.0)}  # m² of floor
YARD = 6.4  # depth of the strip before the docks [m]
CROSS = 1.7  # depth of the cross aisle at the back [m]
BAY = 2.72  # of a rack [m]
OFFICE = (4.4, 3.7)  # of the glazed office in the corner [m]
PARTITION = 2.5  # height of the office's walls [m]


@dataclass(frozen=True)
class Depot:
    """Measures of a warehouse.

    Attributes:
        plan: the hall with its doors and windows.
        zones: its parts; the last is the office.
        rows: x of the middle of each rack row and the zone that it belongs to.
        bays: of each row.
        docks: x of the roller doors.
        width, depth: of the hall [m].
    """

    plan: FloorPlan
    zones: tuple[Room, ...]
    rows: tuple[tuple[float, str], ...]
    bays: int
    docks: tuple[float, ...]
    width: float
    depth: float


def plan_depot(seed: int, size: str) -> Depot:
    """Walls, zones, racks and docks of a warehouse.

    Raises:
        KeyError: no such size.
    """
    rng = random_stream(seed, "warehouse", "plan")
    area = float(rng.uniform(*SIZES[size]))
    ratio = float(rng.uniform(1.1, 1.5))
    bays = max(2, round((math.sqrt(area / ratio) - YARD - CROSS) / BAY))
    depth = round(YARD + CROSS + bays * BAY + 0.5, 2)
    width = round(area / depth, 2)
    aisles = max(2, int((width - 0.1) / 4.85))
    clear = (width - 2 * 1.1 - (aisles - 1) * 2.14) / aisles
    rows: list[tuple[float, str]] = []
    zones = []
    x, left = 0.58, 0.0
    for k in range(aisles):
        id = f"rack_aisle_{k + 1}"
        rows.append((round(x, 3), id))
        x += 0.52 + clear + 0.52
        rows.append((round(x, 3), id))
        right = width if k + 1 == aisles else round(x + 0.535, 3)
        zones.append(Room(id, "rack aisle", left, YARD, right, depth))
        left, x = right, x + 1.07
    ceiling = round(float(rng.uniform(6.4, 7.6)), 2)
    ox, oy = OFFICE
    split = round(ox + float(rng.uniform(0.34, 0.42)) * (width - ox), 2)
    zones += [
        Room("break_area", "break area", 0, oy, ox, YARD),
        Room("packing_area", "packing area", ox, 0, split, YARD),
        Room("loading_area", "loading area", split, 0, width, YARD),
        Room("office", "office", 0, 0, ox, oy),
    ]
    count = max(2, int((width - split - 0.4) / 4.3))
    docks = tuple(round(split + (width - split) * (k + 0.5) / count, 3) for k in range(count))
    t = 0.24
    high = ceiling - 1.7
    openings = [
        Opening("entrance", "x", -t / 2, ox + 0.9, ox + 1.95, 0.0, 2.1, t, (None, "hall")),
    ]
    for k in range(int(width / 5.2)):
        a = 1.3 + 5.2 * k
        openings.append(
            Opening("window", "x", -t / 2, a, a + 2.6, high, high + 1.0, t, (None, "hall"))
        )
    for k in range(int(depth / 5.2)):
        a = 1.6 + 5.2 * k
        openings.append(
            Opening("window", "y", width + t / 2, a, a + 2.4, high, high + 1.0, t, ("hall", None))
        )
    openings.append(Opening("window", "y", -t / 2, 1.2, 3.0, 1.0, 2.2, t, (None, "hall")))
    plan = plan_hall([("hall", -t / 2, -t / 2, width + t / 2, depth + t / 2)], openings, ceiling)
    partitions = (
        Wall("x", oy, 0.0, ox, 0.1, (None, None)),
        Wall("y", ox, 0.0, oy - 1.3, 0.1, (None, None)),
    )
    plan = replace(plan, walls=(*plan.walls, *partitions))
    return Depot(plan, tuple(zones), tuple(rows), bays, docks, width, depth)


def draft_warehouse(
    seed: int, *, size: str = "medium", style: str | Palette | None = None
) -> SceneDraft:
    """A stocked warehouse, before light.

    Args:
        seed: of everything.
        size: "small", "medium" or "large" (see `SIZES`).
        style: taste of the office; drawn when None.

    Raises:
        SceneError: an unknown style, or no walkable layout was found (not known to happen).
    """
    palette = choose_palette("warehouse", seed, style)
    house = plan_depot(seed, size)
    return draw_walkable(
        f"warehouse {seed}", house.zones, house.plan, partial(_draw, seed, house, palette)
    )


def _draw(seed: int, house: Depot, palette: Palette, attempt: int, effort: float) -> SceneDraft:
    rng = random_stream(seed, "warehouse", "goods", attempt)
    plot = Plot(rng, list(house.zones), effort)
    _add_shell(plot, house, palette, random_stream(seed, "warehouse", "shell"))
    _paint_floor(plot, house)
    _fill_racks(plot, house)
    _equip_docks(plot, house)
    _build_office(plot, house, palette, random_stream(seed, "warehouse", "office", attempt))
    _equip_front(plot, house, palette)
    _light_hall(plot, house, random_stream(seed, "warehouse", "lamps"))
    _scatter_things(plot, house)
    heading = float(rng.uniform(0.9, 2.2))
    low = math.radians(float(rng.uniform(30, 45)))
    way = (math.cos(low) * math.cos(heading), math.cos(low) * math.sin(heading), -math.sin(low))
    x, y, z = (round(v, 6) for v in way)
    return plot.finish(house.plan, sun=Sun(direction=(x, y, z), colour=(7.0, 6.2, 5.0)))


def _add_shell(plot: Plot, house: Depot, palette: Palette, rng: np.random.Generator) -> None:
    """Slab, sheet-metal walls on a concrete base, roof with beams, columns, windows."""
    w, d, top = house.width, house.depth, house.plan.ceiling
    slab = plain("slab", "concrete", "#86847e", second="#6d6b66", contrast=0.5, detail=0.6)
    sheet = plain("wall sheet", "corrugated", str(rng.choice(["#a3a9ad", "#98a5ac", "#b0ada3"])),
                  scale=0.33, contrast=0.28, detail=0.3)  # fmt: skip
    base = plain("wall base", "concrete", "#98958e", second="#7c7973", contrast=0.35, detail=0.4)
    roof = plain("roof sheet", "corrugated", "#d2d4d4", scale=0.4, contrast=0.25, detail=0.2)
    finish = RoomFinish(dict.fromkeys(SIDES, sheet), slab, 1.3, base, ceiling=roof)
    hall = house.plan.rooms[0]
    finishes = {"hall": finish}
    plot.assembly.add_shell(*build_room_shell(house.plan, hall, finish))
    steel = plain("roof steel", "metal", str(rng.choice(["#5b6f86", "#7d858c", "#8c4a34"])),
                  contrast=0.15)  # fmt: skip
    plot.assembly.add_shell(*_roof_steel(w, d, top, steel))
    for k, opening in enumerate(house.plan.openings):
        plot.assembly.add_shell(*build_opening_shell(opening, finishes))
        x, y = opening.centre
        zone = plot.zone_at(min(max(x, 0.3), w - 0.3), min(max(y, 0.3), d - 0.3))
        if opening.kind == "window":
            plot.assembly.add_item(build_window(opening, rng, k), zone)
        else:
            leaf = plain("steel door", "paint", "#4d5c6b", contrast=0.06)
            plot.assembly.add_item(build_door(opening, leaf, STEEL, 2), zone)


def _roof_steel(w: float, d: float, top: float, steel: Material) -> list[Shape]:
    """Columns along the side walls, girders across with a lattice, purlins."""
    out: list[Shape] = []
    frames = max(3, round(d / 4.6))
    deep = 0.75
    for k in range(frames + 1):
        y = min(max(k * d / frames, 0.16), d - 0.16)
        for x in (0.11, w - 0.11):
            out.append(build_box((0.18, 0.2, top), steel, at=(x, y, 0)))
        out.append(build_box((w - 0.4, 0.14, 0.1), steel, at=(w / 2, y, top - 0.12)))
        out.append(build_box((w - 0.4, 0.12, 0.09), steel, at=(w / 2, y, top - deep)))
        fields = max(4, int(w / 1.5))
        for f in range(fields):
            x0 = 0.2 + (w - 0.4) * f / fields
            x1 = 0.2 + (w - 0.4) * (f + 1) / fields
            z0, z1 = (top - deep + 0.06, top - 0.1) if f % 2 else (top - 0.1, top - deep + 0.06)
            out.append(build_rod((x0, y, z0), (x1, y, z1), 0.03, steel, sides=4))
    for k in range(1, max(2, int(w / 3.2))):
        x = k * 3.2
        out.append(build_box((0.08, d - 0.2, 0.12), steel, at=(x, d / 2, top - 0.13)))
    return out


def _line(x0: float, y0: float, x1: float, y1: float, material: Material) -> Shape:
    """A painted rectangle of floor."""
    return build_panel((x0, y0, 0.0035), (x1 - x0, 0, 0), (0, y1 - y0, 0), material)


def _paint_floor(plot: Plot, house: Depot) -> None:
    """Yellow lines along racks and docks, a green walkway, hatched ground before the doors."""
    slab = "#7d7b75"
    yellow = plain("yellow line", "line_paint", "#e3b01a", second=slab, contrast=0.75, detail=0.7)
    white = plain("white line", "line_paint", "#dcdad2", second=slab, contrast=0.75, detail=0.7)
    green = plain("walkway", "line_paint", "#3a7550", second=slab, contrast=0.4, detail=0.7)
    hatch = plain("hatching", "hazard", "#d9aa1c", second="#74726d", scale=0.5, contrast=0.6,
                  detail=0.8)  # fmt: skip
    w = house.width
    y1 = YARD + 0.25 + house.bays * BAY
    shapes = []
    for x, zone in house.rows:
        aisle = next(z for z in house.zones if z.id == zone)
        inward = 1.0 if x < (aisle.x0 + aisle.x1) / 2 else -1.0
        at = x + inward * 0.68
        shapes.append(_line(at - 0.04, YARD + 0.2, at + 0.04, y1, yellow))
    ox = OFFICE[0]
    shapes += [
        _line(ox + 0.3, YARD - 1.35, w - 0.3, YARD - 0.35, green),
        _line(ox + 0.3, YARD - 1.47, w - 0.3, YARD - 1.37, white),
        _line(ox + 0.3, YARD - 0.33, w - 0.3, YARD - 0.23, white),
    ]
    for x in house.docks:
        shapes.append(_line(x - 1.5, 0.45, x + 1.5, 1.25, hatch))
        for sx in (-1, 1):
            shapes.append(_line(x + sx * 1.6 - 0.05, 0.45, x + sx * 1.6 + 0.05, YARD - 1.5, yellow))
    plot.assembly.add_shell(*shapes)


def _fill_racks(plot: Plot, house: Depot) -> None:
    """One rack object for every row; pallets on the floor and on two or three beams."""
    rng = plot.rng
    three = house.plan.ceiling > 6.9
    levels = (0.0, 1.62, 3.05, 4.4) if three else (0.0, 1.75, 3.35)
    for x, zone in house.rows:
        rack = racks.build_rack(rng, house.bays, levels=levels, height=5.2 if three else 4.6)
        plot.put(rack, x, YARD + 0.25 + house.bays * BAY / 2, math.pi / 2, zone=zone)
    for k, aisle in enumerate(z for z in house.zones if z.type == "rack aisle"):
        sign = build_sign(f"AISLE {k + 1}", 1.5, 0.5, "#1f4f9c", "#f2f0e6",
                          drop=house.plan.ceiling - 0.85 - 4.1)  # fmt: skip
        x = (aisle.x0 + aisle.x1) / 2
        plot.put(sign, x, YARD + 0.1, 0.0, z=3.6, solid=False, zone=aisle.id)


def _equip_docks(plot: Plot, house: Depot) -> None:
    """Roller doors with what waits before them."""
    rng = plot.rng
    for k, x in enumerate(house.docks):
        plot.put(loading.build_dock(rng, k + 1, 2.7, 3.0), x, 0.005, math.pi, zone="loading_area")
        for j in range(int(rng.integers(0, 4))):
            load = str(rng.choice(["cartons", "wrapped", "wrapped", "sacks"]))
            item = pallets.build_pallet(rng, load=load, high=float(rng.uniform(0.9, 1.7)))
            sx = -1 if j % 2 else 1
            y = 2.1 + 1.45 * (j // 2)
            plot.try_put(item, x + sx * 0.85, y, math.pi / 2, margin=0.02)


def _build_office(plot: Plot, house: Depot, palette: Palette, rng: np.random.Generator) -> None:
    """Partitions with windows and an open doorway, and the desk behind them."""
    ox, oy = OFFICE
    board = plain("partition", "plastic", "#dfe0dc", contrast=0.05, detail=0.2)
    frame = plain("partition frame", "metal", "#5a6168", contrast=0.1)
    t, sill, head = 0.1, 1.0, 2.1
    gap = 1.15  # of the doorway, at the far end of the side that faces the docks
    runs = ((0.0, ox + t / 2, "x"), (0.0, oy - gap, "y"))
    shapes: list[Shape] = []
    for low, high, axis in runs:
        length = high - low
        wall = [
            build_box((length, t, sill), board),
            build_box((length, t, PARTITION - head), board, at=(0, 0, head)),
        ]
        count = max(1, round(length / 1.3))
        for k in range(count + 1):
            x = -length / 2 + 0.04 + k * (length - 0.08) / count
            wall.append(build_box((0.08, t, head - sill), frame, at=(x, 0, sill)))
        for piece in wall:
            if axis == "x":
                shapes.append(piece.moved((low + high) / 2, oy, 0))
            else:
                shapes.append(piece.moved(ox, (low + high) / 2, 0, math.pi / 2))
    shapes.append(build_box((t, gap - t / 2, PARTITION - head), board,
                            at=(ox, oy - gap / 2 - t / 4, head)))  # fmt: skip
    plot.assembly.add_shell(*shapes)
    plot.taken.append((0.0, 0.0, ox + 0.1, oy + 0.1))
    room = Room("office", "office", 0.0, 0.0, ox - t / 2, oy - t / 2)
    door = Opening("passage", "y", ox, oy - gap, oy - t / 2, 0.0, head, t, ("office", None))
    small = FloorPlan((room,), (), (door,), PARTITION)
    layout = RoomLayout(small, room, rng, palette)
    place_desk(layout, kelvin=4000.0)
    place_desk(layout, kelvin=4000.0)
    layout.place_on_wall(racks.build_storage_shelf(rng, 1.2), prefer="corner")
    place_corner_things(layout, plants=1)
    light_ceiling(layout, 4000.0, flux=5.0)
    for placed in layout.placed:
        if placed.item.category == "ceiling lamp":
            bar = build_rod((placed.x, 0.05, PARTITION), (placed.x, oy, PARTITION), 0.02, frame)
            plot.assembly.add_shell(bar)
        plot.assembly.add_item(placed, "office")
    sign = build_sign("OFFICE", 0.8, 0.26, "#1f4f9c", "#f2f0e6")
    plot.put(sign, ox + 0.08, oy - 1.9, math.pi / 2, z=2.15, solid=False, zone="packing_area")


def _equip_front(plot: Plot, house: Depot, palette: Palette) -> None:
    """Break area, packing tables with a conveyor and a wrapper, signs on the walls."""
    rng = plot.rng
    ox, oy = OFFICE
    packing = next(z for z in house.zones if z.id == "packing_area")
    colour = str(rng.choice(["#5b7f9c", "#8a8f94", "#7f9c6b"]))
    lockers = build_lockers(rng, colour, 4, 2)
    deep = float(lockers.full_extent()[1][1])
    plot.put(lockers, 0.02 + deep, oy + 1.35, math.pi / 2, zone="break_area")
    plot.put(build_vending_machine(rng), 1.6, oy + 0.5, math.pi, zone="break_area")
    plot.put(build_bench(rng, palette, 1.4), 3.1, oy + 0.42, math.pi, zone="break_area")
    tables = max(1, int((packing.width - 2.6) / 2.1))
    for k in range(tables):
        x = packing.x0 + 2.5 + 2.1 * k + 0.6
        if x + 0.95 < packing.x1:
            plot.put(pallets.build_packing_table(rng), x, 0.45, math.pi, front=0.2)
    long = min(packing.width - 1.2, 5.5)
    if long > 2.0:
        plot.try_put(
            pallets.build_conveyor(rng, long), packing.x0 + 0.9 + long / 2, 2.45, 0.0, margin=0.3
        )
    plot.try_put(pallets.build_wrapper(rng), packing.x1 - 1.1, 3.9, 0.0, margin=0.1)
    tower = racks.build_bin_tower(rng)
    plot.put(tower, house.width - 0.23, 3.0, -math.pi / 2, front=0.3, zone="loading_area")
    for k in range(4):
        sign = loading.build_safety_sign(rng)
        x = house.docks[0] - 2.1 + 4.3 * k
        if 0.6 < x < house.width - 0.6:
            plot.put(sign, x, 0.004, math.pi, z=2.2, solid=False)
    board = build_notice_board(rng, palette)
    plot.put(board, 0.02, oy + 2.25, math.pi / 2, z=1.5, solid=False, zone="break_area")
    for x in (ox + 2.4, house.docks[-1] + 1.95):
        plot.put(build_extinguisher(), min(x, house.width - 0.4), 0.005, math.pi, z=0.7,
                 solid=False)  # fmt: skip


def _light_hall(plot: Plot, house: Depot, rng: np.random.Generator) -> None:
    """High-bay lamps over the aisles and the yard, rooflights between the girders."""
    kelvin = float(rng.choice([4000.0, 4500.0, 5000.0]))
    top, w, d = house.plan.ceiling, house.width, house.depth
    spots = []
    for zone in house.zones:
        if zone.type == "rack aisle":
            count = max(2, round(zone.depth / 4.5))
            spots += [
                ((zone.x0 + zone.x1) / 2, zone.y0 + zone.depth * (k + 0.5) / count)
                for k in range(count)
            ]
    count = max(3, round(w / 4.5))
    spots += [(w * (k + 0.5) / count, y) for k in range(count) for y in (1.9, YARD - 1.5)]
    flux = 0.75 * w * d / len(spots)
    for x, y in spots:
        plot.put(loading.build_high_bay(0.85, kelvin, flux), x, y, 0.0, z=top, solid=False)
    day = glow(6200.0, 1.5, "#f4f6f6")
    for k in range(max(1, int(d / 6.5))):
        y = d * (k + 0.5) / max(1, int(d / 6.5))
        for j in range(max(1, int(w / 8.0))):
            x = w * (j + 0.5) / max(1, int(w / 8.0)) + 0.8
            lamp = Lamp(
                centre=(0.0, 0.0, -0.08),
                size=(1.1, 2.4),
                shape="window",
                colour=(1.7, 1.85, 2.1),
            )
            pane = Item(
                "rooflight",
                (
                    build_box((1.2, 2.5, 0.06), STEEL, at=(0, 0, -0.06)),
                    build_panel((-0.55, 1.2, -0.062), (1.1, 0, 0), (0, -2.4, 0), day),
                ),
                lamps=(lamp,),
            )
            plot.put(pane, x, y, 0.0, z=top - 0.001, solid=False)


def _scatter_things(plot: Plot, house: Depot) -> None:
    """Trucks, barrels, ladders, cones: what stands about in a depot."""
    rng = plot.rng
    quarter = (0.0, math.pi / 2, math.pi, -math.pi / 2)
    w = house.width
    yard = (OFFICE[0] + 0.3, 1.6, w - 0.3, YARD - 0.2)
    aisles = (0.3, YARD + 0.3, w - 0.3, house.depth - 0.3)
    corners = (0.3, house.depth - CROSS + 0.35, w - 0.3, house.depth - 0.15)
    plot.scatter(lambda: trucks.build_forklift(rng), 1, yard, margin=0.55, turn=quarter, jitter=0.2,
                 tries=80)  # fmt: skip
    plot.scatter(lambda: trucks.build_forklift(rng), 1, aisles, margin=0.5,
                 turn=(0.0, math.pi), jitter=0.05, tries=60)  # fmt: skip
    makers = (
        (lambda: trucks.build_pallet_truck(rng), 2),
        (lambda: trucks.build_hand_truck(rng), 2),
        (lambda: loading.build_ladder(rng), 2),
        (lambda: trucks.build_roll_cage(rng), 3),
        (lambda: pallets.build_pallet(rng, load="stack"), 3),
        (lambda: pallets.build_pallet(rng, load="none"), 1),
        (loading.build_cone, 4),
    )
    for make, count in makers:
        plot.scatter(make, count, yard if count > 2 else aisles, margin=0.55, turn=quarter,
                     jitter=0.08)  # fmt: skip
        plot.scatter(make, 1, yard, margin=0.55, turn=quarter, jitter=0.08)
    plot.scatter(lambda: pallets.build_barrel(rng), 6, corners, margin=0.02, tries=40)
    plot.scatter(lambda: loading.build_wheelie_bin(rng), 2, corners, margin=0.05, tries=40)
    plot.scatter(lambda: pallets.build_pallet(rng, load="barrels"), 2, corners, margin=0.05,
                 turn=(0.0,), tries=40)  # fmt: skip
    litter = build_bin(rng, choose_palette("bin", 0, None))
    plot.scatter(lambda: litter, 2, yard, margin=0.3)
