"""Groups that stand together: sofa and television, table and chairs, bed and nightstands, desk."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue import bath, kitchen, light
from gn0.scenes.procedural.catalogue.clutter import crockery, electronics
from gn0.scenes.procedural.catalogue.decor import greenery, pictures, windows
from gn0.scenes.procedural.catalogue.seats import chairs, sofas
from gn0.scenes.procedural.catalogue.storage import beds, books, cupboards
from gn0.scenes.procedural.catalogue.tables import high_tables, low_tables, rugs
from gn0.scenes.procedural.layout import Block, RoomLayout, draw_between, dress, footprint
from gn0.scenes.procedural.shell import SIDES, Side


def stand_at(side: Side, t: float, off: float, item: Item, yaw: float = 0.0) -> Placed:
    """An item at `t` along and `off` from a wall, its back to that wall, turned by `yaw`."""
    x, y = side.point(t, off)
    return Placed(item, x, y, 0.0, side.yaw + yaw)


def dress_windows(layout: RoomLayout, *, curtains: bool = True) -> None:
    """Curtains or blinds and a radiator at every window."""
    rng = layout.rng
    for side in layout.sides.values():
        for a, b, bottom, top, _ in side.openings:
            if bottom <= 0:
                continue
            middle, width = (a + b) / 2, b - a
            if curtains and middle - width / 2 > 0.27 and side.length - middle - width / 2 > 0.27:
                item = windows.build_curtains(rng, layout.palette, width, top)
                placed = stand_at(side, middle, 0.005, item)
                layout.placed.append(placed)
                layout.hung[side.name].append((a - 0.3, 0.0, b + 0.3, top + 0.25))
                for sx in (-1, 1):
                    edge = middle + sx * (width / 2 + 0.02)
                    rect = layout.strip(side, edge - 0.24, edge + 0.24, 0.15)
                    layout.blocks.append(Block(rect, top + 0.2))
            elif rng.random() < 0.7 and layout.room.type != "kitchen":
                blind = windows.build_blind(rng, layout.palette, width + 0.06, top - bottom)
                layout.placed.append(
                    Placed(blind, *side.point(middle, 0.005), top + 0.06, side.yaw)
                )
                layout.hung[side.name].append((a - 0.1, bottom, b + 0.1, top + 0.1))
            if bottom > 0.75 and layout.room.type in ("living room", "bedroom", "study"):
                wide = min(width - 0.55, 1.2)
                if wide > 0.45:
                    layout.add(stand_at(side, middle, 0.0, windows.build_radiator(rng, wide)))


def hang_pictures(layout: RoomLayout, count: int, *, clock: bool = False) -> None:
    """Pictures, a shelf or a clock on the longest bare stretches of wall at eye height."""
    rng = layout.rng
    gaps = []
    for side in layout.sides.values():
        gaps += [(b - a, side.name, a, b) for a, b in layout.wall_gaps(side, 1.15, 1.9)]
    gaps.sort(key=lambda g: -g[0])
    for k, (span, name, a, b) in enumerate(gaps[:count]):
        side, middle = layout.sides[name], (a + b) / 2
        if clock and k == len(gaps[:count]) - 1:
            layout.hang(side, pictures.build_clock(rng, layout.palette), middle, 1.75)
        elif span > 1.1 and rng.random() < 0.3:
            item = cupboards.build_wall_shelf(
                rng, layout.palette, float(rng.uniform(0.7, min(1.2, span - 0.2)))
            )
            item = dress(item, "shelf", rng, layout.palette, count=5)
            layout.hang(side, item, middle, float(rng.uniform(1.64, 1.74)))
        elif span > 0.45:
            group = pictures.build_wall_group(rng, layout.palette, span)
            layout.hang_group(side, group, middle, 1.52)
            if span > 3.2:
                extra = pictures.build_wall_group(rng, layout.palette, 0.9)
                layout.hang_group(side, extra, a + span * 0.15, 1.52)


def light_ceiling(layout: RoomLayout, kelvin: float, *, flux: float | None = None) -> None:
    """A ceiling lamp over the middle of the room; two in a long one."""
    r = layout.room
    ratio = max(r.width, r.depth) / min(r.width, r.depth)
    count = 2 if ratio > 2.2 and max(r.width, r.depth) > 4 else 1
    item_flux = light.CEILING_FLUX if flux is None else flux
    item_flux *= min(1.3, max(0.5, r.area / 14)) / count
    item = light.build_ceiling_lamp(layout.rng, layout.palette, kelvin=kelvin, flux=item_flux)
    for k in range(count):
        t = (k + 0.5) / count
        x = r.x0 + r.width * (t if r.width >= r.depth else 0.5)
        y = r.y0 + r.depth * (t if r.width < r.depth else 0.5)
        layout.placed.append(Placed(item, x, y, layout.plan.ceiling - 0.001))


def place_corner_things(
    layout: RoomLayout,
    *,
    plants: int,
    lamp: float | None = None,
    basket: bool = True,
    widest: float = 1.0,
) -> None:
    """Plants, a floor lamp and a basket in the corners that are left."""
    rng, palette = layout.rng, layout.palette
    if lamp is not None:
        item = light.build_floor_lamp(rng, palette, kelvin=lamp)
        layout.place_on_wall(item, prefer="corner", gap=0.05, reach=False)
    for _ in range(plants):
        item = greenery.build_plant(rng, palette, float(rng.uniform(0.7, 1.7)))
        low, high = item.full_extent()
        if high[0] - low[0] > widest:
            continue
        layout.place_on_wall(item, prefer="corner", gap=0.03, reach=False)
    if basket:
        layout.place_on_wall(
            cupboards.build_basket(rng, palette), prefer="corner", gap=0.03, reach=False
        )


def place_dining(layout: RoomLayout, count: int, *, kelvin: float) -> bool:
    """A dining table with chairs, laid or decorated, under a pendant."""
    rng, palette, r = layout.rng, layout.palette, layout.room
    table = high_tables.build_dining_table(rng, palette, count)
    setting: list[Item] = []
    table = dress(table, "dining table", rng, palette, count=2, first=setting)
    chair_seed, kind = int(rng.integers(2**31)), int(rng.integers(4))
    w, d, _ = table.size
    round_table = abs(w - d) < 0.05
    spots: list[tuple[float, float, float]] = []
    if round_table or count <= 2:
        n = count if round_table else 2
        for k in range(n):
            a = 2 * math.pi * k / n
            reach = (w / 2 if round_table else d / 2) + 0.12
            spots.append((reach * math.sin(a), -reach * math.cos(a), a + math.pi))
    else:
        per_side = 2 if count <= 4 else (3 if w > 1.9 and count >= 8 else 2)
        for k in range(per_side):
            x = (k - (per_side - 1) / 2) * (w / per_side) * 0.92
            spots += [(x, -d / 2 - 0.1, math.pi), (x, d / 2 + 0.1, 0.0)]
        if count >= 6:
            spots += [(-w / 2 - 0.12, 0, math.pi / 2), (w / 2 + 0.12, 0, -math.pi / 2)]
    # the chairs of a table are alike: one is built, and stands in every place that is tried
    chair = chairs.build_chair(np.random.Generator(np.random.Philox(key=chair_seed)), palette, kind)
    for _ in range(60):
        turned = bool(rng.random() < 0.5)
        yaw = math.pi / 2 if turned else 0.0
        x = float(rng.uniform(r.x0 + 0.8, max(r.x0 + 0.81, r.x1 - 0.8)))
        y = float(rng.uniform(r.y0 + 0.8, max(r.y0 + 0.81, r.y1 - 0.8)))
        c, s = math.cos(yaw), math.sin(yaw)
        group: list[tuple[Placed, bool]] = [(Placed(table, x, y, 0.0, yaw), True)]
        chair_rng = np.random.Generator(np.random.Philox(key=chair_seed))
        for dx, dy, turn in spots:
            jitter = float(chair_rng.uniform(-0.12, 0.12))
            off = float(chair_rng.uniform(-0.02, 0.06))
            length = math.hypot(dx, dy)
            px, py = dx * (1 + off / length), dy * (1 + off / length)
            group.append(
                (
                    Placed(
                        chair, x + c * px - s * py, y + s * px + c * py, 0.0, yaw + turn + jitter
                    ),
                    True,
                )
            )
        rects = [footprint(p) for p, _ in group]
        clear = (
            min(q[0] for q in rects) - 0.12,
            min(q[1] for q in rects) - 0.12,
            max(q[2] for q in rects) + 0.12,
            max(q[3] for q in rects) + 0.12,
        )
        clear = (max(clear[0], r.x0), max(clear[1], r.y0), min(clear[2], r.x1), min(clear[3], r.y1))
        if layout.place_free(group, clear):
            if rng.random() < 0.5:
                w_rug = clear[2] - clear[0] - 0.1
                d_rug = clear[3] - clear[1] - 0.1
                rug = rugs.build_rug(rng, palette, max(w_rug, d_rug), min(w_rug, d_rug))
                spin = 0.0 if w_rug >= d_rug else math.pi / 2
                placed = Placed(
                    rug, (clear[0] + clear[2]) / 2, (clear[1] + clear[3]) / 2, 0.0, spin
                )
                q = footprint(placed)
                if r.x0 < q[0] and r.y0 < q[1] and q[2] < r.x1 and q[3] < r.y1:
                    layout.placed.append(placed)
            drop = layout.plan.ceiling - 1.55
            lamp = light.build_pendant(rng, palette, drop, kelvin=kelvin)
            layout.placed.append(Placed(lamp, x, y, layout.plan.ceiling - 0.001))
            return True
    return False


def place_sofa_group(layout: RoomLayout) -> Side | None:
    """Television against one wall; sofa, rug, coffee table and armchair before it."""
    rng, palette = layout.rng, layout.palette
    corner = layout.room.area > 24 and rng.random() < 0.35
    sofa = sofas.build_corner_sofa(rng, palette) if corner else sofas.build_sofa(rng, palette)
    stand = low_tables.build_tv_stand(rng, palette)
    stand = dress(stand, "sideboard", rng, palette, count=4)
    tv = low_tables.build_tv(rng)
    stand = stand.with_parts([Placed(tv, 0.0, 0.02, stand.extent()[1][2])])
    coffee = dress(
        low_tables.build_coffee_table(rng, palette), "coffee table", rng, palette, count=5
    )
    s_low, s_high = sofa.full_extent()
    sofa_w, sofa_d = float(s_high[0] - s_low[0]), float(s_high[1] - s_low[1])
    t_low, t_high = stand.full_extent()
    stand_d = float(t_high[1] - t_low[1])
    c_low, c_high = coffee.full_extent()
    coffee_d = float(c_high[1] - c_low[1])
    for attempt in range(90):
        name = str(rng.choice(SIDES))
        side = layout.sides[name]
        across = layout.room.depth if name in ("south", "north") else layout.room.width
        if across < 3.0:
            continue
        free = layout.intervals(side, stand_d + 0.02, float(t_high[2]))
        free = [g for g in free if g[1] - g[0] > float(t_high[0] - t_low[0]) + 0.1]
        if not free:
            continue
        a, b = free[int(rng.integers(len(free)))]
        half = float(t_high[0] - t_low[0]) / 2 + 0.05
        t = draw_between(rng, a + half, b - half)
        # distance of the sofa's back from the television wall
        back = across - 0.03
        if across > 4.3 or attempt > 45:
            back = float(
                rng.uniform(max(3.1, stand_d + 1.5 + sofa_d), max(3.5, stand_d + 1.9 + sofa_d))
            )
        if back > across - 0.6:
            back = across - 0.03
        front_gap = back - sofa_d - stand_d
        if not 1.45 < front_gap < 3.4:
            continue
        tv_placed = layout.against_wall(side, stand, t)
        chaise = sofa_d - 0.95 if corner else 0.0
        sofa_x, sofa_y = side.point(t, back - float(s_high[1]))
        sofa_placed = Placed(sofa, sofa_x, sofa_y, 0.0, side.yaw + math.pi)
        # the table stands before the seat, not before the chaise
        off = 0.0
        if chaise > 0:
            low_x = sofa.shapes[-1].vertices[:, 0].mean()
            off = math.copysign(0.36, low_x)
        table_y = back - (sofa_d - max(chaise, 0)) - 0.34 - coffee_d / 2
        table_placed = stand_at(side, t - off, table_y, coffee)
        group: list[tuple[Placed, bool]] = [
            (tv_placed, True),
            (sofa_placed, True),
            (table_placed, True),
        ]
        rects = [footprint(p) for p, _ in group]
        if not all(layout.is_clear(q) for q in rects):
            continue
        view = layout.strip(side, t - 0.5, t + 0.5, back - sofa_d, stand_d + 0.05)
        if not layout.is_clear(view, ignore_keep=True):
            continue
        if not layout.is_passable(rects, [side.point(t, stand_d + 0.45)]):
            continue
        for placed, solid in group:
            layout.add(placed, solid=solid)
        rug_w = min(sofa_w + 0.3, 2.9)
        rug_d = min(max(1.5, front_gap * 0.75), 2.0)
        rug = rugs.build_rug(rng, palette, rug_w, rug_d)
        rug_at = stand_at(side, t, max(table_y - 0.05, stand_d + 0.15 + rug_d / 2), rug)
        q = footprint(rug_at)
        r = layout.room
        if q[0] > r.x0 and q[1] > r.y0 and q[2] < r.x1 and q[3] < r.y1:
            layout.placed.append(rug_at)
        _place_beside_sofa(layout, side, t, back, sofa_w, sofa_d, table_y)
        return side
    # no room to face a television: a sofa alone
    layout.place_on_wall(sofa, prefer="any", reach=True)
    layout.place_on_wall(stand, prefer="any")
    return None


def _place_beside_sofa(
    layout: RoomLayout,
    side: Side,
    t: float,
    back: float,
    sofa_w: float,
    sofa_d: float,
    table_y: float,
) -> None:
    """Armchair at one flank, floor lamp and side table at the ends of the sofa."""
    rng, palette = layout.rng, layout.palette
    ends = [1.0, -1.0] if rng.random() < 0.5 else [-1.0, 1.0]
    for k, sign in enumerate(ends):
        if k == 0:
            item = light.build_floor_lamp(rng, palette, kelvin=2700.0)
        else:
            lamp = light.build_table_lamp(rng, palette, kelvin=2900.0)
            item = dress(
                low_tables.build_side_table(rng, palette),
                "nightstand",
                rng,
                palette,
                count=1,
                first=[lamp],
            )
        low, high = item.full_extent()
        reach = float(high[0] - low[0]) / 2
        placed = stand_at(side, t + sign * (sofa_w / 2 + reach + 0.06), back - 0.32, item, math.pi)
        if layout.is_clear(footprint(placed)) and layout.is_passable([footprint(placed)]):
            layout.add(placed)
    for sign in ends:
        chair = sofas.build_sofa(rng, palette, seats=1)
        low, high = chair.full_extent()
        off = sofa_w / 2 + float(high[1] - low[1]) / 2 - 0.1
        placed = stand_at(
            side, t + sign * off, table_y - 0.1, chair, -sign * (math.pi / 2 - 0.35) + math.pi
        )
        rect = footprint(placed)
        if layout.is_clear(rect, margin=0.03) and layout.is_passable([rect]):
            layout.add(placed)
            return


def hang_above_counter(
    layout: RoomLayout, side: Side, t: float, width: float, front: object, counter: Item
) -> None:
    """Hood over the hob, wall units elsewhere, a towel on the oven."""
    rng, palette = layout.rng, layout.palette
    stove = next((p for p in counter.parts if p.item.category == "stove"), None)
    z = 1.45
    if stove is not None:
        layout.hang(side, kitchen.build_hood(), t - stove.x, 1.62)
    material = counter.shapes[0].material if front is None else front
    spans = layout.wall_gaps(side, z, z + 0.7)
    for a, b in spans:
        low, high = max(a + 0.01, t - width / 2), min(b - 0.01, t + width / 2)
        if high - low > 0.4:
            unit = kitchen.build_wall_units(rng, palette, high - low - 0.02, material)  # type: ignore[arg-type]
            layout.hang(side, unit, (low + high) / 2, z)


def place_bed(layout: RoomLayout, double: bool, kelvin: float) -> Placed | None:
    """A bed, its head to a wall, nightstands with lamps at its sides, a rug under its foot."""
    rng, palette = layout.rng, layout.palette
    bed = beds.build_bed(rng, palette, double)
    low, high = bed.full_extent()
    width, depth = float(high[0] - low[0]), float(high[1] - low[1])
    options: list[tuple[int, Side, float]] = []  # best first: room for two nightstands, one, none
    for name in rng.permutation(list(SIDES)):
        side = layout.sides[str(name)]
        for a, b in layout.intervals(side, 0.5, 1.0):
            for rank, beside in enumerate((0.5, 0.27, 0.02)):
                low_t, high_t = a + width / 2 + beside, b - width / 2 - beside
                if rank == 1:  # a nightstand on one side only
                    low_t, high_t = a + width / 2 + 0.03, b - width / 2 - 0.03
                if high_t < low_t or (rank == 1 and b - a < width + 0.55):
                    continue
                spots_t = [low_t, high_t]
                if rank == 0:
                    spots_t = [(a + b) / 2, float(rng.uniform(low_t, high_t)), low_t, high_t]
                if double or rank:
                    options += [(rank, side, t) for t in spots_t]
    options.sort(key=lambda o: o[0])
    for _, side, t in options:
        placed = layout.against_wall(side, bed, t, 0.02)
        rect = footprint(placed)
        spots = [side.point(t, depth + 0.38)] if double else []
        if not layout.is_clear(rect) or not layout.is_passable([rect], spots):
            continue
        layout.add(placed)
        stand_seed = int(rng.integers(2**31))
        for sign in (-1, 1):
            stand_rng = np.random.Generator(np.random.Philox(key=stand_seed))
            stand = low_tables.build_nightstand(stand_rng, palette)
            lamp = light.build_table_lamp(stand_rng, palette, kelvin=kelvin)
            stand = dress(stand, "nightstand", rng, palette, count=2, first=[lamp])
            s_low, s_high = stand.full_extent()
            at = layout.against_wall(
                side, stand, t + sign * (width / 2 + 0.05 + float(s_high[0] - s_low[0]) / 2), 0.03
            )
            q = footprint(at)
            if layout.is_clear(q) and layout.is_passable([q]):
                layout.add(at)
        if rng.random() < 0.75:
            rug = rugs.build_rug(rng, palette, width + 0.9, 1.5)
            rug_at = stand_at(side, t, depth - 0.35, rug)
            q = footprint(rug_at)
            r = layout.room
            if q[0] > r.x0 and q[1] > r.y0 and q[2] < r.x1 and q[3] < r.y1:
                layout.placed.append(rug_at)
        if double and rng.random() < 0.35:
            bench = chairs.build_bench(rng, palette, min(width - 0.2, 1.3))
            bench_at = stand_at(side, t, depth + 0.28, bench)
            q = footprint(bench_at)
            if layout.is_clear(q) and layout.is_passable([q]):
                layout.add(bench_at)
        group = pictures.build_wall_group(rng, palette, width * 0.9)
        layout.hang_group(side, group, t, 1.6)
        return placed
    return None


def hang_over(layout: RoomLayout, spot: Placed, item: Item, z: float) -> bool:
    """Hang an item above a piece of furniture that stands at a wall."""
    for side in layout.sides.values():
        if abs(side.yaw - spot.yaw) < 1e-6:
            t = (spot.x - side.start[0]) * side.along[0] + (spot.y - side.start[1]) * side.along[1]
            return layout.hang(side, item, t, z) is not None
    return False


def place_desk(layout: RoomLayout, *, kelvin: float, large: bool = False) -> bool:
    """A desk with monitor or laptop, keyboard, lamp and a chair drawn up to it."""
    rng, palette = layout.rng, layout.palette
    desk = high_tables.build_desk(rng, palette)
    top = desk.supports[0]
    parts: list[Placed] = []
    if rng.random() < 0.65 or large:
        shift = float(rng.uniform(-0.1, 0.1))
        parts.append(Placed(electronics.build_monitor(rng), shift, top.y1 - 0.1, top.z))
        parts.append(Placed(electronics.build_keyboard(rng), shift, -0.1, top.z))
        parts.append(Placed(electronics.build_mouse(rng), shift + 0.3, -0.1, top.z))
        taken = 0.36
    else:
        parts.append(
            Placed(
                electronics.build_laptop(rng, palette),
                0.0,
                -0.05,
                top.z,
                float(rng.uniform(-0.15, 0.15)),
            )
        )
        taken = 0.26
    side_x = float(rng.choice([-1, 1])) * (top.x1 - 0.1)
    if abs(side_x) - 0.12 > taken:
        lamp = light.build_desk_lamp(rng, palette, kelvin=kelvin)
        parts.append(Placed(lamp, side_x, top.y1 - 0.14, top.z, -math.copysign(0.5, side_x)))
        other = (
            crockery.build_cup(rng, palette)
            if rng.random() < 0.5
            else books.build_book_stack(rng, 3)
        )
        parts.append(Placed(other, -side_x, top.y1 - 0.15, top.z, float(rng.uniform(-0.4, 0.4))))
    desk = desk.with_parts(parts)
    chair = (
        chairs.build_office_chair(rng, palette)
        if rng.random() < 0.7 or large
        else chairs.build_chair(rng, palette)
    )
    spot = layout.place_on_wall(desk, prefer="any", front=0.55, gap=0.03)
    if spot is None:
        return False
    c, s = math.cos(spot.yaw), math.sin(spot.yaw)
    low = desk.extent()[0]
    for back in (0.1, -0.02, 0.2):
        dx, dy = float(rng.uniform(-0.08, 0.08)), float(low[1]) - 0.2 + back - 0.1
        turn = math.pi + float(rng.uniform(-0.5, 0.5))
        at = Placed(chair, spot.x + c * dx - s * dy, spot.y + s * dx + c * dy, 0.0, spot.yaw + turn)
        q = footprint(at)
        mine = layout.blocks.pop() if layout.blocks[-1].rect == footprint(spot) else None
        clear = layout.is_clear(q)
        if mine is not None:
            layout.blocks.append(mine)
        spots = layout.reach
        layout.reach = [
            p
            for p in spots
            if not (q[0] - 0.3 < p[0] < q[2] + 0.3 and q[1] - 0.3 < p[1] < q[3] + 0.3)
        ]
        if clear and layout.is_passable([q]):
            layout.add(at)
            break
        layout.reach = spots
    if rng.random() < 0.6:
        shelf = dress(cupboards.build_wall_shelf(rng, palette, 0.9), "shelf", rng, palette, count=5)
        hang_over(layout, spot, shelf, 1.65)
    return True


def place_shower(layout: RoomLayout) -> bool:
    """A shower in a corner, its walls at local +y and +x."""
    shower = bath.build_shower(layout.rng, layout.palette)
    w = shower.size[0]
    for name in layout.rng.permutation(list(SIDES)):
        side = layout.sides[str(name)]
        # local +x is −along: the corner at the start of the side
        at = layout.against_wall(side, shower, w / 2 + 0.005, 0.005)
        q = footprint(at)
        strip_ok = any(a <= 0.02 and b >= w for a, b in layout.intervals(side, w, 1.2))
        if strip_ok and layout.is_clear(q) and layout.is_passable([q]):
            layout.add(at)
            return True
    return False
