"""gn0 scene show: the sheet shows the scene, from sensible places, the same every time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gn0.maps.grid import OCCUPIED
from gn0.maps.navigation import NavigationMap
from gn0.render.open import build_renderer
from gn0.scenes.example import build_example_scene
from gn0.scenes.scene import SceneObject
from gn0.viewer.floor_plan import _SUPER, _Plan, render_plan
from gn0.viewer.scene_sheet import render_sheet
from gn0.viewer.viewpoints import choose_viewpoints


@pytest.fixture(scope="module")
def scene():
    return build_example_scene(spacing=0.1)


def test_sheet(scene):
    renderer = build_renderer(scene.gaussians)
    sheet = render_sheet(scene, renderer, width=960)
    pixels = np.asarray(sheet)
    assert pixels.shape[1:] == (960, 3)
    assert 500 < pixels.shape[0] < 1600
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 2000
    assert np.array_equal(pixels, np.asarray(render_sheet(scene, renderer, width=960)))


def test_views_stand_free_and_see_things(scene):
    poses = choose_viewpoints(scene, 4)
    navigation = NavigationMap(scene.grid, 0.25)
    assert 2 <= len(poses) <= 4
    for pose in poses:
        assert navigation.is_free(pose.x, pose.y)
        ahead = [
            thing
            for thing in scene.objects
            if abs(
                math.remainder(
                    math.atan2(thing.box.centre[1] - pose.y, thing.box.centre[0] - pose.x)
                    - pose.yaw,
                    2 * math.pi,
                )
            )
            < math.radians(40)
        ]
        assert ahead
    rooms = {pose.x < 3.95 for pose in poses}
    assert rooms == {True, False}  # both rooms are shown


def test_views_are_repeatable(scene):
    assert choose_viewpoints(scene, 3) == choose_viewpoints(scene, 3)


def test_plan_is_a_map(scene):
    """North up, x to the right: the room to the west has its own colour on the left."""
    pixels = np.asarray(render_plan(scene, 800, 520)).astype(int)
    h, w, _ = pixels.shape
    west, east = pixels[int(h * 0.55), int(w * 0.40)], pixels[int(h * 0.5), int(w * 0.56)]
    assert np.abs(west - east).sum() > 15
    assert pixels.min() < 90  # walls are dark


def test_scenes_without_anything_still_draw(scene):
    bare = replace(scene, objects=(), rooms=(), walls=(), licence="")
    blocked = replace(bare, grid=bare.grid.with_cells(np.full(bare.grid.shape, OCCUPIED, np.uint8)))
    renderer = build_renderer(scene.gaussians)
    for odd in (bare, blocked):
        assert render_sheet(odd, renderer, width=640).width == 640
    assert choose_viewpoints(blocked) == []


def test_long_and_strange_names_do_not_break_it(scene):
    first = scene.objects[0]
    odd = SceneObject(id="x", category="тумба " * 40 + "<script>", box=first.box)
    strange = replace(scene, id="n" * 128, objects=(odd, *scene.objects), licence="l" * 9999)
    assert render_sheet(strange, build_renderer(scene.gaussians), width=640).width == 640


def test_names_on_a_small_plan_lie_in_their_rooms(scene):
    """A name over the neighbour's floor is taken for the neighbour's."""
    plan = _Plan(scene, 300 * _SUPER, 150 * _SUPER)
    plan.draw(names=False)
    assert len(plan.labels) == len(scene.rooms)
    for room, (left, top, right, bottom) in zip(scene.rooms, plan.labels, strict=True):
        polygon = np.asarray(room.polygon)
        (x0, y0), (x1, y1) = plan.at(*polygon.min(axis=0)), plan.at(*polygon.max(axis=0))
        assert x0 < left < right < x1 and y1 < top < bottom < y0, room.id
