"""Pictures of the viewer say what is so: which way is up, how large, how far, how many."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec.structs import replace

from gn0.data.dataset_stats import Coverage, spread_of
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64, Pose2D
from gn0.maps.grid import OccupancyGrid
from gn0.missions.episode import Episode, MissionGoal
from gn0.missions.language.route import RouteSegment
from gn0.render.bev import BevPicture
from gn0.render.open import build_renderer
from gn0.scenes.scene import Scene
from gn0.testing.scenes import build_map_scene
from gn0.viewer.capture_sheet import render_capture
from gn0.viewer.floor_plan import INK, _area, plan_bounds, render_plan
from gn0.viewer.live_file import FileView
from gn0.viewer.live_map import MapAgent, bev_map, plan_map
from gn0.viewer.live_splats import build_live_splats
from gn0.viewer.overlay import BLOCKED_PATH, PATH, START, render_overlay
from gn0.viewer.recorded_runs import _number
from gn0.viewer.route_picture import segment_words
from gn0.viewer.see_through import see_through_shares
from gn0.viewer.stats_page import draw_coverage, draw_histogram, rank


@pytest.fixture(scope="module")
def yard() -> Scene:
    """8 x 4 m of floor, and a wall in the north alone, from y = 3 m on."""
    cells = np.zeros((80, 160), np.uint8)
    cells[60:] = 1
    return build_map_scene(OccupancyGrid(cells, 0.05, (0.0, 0.0)), "yard")


def near(picture: Any, colour: tuple[int, int, int], by: int = 12) -> F64:
    """(row, column) of the pixels of a colour."""
    pixels = np.asarray(picture, np.int64)[..., :3]
    return np.argwhere(np.abs(pixels - colour).max(axis=2) < by).astype(np.float64)


def walk(*path: tuple[float, float], yaw: float = math.pi / 2) -> Episode:
    mission = MissionGoal(goal=path[-1], object_id="", category="", instruction="Go.")
    return Episode(
        id="walk", scene_id="yard", mission=mission, start=(*path[0], yaw), path=path[1:]
    )


def draw(yard: Scene, *episodes: Episode) -> Any:
    return render_overlay(yard, episodes, build_renderer(yard.gaussians, "cpu"), width=600)


def test_an_overlay_has_the_start_where_it_is_and_its_arrow_points_north(yard: Scene) -> None:
    picture = draw(yard, walk((1.0, 1.0), (7.0, 1.0)))
    x0, _, x1, y1 = plan_bounds(yard)
    scale = picture.width / (x1 - x0)
    column, row = (1.0 - x0) * scale, (y1 - 1.0) * scale
    start = near(picture, START)
    assert np.hypot(*(start - (row, column)).T).min() < 5
    assert start[:, 0].min() < row - 20 and start[:, 0].max() < row + 14  # the arrow goes up
    path = near(picture, PATH)
    assert np.abs(path[:, 0] - row).max() < 5


def test_a_wall_in_the_north_darkens_the_top_of_an_overlay_and_of_a_plan(yard: Scene) -> None:
    for picture in (draw(yard), render_plan(yard, 440, 240, names=False)):
        grey = np.asarray(picture, np.int64)[:240].mean(axis=(1, 2))
        tall = round(picture.width * 4.8 / 8.8)
        assert grey[int(0.15 * tall) : int(0.25 * tall)].mean() < 180
        assert grey[int(0.5 * tall) : int(0.7 * tall)].mean() > 200


def test_a_corner_a_centimetre_inside_a_wall_is_red(yard: Scene) -> None:
    free = draw(yard, walk((1.0, 1.0), (4.0, 2.98), (7.0, 1.0)))
    blocked = draw(yard, walk((1.0, 1.0), (4.0, 3.01), (7.0, 1.0)))
    assert not len(near(free, BLOCKED_PATH, 60)) and len(near(blocked, BLOCKED_PATH, 60))


def test_the_scale_bar_is_as_long_as_it_says(yard: Scene) -> None:
    """8.8 m over 880 px are 100 px a metre, so the longest bar below 30 % is 2 m: 200 px."""
    picture = render_plan(yard, 880, 480, names=False)
    bar = near(np.asarray(picture)[460:470], INK, 40)
    columns = np.unique(bar[:, 1])
    columns = columns[: int(np.argmax(np.diff(columns, append=999) > 3)) + 1]  # before its text
    assert np.ptp(columns) == pytest.approx(200, abs=4)


def test_a_room_of_two_by_three_metres_has_six() -> None:
    assert _area(np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 3.0), (0.0, 3.0)])) == pytest.approx(6.0)


def test_the_agent_on_a_live_map_points_where_it_looks(yard: Scene) -> None:
    plan = plan_map(yard, 400)
    ((x, y),) = plan.pixels([(4.0, 1.5)])
    mine = near(plan.draw([MapAgent(Pose2D(4.0, 1.5, math.pi / 2), (250, 0, 250))]), (250, 0, 250))
    assert y - mine[:, 0].min() > mine[:, 0].max() - y + 2 and np.abs(mine[:, 1] - x).max() < 10


def test_a_bev_that_is_not_square_keeps_its_corners() -> None:
    bev = BevPicture(np.zeros((40, 100, 3), np.uint8), 0.1, (-2.0, 3.0))
    plan = bev_map(bev, 520, 420)
    corners = plan.pixels([(-2.0, 3.0), (8.0, 7.0)])
    assert np.allclose(corners, [(0, 208), (520, 0)], atol=1.0)


def test_a_coverage_map_has_north_up_and_untouched_ground_pale() -> None:
    import io

    from PIL import Image

    visits = np.zeros((4, 6), np.int64)
    visits[0] = 9  # the south
    pixels = np.asarray(Image.open(io.BytesIO(draw_coverage(Coverage("s", visits, visits + 1.0)))))
    assert pixels[-1].mean() < pixels[0].mean() - 40


def test_rankings_and_bars_count_as_they_say() -> None:
    assert rank({"rare": 1, "common": 4}) == [("common", 4, 100.0), ("rare", 1, 25.0)]
    turns = replace(spread_of([2, 3, 3], whole=True), edges=(2.0, 4.0, 5.0), bins=(3, 0))
    assert [bar.title for bar in draw_histogram("turns", turns, "", whole=True).bars] == [
        "2 to 3: 3", "4: 0",
    ]  # fmt: skip


def test_a_right_turn_and_a_share_read_as_people_say_them() -> None:
    assert segment_words(RouteSegment(turn="right", angle=-85.0)) == "right 85°"
    assert segment_words(RouteSegment(distance=2.0)) == "straight 2.0 m"
    told = SimpleNamespace(spl=0.5, ne=1.234, steps=7)
    assert [_number(told, *of) for of in (("spl", "%"), ("ne", "m"), ("steps", ""))] == [
        "50 %", "1.23 m", "7",
    ]  # fmt: skip


def test_a_turned_splat_lies_the_same_way_in_the_browser() -> None:
    """30° to the left about z: its long axis is (cos 30°, sin 30°)."""
    cloud = GaussianCloud(
        means=np.zeros((1, 3), np.float32),
        quats=np.array([[math.cos(math.pi / 12), 0, 0, math.sin(math.pi / 12)]], np.float32),
        scales=np.array([[0.3, 0.1, 0.02]], np.float32),
        opacities=np.ones(1, np.float32),
        sh=np.zeros((1, 1, 3), np.float32),
    )
    _, axes = np.linalg.eigh(build_live_splats(cloud, 10).covariances[0])
    assert abs(axes[:, 2] @ (math.cos(math.pi / 6), 0.5, 0.0)) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(("up", "axis"), [("+z", (0, 0, 1)), ("-y", (0, -1, 0)), ("+x", (1, 0, 0))])
def test_up_is_the_axis_that_was_named(up: str, axis: tuple[int, int, int]) -> None:
    assert FileView._axis(cast(FileView, SimpleNamespace(up=up))).tolist() == list(axis)


def test_a_captures_floor_is_marked_below_its_ceiling(yard: Scene) -> None:
    from dataclasses import replace as with_

    rng = np.random.default_rng(0)
    count = 400
    cloud = GaussianCloud(
        means=(rng.uniform(0, 1, (count, 3)) * (8, 4, 2.8)).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.full((count, 3), 0.05, np.float32),
        opacities=np.ones(count, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )
    known = {"height_band_low": 0.1, "height_band_high": 1.5, "ceiling": 2.5}
    source = replace(yard.source, settings=known)
    sheet = render_capture(with_(yard, load_cloud=lambda: cloud, cloud_hash="", source=source))
    floor, ceiling = near(sheet, (34, 120, 200), 3), near(sheet, (130, 90, 170), 3)
    assert np.median(floor[:, 0]) > np.median(ceiling[:, 0]) + 100


def test_a_scene_is_open_where_no_splat_stops_the_view(
    yard: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    alpha = np.ones((2, 10, 10))
    alpha[1, :3] = 0.1  # three of ten rows of the second view

    class Eyes:
        def render(self, camera: object, views: F64, outputs: object) -> Any:
            return SimpleNamespace(alpha=alpha[: len(views)])

    monkeypatch.setattr("gn0.viewer.see_through.build_renderer", lambda cloud: Eyes())
    poses = [Pose2D(1.0, 1.0, 0.0), Pose2D(2.0, 1.0, 0.0)]
    monkeypatch.setattr("gn0.viewer.see_through.choose_viewpoints", lambda scene, views: poses)
    assert see_through_shares(yard) == pytest.approx([0.0, 0.3])
