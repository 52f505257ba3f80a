"""The figures of many at once measure what they say, and would notice a fault."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.render.cpu import RendererCpu
from gn0.render.visible import RendererVisible, VisibleOptions
from gn0.sim import simulator
from gn0_figures import vector as figures
from gn0_figures.flat import EYE, build_flat, flat_camera, flat_floor


def test_a_step_that_differs_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes, episodes = figures._plans(1, 6.0)
    assert figures.count_differences(scenes, episodes, 5) == 0
    right = simulator.step_forward
    monkeypatch.setattr(
        simulator, "step_forward", lambda x, y, yaw, d: right(x, y, yaw, np.nextafter(d, 1))
    )
    assert figures.count_differences(scenes, episodes, 5) > 100


def test_the_flat_has_a_floor_to_stand_on() -> None:
    """Free where views are taken, doors open, not in walls or furniture."""
    floor = flat_floor()
    assert 40 < floor.free_area < 110
    assert not floor.is_free(4.4, 5.0)
    assert not flat_floor(0.0).is_free(4.4, 5.0)
    assert flat_floor(0.0).is_free(4.4, 1.95), "a door"
    views = figures._known_views(floor, 8)
    assert len(views) == 8


def test_sets_are_judged_against_all_splats(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path))
    cloud = build_flat(20_000)
    renderer = RendererVisible(
        RendererCpu(cloud), "flat", flat_floor(), EYE, VisibleOptions(places=2, pixels=128)
    )
    views = figures._known_views(flat_floor(), 2)
    quality, full, visible, split = figures.judge_sets(renderer, flat_camera(64, 48), views)
    assert len(quality) == 2
    assert 25 < min(quality) < 99
    assert full > 0
    assert visible > 0
    assert "raster" in split


def test_ids_are_unique_and_in_the_room() -> None:
    ids = [figure.id for figure in figures.FIGURES]
    assert len(ids) == len(set(ids))
    assert all(name.startswith("vector.") for name in ids)
