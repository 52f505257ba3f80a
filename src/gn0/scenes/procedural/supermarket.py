"""From a seed to a supermarket: one hall in zones, with a store room and an office behind it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.building import choose_palette
from gn0.scenes.procedural.catalogue.clutter.on_floor import build_bin
from gn0.scenes.procedural.catalogue.depot import loading, pallets, racks, trucks
from gn0.scenes.procedural.catalogue.fixtures import (
    build_extinguisher,
    build_notice_board,
    build_panel_lamp,
    build_smoke_detector,
    build_vending_machine,
    build_vent,
)
from gn0.scenes.procedural.catalogue.shop import checkouts, market, shelves, signs
from gn0.scenes.procedural.draft import Material, SceneDraft, Sun
from gn0.scenes.procedural.goods import SHELF_GOODS
from gn0.scenes.procedural.groups import light_ceiling, place_corner_things, place_desk
from gn0.scenes.procedural.layout import RoomLayout
from gn0.scenes.procedural.palette import BLACK, STEEL, WHITE, Palette, plain
from gn0.scenes.procedural.plan import FloorPlan, Opening, Room
from gn0.scenes.procedural.plots import Plot, draw_walkable, plan_hall
from gn0.scenes.procedural.shapes import build_box, build_cylinder
from gn0.scenes.procedural.shell import (
    SIDES,
    RoomFinish,
    build_door,
    build_opening_shell,
    build_room_shell,
    build_window,
)
from gn0.seeds import random_stream

SIZES = {"small": (235.0, 305.0), "medium": (340.0, 425.0), "large": (450.0, 560.0)}  # m² of floor
FRONT = 4.7  # depth of entrance and checkouts [m]
MARKET = 6.3  # width of the produce and bakery side [m]
BACK = 3.0  # depth of the dairy strip [m]
GONDOLA = 1.04  # width of a double shelf [m]
AISLE = 1.66  # least width of an aisle [m]
FAMILIES = ("breakfast", "snack", "pantry", "drinks", "household", "baby and pet")


@dataclass(frozen=True)
class Store:
    """Measures of a store.

    Attributes:
        plan: hall, store room and office with their doors.
        zones: the hall's parts, and the rooms.
        gondolas: x of the middles of the rows; the first is freezers.
        families: goods of each aisle, left to right.
        bays: bays of each row.
        lanes: checkouts.
        width, depth: of the hall [m].
    """

    plan: FloorPlan
    zones: tuple[Room, ...]
    gondolas: tuple[float, ...]
    families: tuple[str, ...]
    bays: int
    lanes: int
    width: float
    depth: float


def plan_store(seed: int, size: str) -> Store:
    """Walls, zones and rows of a store.

    Raises:
        KeyError: no such size.
    """
    rng = random_stream(seed, "supermarket", "plan")
    low, high = SIZES[size]
    area = float(rng.uniform(low, high))
    ratio = float(rng.uniform(1.0, 1.3))
    behind = float(rng.uniform(3.4, 4.2))
    total = math.sqrt(area / ratio)  # depth of hall and back rooms
    width = round(area / total, 2)
    bays = max(3, round((total - behind - FRONT - BACK - 2.0) / shelves.BAY))
    depth = round(FRONT + BACK + 2.0 + bays * shelves.BAY, 2)
    width = round(min(max(area / (depth + behind), 15.0), 30.0), 2)
    rows = max(2, int((width - MARKET - 0.56) / (GONDOLA + AISLE)))
    pitch = (width - MARKET - 0.56) / rows
    gondolas = tuple(round(MARKET + GONDOLA / 2 + k * pitch, 3) for k in range(rows))
    ceiling = round(float(rng.uniform(3.4, 4.0)), 2)
    split = round(width * float(rng.uniform(0.62, 0.7)), 2)
    t, h = 0.24, 0.12  # outer and inner walls: rooms are given on centre lines
    cells = [
        ("hall", -t / 2, -t / 2, width + t / 2, depth + h / 2),
        ("storage room", -t / 2, depth + h / 2, split, depth + h / 2 + behind),
        ("office", split, depth + h / 2, width + t / 2, depth + h / 2 + behind),
    ]
    back_y = depth + h / 2
    door = MARKET + float(rng.uniform(0.2, 1.0))
    openings = [
        Opening("passage", "x", back_y, door, door + 1.7, 0.0, 2.35, h, ("hall", "storage_room")),
        Opening("door", "x", back_y, split + 0.35, split + 1.27, 0.0, 2.05, h, ("hall", "office"),
                leaf="office", hinge="high"),
        Opening("window", "x", -t / 2, 1.6, 4.2, 0.0, 2.5, t, (None, "hall")),
    ]  # fmt: skip
    x = 5.0
    while x + 2.6 < width - 0.5:
        openings.append(Opening("window", "x", -t / 2, x, x + 2.6, 0.55, 2.7, t, (None, "hall")))
        x += 3.1
    plan = plan_hall(cells, openings, ceiling)
    names = [str(f) for f in rng.permutation(np.array(FAMILIES))]
    families = ("frozen", *(names * 2)[: rows - 1])
    produce_end = round(depth - BACK - float(rng.uniform(1.6, 2.3)), 2)
    lanes = int(np.clip((width - 7.6) / 2.35, 2, 5))
    desk = round(width - 1.0 - 2.35 * lanes, 2)
    middle = gondolas[0]
    zones = [
        Room("entrance", "entrance", 0, 0, desk, FRONT),
        Room("checkout", "checkout area", desk, 0, width, FRONT),
        Room("produce", "produce section", 0, FRONT, middle, produce_end),
        Room("bakery", "bakery", 0, produce_end, middle, depth),
        Room("dairy", "dairy section", middle, depth - BACK, width, depth),
    ]
    for k, family in enumerate(families):
        right = gondolas[k + 1] if k + 1 < rows else width
        kind = {"frozen": "frozen food aisle", "drinks": "drinks aisle"}.get(
            family, f"{family} aisle"
        )
        zones.append(Room(f"aisle_{k + 1}", kind, gondolas[k], FRONT, right, depth - BACK))
    zones += [plan.room("storage_room"), plan.room("office")]
    return Store(plan, tuple(zones), gondolas, families, bays, lanes, width, depth)


def draft_supermarket(
    seed: int, *, size: str = "medium", style: str | Palette | None = None
) -> SceneDraft:
    """A stocked supermarket, before light.

    Args:
        seed: of everything.
        size: "small", "medium" or "large" (see `SIZES`).
        style: taste of colours and floors; drawn when None.

    Raises:
        SceneError: an unknown style, or no walkable layout was found (not known to happen).
    """
    palette = choose_palette("supermarket", seed, style)
    store = plan_store(seed, size)
    return draw_walkable(
        f"supermarket {seed}", store.zones, store.plan, partial(_draw, seed, store, palette)
    )


def _draw(seed: int, store: Store, palette: Palette, attempt: int, effort: float) -> SceneDraft:
    rng = random_stream(seed, "supermarket", "goods", attempt)
    plot = Plot(rng, list(store.zones), effort)
    _add_shell(plot, store, palette, random_stream(seed, "supermarket", "shell"))
    _fill_aisles(plot, store)
    _fill_market(plot, store)
    _fill_dairy(plot, store)
    _fill_front(plot, store)
    _hang_signs(plot, store)
    _light_hall(plot, store, random_stream(seed, "supermarket", "lamps"))
    _scatter_things(plot, store)
    _furnish_back(plot, store, palette, seed, attempt)
    heading = float(rng.uniform(-0.5, 0.5)) + math.pi / 2
    low = math.radians(float(rng.uniform(25, 45)))
    way = (math.cos(low) * math.cos(heading), math.cos(low) * math.sin(heading), -math.sin(low))
    x, y, z = (round(v, 6) for v in way)
    return plot.finish(store.plan, sun=Sun(direction=(x, y, z), colour=(6.0, 5.4, 4.4)))


def _add_shell(plot: Plot, store: Store, palette: Palette, rng: np.random.Generator) -> None:
    """Floor, walls, suspended ceiling, shop windows, doors."""
    kind = int(rng.integers(3))
    floor = (
        plain("floor tiles", "tiles", "#c9c5ba", second="#9a968c", scale=0.5, contrast=0.35,
              detail=0.8, seed=int(rng.integers(6))),
        plain("vinyl floor", "concrete", "#bdb7a8", second="#a39c8c", contrast=0.25, detail=0.5),
        plain("stone floor", "tiles", "#a9a59d", second="#807c74", scale=0.75, contrast=0.5,
              detail=0.8, seed=int(rng.integers(6))),
    )[kind]  # fmt: skip
    wall = plain("hall wall", "paint", "#e9e7e0", contrast=0.08, scale=0.6, detail=0.0)
    band = plain("wall band", "plastic", str(rng.choice(palette.style.accents)), contrast=0.06,
                 detail=0.0)  # fmt: skip
    ceiling = plain("ceiling tiles", "tiles", "#e8e7e2", second="#bcbab4", scale=0.6, contrast=0.12,
                    detail=0.4)  # fmt: skip
    raw = plain("store floor", "concrete", "#a3a09a", second="#8c8983", contrast=0.3, detail=0.5)
    finishes = {}
    for room in store.plan.rooms:
        walls: dict[str, Material] = dict.fromkeys(SIDES, wall)
        ground = floor if room.id == "hall" else raw
        finishes[room.id] = RoomFinish(walls, ground, ceiling=ceiling)
        plot.assembly.add_shell(*build_room_shell(store.plan, room, finishes[room.id]))
    w, d, top = store.width, store.depth, store.plan.ceiling
    for x, y, along, length in (
        (w / 2, 0.015, 0.0, w), (w / 2, d - 0.015, 0.0, w),
        (0.015, d / 2, math.pi / 2, d - 0.06), (w - 0.015, d / 2, math.pi / 2, d - 0.06),
    ):  # fmt: skip
        strip = build_box((length, 0.03, 0.45), band)
        plot.assembly.add_shell(strip.moved(x, y, top - 0.62, along))
    view = int(rng.integers(1000))
    for k, opening in enumerate(store.plan.openings):
        plot.assembly.add_shell(*build_opening_shell(opening, finishes))
        if opening.kind == "window":
            item = build_window(opening, rng, view + k)
            zone = plot.zone_at((opening.low + opening.high) / 2, 0.5)
            if opening.bottom <= 0:
                item = Placed(
                    Item("entrance door", item.item.shapes, lamps=item.item.lamps),
                    item.x, item.y, item.z, item.yaw,
                )  # fmt: skip
            plot.assembly.add_item(item, zone)
        elif opening.kind == "door":
            leaf = plain("door lacquer", "paint", "#e3e2dc", contrast=0.05)
            plot.assembly.add_item(build_door(opening, leaf, palette.metal(), 2), opening.leaf)
    plot.keep.append((1.3, 0.0, 4.5, 1.6))
    passage = store.plan.openings[0]
    plot.keep.append((passage.low - 0.3, d - 1.3, passage.high + 0.3, d + 1.5))
    office = store.plan.openings[1]
    plot.keep.append((office.low - 0.3, d - 1.3, office.high + 0.3, d + 1.0))


def _fill_aisles(plot: Plot, store: Store) -> None:
    """Freezers, rows of shelves back to back, end caps, and shelves along the right wall."""
    rng = plot.rng
    length = store.bays * shelves.BAY
    y0 = FRONT + 0.95
    middle = y0 + length / 2
    chest = 1.92
    count = int(length / chest)
    for k in range(count):
        y = middle + (k - (count - 1) / 2) * (chest + 0.01)
        zone = "aisle_1"
        plot.put(shelves.build_freezer_chest(rng), store.gondolas[0], y, math.pi / 2, zone=zone)
    for k, x in enumerate(store.gondolas):
        for sy, y in ((-1, y0), (1, y0 + length)):
            if k == 0:
                y = middle + sy * count * chest / 2
            family = str(rng.choice(["snack", "drinks", "household", store.families[k]]))
            if family not in FAMILIES:
                family = "snack"
            cap = shelves.build_shelf_run(rng, family, 1, bay=0.92, height=1.6,
                                       levels=(0.16, 0.52, 0.88, 1.22))  # fmt: skip
            zone = f"aisle_{min(k + 1, len(store.gondolas))}"
            plot.put(cap, x, y + sy * 0.02, 0.0 if sy < 0 else math.pi, zone=zone)
        if k == 0:
            continue
        for side in (-1, 1):
            aisle = k if side < 0 else k + 1
            family = store.families[aisle - 1]
            if family == "frozen":
                family = str(rng.choice(["pantry", "snack"]))
            left = store.bays
            y = y0
            while left > 0:  # a shelf object is two or three bays long
                bays = left if left <= 3 else 2
                run = shelves.build_shelf_run(rng, family, bays, ends=(True, True))
                y += bays * shelves.BAY / 2
                plot.put(run, x, y, side * math.pi / 2, zone=f"aisle_{aisle}")
                y += bays * shelves.BAY / 2
                left -= bays
    family = store.families[-1]
    if family == "frozen":
        family = "drinks"
    left, y = store.bays, y0
    while left > 0:
        bays = left if left <= 3 else 2
        run = shelves.build_shelf_run(rng, family, bays, height=2.2, levels=(*shelves.LEVELS, 1.87))
        y += bays * shelves.BAY / 2
        plot.put(run, store.width - 0.01, y, -math.pi / 2, zone=f"aisle_{len(store.gondolas)}")
        y += bays * shelves.BAY / 2
        left -= bays


def _fill_market(plot: Plot, store: Store) -> None:
    """Fruit and vegetables along the left wall and on an island; the bakery behind."""
    rng = plot.rng
    produce = next(z for z in store.zones if z.id == "produce")
    bakery = next(z for z in store.zones if z.id == "bakery")
    kinds = int(rng.integers(len(market.PRODUCE)))
    run = produce.depth - 1.3
    columns = max(2, int((run - 0.1) / 2 / 0.63))
    width = columns * 0.63 + 0.04
    stands = max(1, int(run / width))
    for k in range(stands):
        y = produce.y0 + 0.75 + (k + 0.5) * (run / stands)
        stand = market.build_produce_stand(rng, columns, first=kinds)
        kinds += 2 * columns
        plot.put(stand, 0.56, y, math.pi / 2, front=0.4)
    island = min(max(2, int((run - 1.2) / 0.63)), 5)
    y = produce.y0 + 0.75 + run / 2
    for sx in (-1, 1):
        stand = market.build_produce_stand(rng, island, first=kinds)
        kinds += 2 * island
        plot.put(stand, 3.35 + sx * 0.54, y, sx * math.pi / 2, front=0.3)
    low = y - island * 0.315 - 0.3
    scale = _produce_scale()
    plot.try_put(scale, 3.35, low - 0.35, 0.0)
    # bread on the back wall, the counter on the left one
    bread = shelves.build_shelf_run(rng, "bakery", 3, wood=True, height=2.0)
    plot.put(bread, MARKET - 0.55 - 3 * shelves.BAY / 2, bakery.y1 - 0.01, 0.0, front=0.4)
    wide = min(bakery.depth - 0.9, 2.8)
    counter = market.build_bread_counter(rng, wide)
    plot.put(counter, 0.62, bakery.y0 + 0.25 + wide / 2, math.pi / 2, front=0.4)


def _produce_scale() -> Item:
    """A weighing scale for customers on a post."""
    return Item(
        "weighing scale",
        (
            build_cylinder(0.16, 0.02, STEEL, segments=16),
            build_cylinder(0.03, 0.9, STEEL, segments=10),
            build_box((0.36, 0.36, 0.06), WHITE, at=(0, 0, 0.9), bevel=0.015),
            build_box((0.3, 0.03, 0.22), BLACK, at=(0, 0.16, 1.02), bevel=0.008),
        ),
    )


def _fill_dairy(plot: Plot, store: Store) -> None:
    """Coolers along the back wall, between its doors."""
    rng, plan = plot.rng, store.plan
    doors = sorted((o.low - 0.2, o.high + 0.2) for o in plan.openings[:2])
    x = MARKET + 0.15
    stops = [*doors, (store.width - 0.05, store.width)]
    for low, high in stops:
        span = low - x
        count = max(0, round(span / 2.4))
        if count and span / count < 1.5:
            count -= 1
        for k in range(count):
            wide = min(span / count, 3.0) - 0.02
            cooler = shelves.build_cooler(rng, wide)
            plot.put(cooler, x + (k + 0.5) * span / count, store.depth - 0.01, 0.0, front=0.3)
        x = high


def _fill_front(plot: Plot, store: Store) -> None:
    """Checkouts, trolleys, baskets, gates, flowers, posters."""
    rng = plot.rng
    checkout = next(z for z in store.zones if z.id == "checkout")
    for k in range(store.lanes):
        x = checkout.x0 + 1.05 + 2.35 * k
        plot.put(checkouts.build_checkout(rng, k + 1), x, 2.95, math.pi / 2)
        rack = shelves.build_shelf_run(
            rng, "sweets", 1, bay=0.8, height=1.25, levels=(0.16, 0.46, 0.74, 1.0)
        )
        if k < store.lanes:
            plot.put(rack, x - 0.86, 3.6, -math.pi / 2, front=0.05, zone="checkout")
    desk = checkout.x0
    plot.put(checkouts.build_trolley_row(rng, 7), 0.4, 2.0, 0.0)
    if desk > 6.0:
        plot.put(checkouts.build_trolley_row(rng, 5), desk - 0.55, 1.4, 0.0)
    plot.put(checkouts.build_alarm_gate(), 2.9, 1.75, 0.0)
    plot.put(checkouts.build_gate(1.7), 2.9, FRONT - 0.55, 0.0)
    plot.put(checkouts.build_basket_stack(rng), 1.45, FRONT - 0.5, 0.0)
    plot.put(market.build_flower_buckets(rng, 4), 4.75, 0.55, math.pi)
    for k, text in enumerate(("FRESH FRUIT", "OPEN 7-22", "BEST PRICE")):
        poster = signs.build_poster(rng, text, 0.8, 1.15)
        y = 1.2 + 1.5 * k
        if y < FRONT:
            plot.put(poster, 0.005, y, math.pi / 2, z=1.1, solid=False, zone="entrance")
    for k in range(int((store.depth - FRONT - 3) / 2.6)):
        text = ("TASTE THE SUMMER", "MORE FOR LESS", "NEW HERE", "FROM THE REGION")[k % 4]
        poster = signs.build_poster(rng, text, 1.5, 0.8)
        plot.put(
            poster, store.width - 0.005, FRONT + 1.6 + 2.6 * k, -math.pi / 2, z=2.3, solid=False,
            zone=f"aisle_{len(store.gondolas)}",
        )  # fmt: skip


def _hang_signs(plot: Plot, store: Store) -> None:
    """Numbers and names above the aisles, names of sections on the walls."""
    rng, top = plot.rng, store.plan.ceiling
    ground = str(rng.choice(["#b3181e", "#1f4f9c", "#1f6a3c", "#d9701c"]))
    words = {
        "frozen": "FROZEN", "breakfast": "BREAKFAST", "snack": "SNACKS", "pantry": "PANTRY",
        "drinks": "DRINKS", "household": "HOUSEHOLD", "baby and pet": "BABY + PET",
    }  # fmt: skip
    length = store.bays * shelves.BAY
    for k, family in enumerate(store.families):
        right = store.gondolas[k + 1] if k + 1 < len(store.gondolas) else store.width
        x = (store.gondolas[k] + right) / 2
        if k + 1 == len(store.gondolas):
            x -= 0.1
        for y in (FRONT + 1.1, FRONT + 0.8 + length):
            sign = signs.build_sign(f"{k + 1} {words[family]}", 1.5, 0.42, ground, "#f6f3e8",
                                   drop=top - 2.85)  # fmt: skip
            plot.put(sign, x, y, 0.0, z=2.42, solid=False, zone=f"aisle_{k + 1}")
    produce = next(z for z in store.zones if z.id == "produce")
    wall = (
        ("FRUIT + VEGETABLES", 3.4, 0.03, (produce.y0 + produce.y1) / 2, math.pi / 2, "produce"),
        ("BAKERY", 2.0, 3.6, store.depth - 0.03, 0.0, "bakery"),
        ("DAIRY", 2.0, store.width * 0.7, store.depth - 0.03, 0.0, "dairy"),
    )
    for text, wide, x, y, yaw, zone in wall:
        sign = signs.build_sign(text, wide, 0.42, ground, "#f6f3e8")
        plot.put(sign, x, y, yaw, z=2.35, solid=False, zone=zone)
    out = signs.build_sign("EXIT", 0.7, 0.26, "#1f7a3c", "#f2f0e6")
    plot.put(out, 2.9, 0.06, math.pi, z=2.62, solid=False, zone="entrance")


def _light_hall(plot: Plot, store: Store, rng: np.random.Generator) -> None:
    """Strips of light in rows, vents and smoke detectors between them."""
    kelvin = float(rng.choice([3800.0, 4200.0, 4800.0]))
    columns = max(3, round(store.width / 3.2))
    rows = max(3, round(store.depth / 3.0))
    flux = 0.95 * store.width * store.depth / (columns * rows)
    for i in range(columns):
        for j in range(rows):
            x = store.width * (i + 0.5) / columns
            y = store.depth * (j + 0.5) / rows
            lamp = build_panel_lamp(kelvin, flux, 0.28, 1.75)
            plot.put(lamp, x, y, 0.0, z=store.plan.ceiling - 0.001, solid=False)
    for i in range(columns - 1):
        x = store.width * (i + 1.0) / columns
        for j in range(1, rows - 1, 2):
            item = build_vent() if (i + j) % 2 else build_smoke_detector()
            y = store.depth * (j + 1.0) / rows
            plot.put(item, x, y, 0.0, z=store.plan.ceiling - 0.001, solid=False)


def _scatter_things(plot: Plot, store: Store) -> None:
    """Trolleys, displays, a cage of goods being unpacked: what stands about in a shop."""
    rng = plot.rng
    quarter = (0.0, math.pi / 2, math.pi, -math.pi / 2)
    w, d = store.width, store.depth
    front = (MARKET, FRONT - 0.35, w - 0.3, FRONT + 0.6)
    produce = (0.2, FRONT, MARKET, d - 0.3)
    whole = (0.3, FRONT, w - 0.3, d - 1.2)
    dairy = (MARKET, d - BACK, w - 0.3, d - 1.4)
    names = [f for f in FAMILIES if f != "baby and pet"]

    def promotion() -> Item:
        return shelves.build_promotion(rng, str(rng.choice(names)))

    plot.scatter(promotion, 2, dairy, margin=0.62)
    plot.scatter(promotion, 2, produce, margin=0.62, turn=quarter)
    plot.scatter(lambda: checkouts.build_trolley(rng, full=True), 3, whole, margin=0.55,
                 turn=quarter, jitter=0.25)  # fmt: skip
    plot.scatter(lambda: trucks.build_roll_cage(rng), 2, whole, margin=0.55, turn=quarter)
    plot.scatter(loading.build_cone, 1, whole, margin=0.6)
    plot.scatter(lambda: checkouts.build_basket_stack(rng), 1, front, margin=0.6, jitter=0.3)
    plot.scatter(lambda: checkouts.build_trolley(rng), 1, (5.0, 0.3, w - 1, 1.3), margin=0.5,
                 turn=quarter, jitter=0.3)  # fmt: skip
    palette_bin = build_bin(rng, choose_palette("bin", 0, None))
    plot.scatter(lambda: palette_bin, 2, (0.3, 0.3, w - 0.3, 1.2), margin=0.5)


def _furnish_back(plot: Plot, store: Store, palette: Palette, seed: int, attempt: int) -> None:
    """The store room and the office, by the rules of rooms."""
    for id in ("storage_room", "office"):
        room = store.plan.room(id)
        layout = RoomLayout(
            store.plan, room, random_stream(seed, "supermarket", id, attempt), palette
        )
        rng = layout.rng
        if id == "office":
            place_desk(layout, kelvin=4000.0)
            place_corner_things(layout, plants=1)
            shelf = racks.build_storage_shelf(rng, 1.0)
            layout.place_on_wall(shelf, prefer="corner")
            layout.place_on_wall(build_vending_machine(rng), prefer="corner")
            light_ceiling(layout, 4000.0)
        else:
            for _ in range(5):
                shelf = racks.build_storage_shelf(rng, float(rng.choice([1.2, 1.6, 2.0])))
                layout.place_on_wall(shelf, prefer="corner", front=0.5)
            for load in ("cartons", "wrapped", "stack"):
                layout.place_on_wall(pallets.build_pallet(rng, load=load), gap=0.1)
            layout.place_on_wall(trucks.build_roll_cage(rng), gap=0.05)
            layout.place_on_wall(trucks.build_hand_truck(rng), gap=0.05)
            layout.place_on_wall(loading.build_ladder(rng), gap=0.05)
            for k in range(2):
                lamp = build_panel_lamp(4200.0, 9.0, 1.5, 0.28)
                x = room.x0 + room.width * (k + 0.5) / 2
                layout.placed.append(
                    Placed(lamp, x, (room.y0 + room.y1) / 2, store.plan.ceiling - 0.001)
                )
            names = [side for side in layout.sides.values() if side.length > 2]
            layout.hang(names[0], build_extinguisher(), names[0].length / 2, 0.8)
            board = build_notice_board(rng, palette)
            layout.hang(names[1], board, names[1].length / 2, 1.5)
        for placed in layout.placed:
            plot.assembly.add_item(placed, id)


assert set(FAMILIES) <= set(SHELF_GOODS)
