"""Goals of several places: the nearest counts, and of an area its inside."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gn0.errors import EpisodeError, PlanError
from gn0.maps.goal_places import GoalSet, GoalSetInner
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.pose_astar import plan_actions

TURN = math.radians(15)


def two_rooms() -> NavigationMap:
    """Two rooms of 3 × 4 m, a door of 0.8 m between them at y = 1.6 … 2.4."""
    cells = np.zeros((80, 124), np.uint8)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 1, 1, 1, 1
    cells[:, 60:64] = 1
    cells[32:48, 60:64] = 0
    cells[50:56, 20:40] = 1
    return NavigationMap(OccupancyGrid(cells, 0.05, (-1.0, 0.5)), 0.15)


RIGHT_ROOM = ((2.1, 0.5), (5.2, 0.5), (5.2, 4.5), (2.1, 4.5))


def walk(plan: np.ndarray, x: float, y: float) -> tuple[float, float]:
    heading = 0
    for action in plan.tolist():
        if action == 1:
            x, y = x + 0.25 * math.cos(heading * TURN), y + 0.25 * math.sin(heading * TURN)
        else:
            heading += 1 if action == 2 else -1
    return x, y


def test_distance_to_a_set_is_the_least_over_it() -> None:
    nav = two_rooms()
    points = ((-0.6, 1.0), (4.6, 4.0), (0.3, 4.1))
    found = nav.geodesic(GoalSet(points=points)).cells
    each = [nav.geodesic(point).cells for point in points]
    assert np.allclose(found, np.minimum.reduce(each), atol=1e-9)


def test_distance_to_an_area_is_that_to_its_nearest_cell_and_nothing_inside() -> None:
    nav = two_rooms()
    field = nav.geodesic(GoalSet(areas=(RIGHT_ROOM,)))
    assert field.inside is not None
    assert np.array_equal(field.cells == 0.0, field.inside)
    rows, cols = np.nonzero(~nav.blocked & ~field.inside)
    for k in np.linspace(0, len(rows) - 1, 6).astype(int):
        here = nav.inflated.centre_of(int(rows[k]), int(cols[k]))
        least = nav.geodesic(here).cells[field.inside].min()
        assert field.distance_at(*here) == pytest.approx(least, abs=1e-9)


def test_a_way_to_a_set_ends_at_its_nearest_place_and_an_area_where_one_enters_it() -> None:
    nav = two_rooms()
    near, far = (0.3, 4.0), (4.6, 1.0)
    assert nav.geodesic(GoalSet(points=(far, near))).path(-0.5, 4.0)[-1] == pytest.approx(near)
    field = nav.geodesic(GoalSet(areas=(RIGHT_ROOM,)))
    end = field.path(-0.5, 4.0)[-1]
    assert field.is_inside(*end)
    assert 2.1 <= end[0] < 2.2
    assert len(field.path(4.0, 4.0)) == 1, "who is inside has nowhere to go"


@pytest.mark.parametrize("depth", [0.2, 0.5, 1.0])
def test_an_inner_area_is_what_lies_so_far_behind_the_door(depth: float) -> None:
    """Not so far from walls: whoever stands beside one need not come nearer to the middle."""
    nav = two_rooms()
    whole = nav.geodesic(GoalSet(areas=(RIGHT_ROOM,)))
    inner = nav.geodesic(GoalSetInner(areas=(RIGHT_ROOM,), depth=depth))
    assert whole.inside is not None and inner.inside is not None
    assert not (inner.inside & ~whole.inside).any()
    rows, cols = np.nonzero(whole.inside)
    outside = np.argwhere(~nav.blocked & ~whole.inside)
    away = np.array([np.hypot(*(outside - at).T).min() for at in zip(rows, cols, strict=True)])
    assert np.array_equal(inner.inside[rows, cols], away * 0.05 >= depth)
    assert inner.inside[nav.inflated.cell_of(4.9, 0.75)], "beside the wall"
    x, y = inner.path(-0.5, 2.5)[-1]
    assert 2.1 + depth - 0.11 <= x <= 2.1 + depth + 0.06 and y == pytest.approx(2.5, abs=0.26)
    assert inner.distance_at(-0.5, 2.5) == pytest.approx(
        whole.distance_at(-0.5, 2.5) + depth, abs=0.11
    )


def test_an_inner_area_is_as_deep_as_one_can_go_and_never_out_of_reach() -> None:
    nav = two_rooms()
    cells = nav.grid.cells.copy()
    cells[:, 90:94] = 1  # only the first 1.3 m of the room are left, and a pocket behind a wall
    shut = NavigationMap(OccupancyGrid(cells, 0.05, (-1.0, 0.5)), 0.15)
    found = shut.geodesic(GoalSetInner(areas=(RIGHT_ROOM,), depth=2.0))
    assert found.inside is not None and found.inside.any()
    nearest = shut.geodesic((1.9, 2.5)).cells[found.inside].min()
    assert 0.9 <= nearest <= 1.3, "a quarter of 4 m is there"
    slit = ((-0.9, 0.6), (-0.76, 0.6), (-0.76, 0.9), (-0.9, 0.9))
    same = [nav.geodesic(goal).inside for goal in
            (GoalSet(areas=(slit,)), GoalSetInner(areas=(slit,), depth=0.5))]  # fmt: skip
    assert same[0] is not None and same[0].any()
    assert same[1] is not None and same[1].any() and not (same[1] & ~same[0]).any()
    everywhere = ((-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0))
    found = nav.geodesic(GoalSetInner(areas=(everywhere,), depth=0.5))
    assert np.array_equal(found.inside, ~nav.blocked)
    assert nav.regions_of(GoalSetInner(areas=(RIGHT_ROOM,), depth=0.5)) == {0}
    cells[32:48, 110:] = 0  # the pocket opens to the other side, beyond which ground is outside
    apart = NavigationMap(OccupancyGrid(np.pad(cells, ((0, 0), (0, 30))), 0.05, (-1.0, 0.5)), 0.15)
    nook = ((2.1, 2.0), (2.6, 2.0), (2.6, 3.0), (2.1, 3.0))  # half a metre of the room by the door
    behind = ((3.7, 0.5), (5.1, 0.5), (5.1, 4.5), (3.7, 4.5))
    both = GoalSetInner(areas=(nook, behind), depth=1.5)
    own, deep = apart.geodesic(GoalSet(areas=both.areas)), apart.geodesic(both)
    assert np.array_equal(np.isfinite(own.cells), np.isfinite(deep.cells)), "whence one could enter"
    assert apart.regions_of(both) == apart.regions_of(GoalSet(areas=both.areas)) == {0, 1}


@pytest.mark.parametrize(
    "goal",
    [GoalSet(points=((4.6, 1.0), (-0.5, 4.1))), GoalSet(areas=(RIGHT_ROOM,)), (4.6, 1.0)],
    ids=["points", "area", "one"],
)
def test_plans_end_at_the_nearest_place_of_a_set(goal: GoalSet | tuple[float, float]) -> None:
    nav = two_rooms()
    field = nav.geodesic(goal)
    plan = plan_actions(field, (-0.5, 0.9), [k * TURN for k in range(24)])
    x, y = walk(plan, -0.5, 0.9)
    steps = int((plan == 1).sum()) * 0.25
    assert field.distance_at(x, y) <= 0.25
    if field.inside is not None:
        assert field.is_inside(x, y)
    assert steps <= field.distance_at(-0.5, 0.9) * 1.1 + 0.25


def test_goal_sets_that_make_no_sense_are_refused() -> None:
    nav = two_rooms()
    for bad in (
        {},
        {"points": ((0.0, math.nan),)},
        {"points": ((0.0, 1.0),), "areas": (RIGHT_ROOM,)},
        {"areas": (((0.0, 0.0), (1.0, 1.0)),)},
    ):
        with pytest.raises(EpisodeError):
            GoalSet(**bad)  # type: ignore[arg-type]
    for deep in ({"points": ((0.0, 1.0),), "depth": 0.5}, {"areas": (RIGHT_ROOM,), "depth": 0.0}):
        with pytest.raises(EpisodeError, match="to be entered"):
            GoalSetInner(**deep)  # type: ignore[arg-type]
    with pytest.raises(PlanError, match="nor is any other"):
        nav.geodesic(GoalSet(points=((90.0, 0.0), (91.0, 0.0))))
    with pytest.raises(PlanError, match="area"):
        nav.geodesic(GoalSet(areas=(((90.0, 0.0), (91.0, 0.0), (91.0, 1.0)),)))
    assert nav.regions_of(GoalSet(points=((90.0, 0.0), (4.6, 1.0)))) == {0}
