"""Where people may be about: who is there is on the map, and who has gone is not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.maps.explored import DepthFan, ExploredMap, ExploredState, build_fan
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

GREYS = np.array([255, 0, 127], np.uint8)
EYE, WIDTH, HEIGHT, FOCAL = 1.3, 240, 180, 128.0
FLOOR, SHIRT, UNSEEN = (90, 80, 70), (250, 10, 10), 127
WALL = (4.0, 4.2, -9.0, 9.0, 0.0, 2.6)


def make_fan() -> DepthFan:
    return build_fan(
        (WIDTH, HEIGHT), (FOCAL, FOCAL), (WIDTH / 2, HEIGHT / 2),
        pitch=0.0, height=EYE, limits=(0.0, 10.0), band=(0.10, 1.50), cut=2.3,
        colour_size=(WIDTH, HEIGHT), colour_focal=(FOCAL, FOCAL),
        colour_centre=(WIDTH / 2, HEIGHT / 2),
    )  # fmt: skip


FAN = make_fan()


def make_map() -> ExploredMap:
    return ExploredMap(
        OccupancyGrid(np.zeros((160, 200), np.uint8), 0.05, (-1.0, -4.0)), GREYS, UNSEEN, True
    )


def body(x: float, y: float) -> tuple[float, ...]:
    """Somebody's box, as people are: 0.4 m wide, 0.3 m deep, 1.7 m tall, in the middle of x, y."""
    return (x - 0.15, x + 0.15, y - 0.2, y + 0.2, 0.0, 1.7)


Boxes = Sequence[tuple[float, ...]]


def look(boxes: Boxes, x: float, y: float, yaw: float) -> tuple[np.ndarray, np.ndarray]:
    return _look(tuple(boxes), x, y, yaw)


