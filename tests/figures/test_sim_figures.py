"""The simulator's figures measure what they say, and would notice a fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.testing.scenes import build_floor_plan, build_map_scene
from gn0_figures import sim as figures
from gn0_figures.board import FigureContext
from gn0_figures.people_sim import room_to_go


def test_a_walk_through_walls_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = build_map_scene(build_floor_plan(0), "plan")
    assert figures.count_penetrations(scene, 3000, 1)[0] == 0
    monkeypatch.setattr(NavigationMap, "move", lambda self, x0, y0, x1, y1: (x1, y1, False))
    found, visited = figures.count_penetrations(scene, 3000, 1)
    assert found > 300
    assert visited > 20


def test_a_failed_episode_counts_as_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = build_map_scene(build_floor_plan(2), "plan")
    qualities, seconds = figures.judge_oracle(scene, 3, 0)
    assert min(qualities) > 0.9
    assert len(seconds) == 3
    run = figures.run_episode
    monkeypatch.setattr(
        figures, "run_episode", lambda *a: replace(run(*a), poses=run(*a).poses[:5])
    )
    assert figures.judge_oracle(scene, 3, 0)[0] == [0, 0, 0]


def test_rows_carry_their_targets() -> None:
    good = figures._oracle_rows("here", [0.98, 1.0], [0.1, 0.2])
    assert [row.passed for row in good] == [True, True, None, None]
    bad = figures._oracle_rows("here", [0.0, 1.0], [0.1, 0.2])
    assert [row.passed for row in bad][:2] == [False, False]
    assert bad[0].value == 50


def test_absent_data_is_said(tmp_path) -> None:
    context = FigureContext(data=tmp_path, work=tmp_path)
    with pytest.raises(FileNotFoundError):
        figures.measure_oracle_house(context)
    (tmp_path / "worlds" / "small_house").mkdir(parents=True)
    with pytest.raises(FileNotFoundError, match=r"map\.yaml"):
        figures.measure_oracle_house(context)


def test_ids_are_unique_and_in_the_room() -> None:
    ids = [figure.id for figure in figures.FIGURES]
    assert len(ids) == len(set(ids))
    assert all(name.startswith("sim.") for name in ids)
    assert np.isfinite([figure.minutes for figure in figures.FIGURES]).all()


def test_who_is_shut_in_is_told_from_who_has_room_to_go() -> None:
    """A hallway 0.4 m wide for centres, 2 m long: who stands in it leaves the part before it."""
    cells = np.full((20, 60), OCCUPIED, np.uint8)
    cells[8:12, 10:30] = FREE
    hall = OccupancyGrid(cells, 0.1, (0.0, 0.0))
    place = np.array([1.2, 1.0])
    alone = room_to_go(hall, place, np.zeros((0, 2)))
    assert alone == pytest.approx(0.8, abs=0.01)
    assert room_to_go(hall, place, np.array([[1.75, 1.0]])) == pytest.approx(0.12, abs=0.03)
    assert room_to_go(hall, place, np.array([[5.0, 1.0]])) == alone
