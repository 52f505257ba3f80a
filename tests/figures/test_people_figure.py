"""Figures of people: who wins no way, standing or shuffling, and who only waits or stops."""

from __future__ import annotations

import numpy as np
import pytest

from gn0_figures import people_among, people_sim
from gn0_figures.board import FigureContext
from gn0_figures.people_sim import NO_WAY, TICKER, WON, WayWatch

TICKS = round(NO_WAY / TICKER.step_seconds)


def test_who_shuffles_wins_no_way_and_who_walks_stops_or_waits_a_while_does() -> None:
    t = np.arange(2 * TICKS) * TICKER.step_seconds
    shuffles = 3.0 + 0.4 * WON * np.sin(t)  # its feet move all the time
    stands = np.full_like(t, 1.0)
    creeps = 1.5 * WON / NO_WAY * t
    waits = np.where(t < 0.9 * NO_WAY, 2.0, 2.0 + 0.5 * (t - 0.9 * NO_WAY))
    there_and_back = 4.0 + 2.0 * np.sin(2 * np.pi * t / NO_WAY)  # ends where it began
    ways = np.stack([shuffles, stands, creeps, waits, there_and_back, stands, stands])
    on_way = np.ones(ways.shape, np.bool_)
    on_way[5, TICKS - 20 : TICKS + 20] = False  # a stop of its script
    on_way[6, 30:] = False  # has arrived
    watch = WayWatch((1, len(ways)), TICKS)
    for tick in range(len(t)):
        watch.see(ways[None, :, tick], on_way[None, :, tick])
        assert watch.found[0, 1] == (tick >= TICKS - 1)  # not before the time is up
    assert watch.found[0].tolist() == [True, True, False, False, False, False, False]


def test_the_row_of_who_stood_still_is_counted_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(people_sim, "SCENES", 1)
    scenes, episodes = people_sim.plan_episodes(1, 3)
    found = people_sim.watch(scenes, episodes, 3.0, [0, 1, 2])
    assert (found.stuck, found.no_way) == (0, 0) and 0.0 < found.longest < 3.0
    monkeypatch.setattr(people_sim, "NO_WAY", 0.5)
    soon = people_sim.watch(scenes, episodes, 3.0, [0, 1, 2])
    assert soon.no_way > 0  # who sets off has won little by then
    assert (soon.stuck, soon.longest, soon.digest) == (found.stuck, found.longest, found.digest)


@pytest.mark.slow
def test_agents_among_people_pose_those_whom_they_may_see(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(people_among, "PEOPLE", 3)
    monkeypatch.setattr(people_among, "IDENTITIES", 1)
    monkeypatch.setattr(people_among, "_EPISODES", 1)
    rows = people_among.measure_among(FigureContext(tmp_path, tmp_path), splats=2000, steps=12)
    few, many = (float(row.detail.split(". ")[-1].split()[0]) for row in rows)
    assert 0 <= few < many <= 3