@cache
def _look(boxes: Boxes, x: float, y: float, yaw: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth [H, W] m and colours [H, W, 3] of floor, ceiling, WALL and boxes; boxes are shirts."""
    across = (np.arange(WIDTH) + 0.5 - WIDTH / 2) / FOCAL
    down = (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / FOCAL
    u, v = np.meshgrid(across, down)
    c, s = math.cos(yaw), math.sin(yaw)
    way = np.stack([c + s * u, s - c * u, -v])
    best = np.full((HEIGHT, WIDTH), np.inf)
    rgb = np.full((HEIGHT, WIDTH, 3), FLOOR, np.uint8)
    with np.errstate(divide="ignore", invalid="ignore"):
        for height in (0.0, 2.6):
            t = (height - EYE) / way[2]
            best = np.where((t > 0) & (t < best), t, best)
        for number, (x0, x1, y0, y1, z0, z1) in enumerate((WALL, *boxes)):
            low = np.array([x0 - x, y0 - y, z0 - EYE])[:, None, None] / way
            high = np.array([x1 - x, y1 - y, z1 - EYE])[:, None, None] / way
            enter, leave = np.minimum(low, high).max(axis=0), np.maximum(low, high).min(axis=0)
            nearer = (enter > 0) & (enter <= leave) & (enter < best)
            best = np.where(nearer, enter, best)
            if number:
                rgb[nearer] = SHIRT
    return np.clip(best, 0.0, 10.0).astype(np.float32), rgb


class Watch:
    """An agent that looks again and again, `seconds` apart, standing, turning or walking."""

    def __init__(self, seconds: float, gait: str = "stand") -> None:
        self.map, self.seconds, self.gait, self.count = make_map(), seconds, gait, 0

    def see(self, boxes, duration: float) -> ExploredMap:
        for _ in range(max(1, round(duration / self.seconds))):
            k, self.count = self.count, self.count + 1
            swing = abs((k + 4) % 8 - 4) - 2  # 2 … −2 … 2
            x = y = yaw = 0.0
            if self.gait == "turn":
                yaw = 0.12 * swing
            elif self.gait == "walk":
                x, y = 0.1 * swing, 0.15 * ((k % 5) - 2)
            depth, rgb = look(boxes, x, y, yaw)
            self.map.add_standing(x, y, 0.2)
            self.map.add_picture(FAN, depth, rgb, x, y, yaw, k * self.seconds)
        return self.map


def area(grid: OccupancyGrid, x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    (r0, c0), (r1, c1) = grid.cell_of(x0, y0), grid.cell_of(x1, y1)
    return grid.cells[r0 : r1 + 1, c0 : c1 + 1]


def face(grid: OccupancyGrid, x: float) -> np.ndarray:
    """Cells of the side of `body(x, 0)` that faces the agent, but for its edges."""
    return area(grid, x - 0.14, x - 0.14, -0.14, 0.14)


WAYS = pytest.mark.parametrize(
    ("gait", "seconds"),
    [("stand", 0.2), ("stand", 0.5), ("stand", 1.0), ("turn", 0.2), ("walk", 0.2), ("walk", 0.5)],
)


@WAYS
@pytest.mark.parametrize("before", [0.0, 6.0])
def test_who_stands_in_view_for_a_second_is_occupied(gait, seconds, before) -> None:
    """At first sight, or on floor that was seen bare for six seconds."""
    watch = Watch(seconds, gait)
    if before:
        assert (area(watch.see([], before).grid, 1.9, 2.8, -0.3, 0.3) == FREE).all()
    grid = watch.see([body(2.5, 0.0)], 1.0).grid
    assert (face(grid, 2.5) == OCCUPIED).all()
    assert (area(grid, 2.4, 2.6, -0.1, 0.1) != FREE).mean() > 0.9, "nobody is hollow"


@WAYS
@pytest.mark.parametrize(("place", "before"), [(1.2, 0.0), (1.2, 4.0), (2.5, 0.0), (2.5, 4.0)])
def test_five_seconds_after_leaving_nobody_is_left(gait, seconds, place, before) -> None:
    """Also where the picture does not reach down to the floor (1.2 m), and after a long stand."""
    watch = Watch(seconds, gait)
    if before:
        watch.see([], before)
    grid = watch.see([body(place, 0.0)], 4.0).grid
    assert (face(grid, place) == OCCUPIED).any()
    grid = watch.see([], 5.0).grid
    assert (area(grid, place - 0.15, place + 0.15, -0.2, 0.2) == FREE).mean() >= 0.95


@pytest.mark.parametrize("seconds", [0.2, 0.5, 1.0])
def test_who_walks_by_leaves_no_trail(seconds) -> None:
    watch = Watch(seconds)
    watch.see([], 4.0)
    for k in range(round(3.0 / seconds) + 1):
        watch.see([body(2.5, -1.5 + k * seconds)], seconds)
        row, col = watch.map.grid.cell_of(2.38, -1.5 + k * seconds)
        assert watch.map.grid.cells[row, col] == OCCUPIED
    grid = watch.see([], 5.0).grid
    assert (area(grid, 2.2, 2.8, -1.5, 1.5) == FREE).all()


def test_what_stays_is_still_there_when_somebody_has_gone() -> None:
    """A low chest below the picture, and the wall behind."""
    chest = (1.25, 1.5, 0.5, 0.9, 0.0, 0.35)
    watch = Watch(0.5)
    depth, rgb = look([chest], -0.8, 0.0, 0.0)
    watch.map.add_picture(FAN, depth, rgb, -0.8, 0.0, 0.0, 0.0)
    watch.count = 1
    seen = area(watch.map.grid, 1.25, 1.5, 0.5, 0.9).copy()
    assert (seen == OCCUPIED).any()
    watch.see([chest, body(2.5, 0.0)], 4.0)
    grid = watch.see([chest], 8.0).grid
    after = area(grid, 1.25, 1.5, 0.5, 0.9)
    assert (after[seen == OCCUPIED] == OCCUPIED).all()
    assert (area(grid, 4.01, 4.01, -2.0, 2.0) == OCCUPIED).mean() > 0.95


def test_what_is_low_and_turns_up_late_is_nobody() -> None:
    """Floor that is taken for a thing once in a while must not grow a back."""
    watch = Watch(0.2)
    watch.see([], 4.0)
    grid = watch.see([(2.4, 2.6, -0.2, 0.2, 0.0, 0.25)], 0.4).grid
    assert (area(grid, 2.7, 3.0, -0.2, 0.2) != OCCUPIED).all()


def test_colours_go_with_who_wore_them() -> None:
    watch = Watch(0.5)
    watch.see([], 2.0)
    watch.see([body(2.5, 0.0)], 2.0)
    row, col = watch.map.grid.cell_of(2.38, 0.0)
    assert tuple(watch.map.bev[::-1][row, col]) == SHIRT
    watch.see([], 5.0)
    assert tuple(watch.map.bev[::-1][row, col]) == FLOOR


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_restore_is_bit_for_bit_with_people_about(seed) -> None:
    draw = np.random.default_rng(seed)
    moments = [
        (draw.uniform(-0.5, 0.5), draw.uniform(-1, 1), draw.uniform(-0.6, 0.6)) for _ in range(6)
    ]
    boxes = [[body(draw.uniform(1, 3), draw.uniform(-1, 1))] for _ in moments]

    def add(explored: ExploredMap, first: int, last: int) -> None:
        for k in range(first, last):
            x, y, yaw = moments[k]
            explored.add_picture(FAN, *look(boxes[k], x, y, yaw), x, y, yaw, 0.2 * k)

    whole, cut = make_map(), make_map()
    add(whole, 0, 6)
    add(cut, 0, 3)
    kept = cut.save()
    add(cut, 3, 5)
    cut.restore(kept)
    add(cut, 3, 6)
    one, other = whole.save(), cut.save()
    for field in fields(ExploredState):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert (a.tobytes() == b.tobytes()) if isinstance(a, np.ndarray) else a == b, field.name


def test_a_state_from_before_there_were_people_goes_on_either_way() -> None:
    """Its makers knew nothing of times and heights: those fields are left out."""
    explored = make_map()
    explored.add_picture(FAN, *look([], 0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    saved = explored.save()
    known = {f.name: getattr(saved, f.name) for f in fields(saved)}
    old = ExploredState(**{k: v for k, v in known.items() if k not in ("time", "rises", "came")})
    one, other = make_map(), make_map()
    one.restore(saved)
    other.restore(old)
    for each in (one, other):
        each.add_picture(FAN, *look([], 0.2, 0.0, 0.1), 0.2, 0.0, 0.1)
    assert one.save().belief.tobytes() == other.save().belief.tobytes()
    for k in range(5):
        other.add_picture(FAN, *look([body(2.5, 0.0)], 0.2, 0.0, 0.1), 0.2, 0.0, 0.1, 0.5 * k)
    assert (face(other.grid, 2.5) == OCCUPIED).all()


def test_the_same_moment_counts_once() -> None:
    explored = make_map()
    for _ in range(2):
        explored.add_picture(FAN, *look([body(2.5, 0.0)], 0, 0, 0.0), 0.0, 0.0, 0.0, 1.0)
        kept = explored.save()
    once = make_map()
    once.add_picture(FAN, *look([body(2.5, 0.0)], 0, 0, 0.0), 0.0, 0.0, 0.0, 1.0)
    assert kept.belief.tobytes() == once.save().belief.tobytes()
    assert (once.grid.cells == UNKNOWN).any()
