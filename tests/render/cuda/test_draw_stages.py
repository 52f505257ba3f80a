"""Stage times, and the script that prints them, on the host emulation."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.render.cuda.draw import STAGES, Drawer
from gn0_figures.stages import time_stages
from gn0_figures.tune import TuneCase, build_cases, list_tunings, main, name_tuning, time_case
from gn0_figures.tune_people_drawn import TimedDrawer, time_kernels

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


@pytest.fixture(scope="module")
def case() -> TuneCase:
    return next(build_cases(DeviceHost(), "640x480 x1 SH0"))


def test_stages_are_timed_one_by_one(case: TuneCase) -> None:
    drawer = Drawer(case.clouds[0].splats.device)
    pictures = case.pictures(drawer)
    turns: list[int] = []

    def draw(turn: int) -> None:
        turns.append(turn)
        case.draw(drawer, pictures, turn)

    taken = time_stages(drawer, draw, repeat=3)
    assert turns == list(range(5))
    assert set(taken) == {*STAGES, "all", "host"}
    assert 0 < taken["blend"] < taken["all"] <= taken["host"]
    assert drawer.on_stage is None


def test_every_size_that_is_tried_draws_the_same(case: TuneCase) -> None:
    """Names are distinct, so that lines can be told apart; of two lists the first is drawn."""
    lists = list_tunings(True), list_tunings(False)
    for tunings in lists:
        assert len({name_tuning(t) for t in tunings}) == len(tunings)
    device = case.clouds[0].splats.device
    digests = {time_case(case, device, tunings[0], 1).split()[-1] for tunings in lists}
    assert len(digests) == 1


def test_the_script_prints_a_line_a_case(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GN0_DEVICE", "host")
    main(["BEV 1024 SH3"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[2:3] == ["BEV 1024 SH3"]
    assert len(lines) == 4
    taken = np.array(lines[3].split()[-10:-3], float)  # nothing is counted where lists have room
    assert np.delete(taken, 1).min() > 0


def test_kernels_are_timed_one_by_one(case: TuneCase) -> None:
    drawer = TimedDrawer(case.clouds[0].splats.device)
    pictures = case.pictures(drawer)
    taken = time_kernels(drawer, lambda turn: case.draw(drawer, pictures, turn), 1)
    assert {"emit_entries", "scan_counts", "paint_tiles", "all"} <= set(taken)
    assert 0 < taken["paint_tiles"] < taken["all"]


@pytest.mark.slow
def test_the_script_prints_what_people_cost(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GN0_DEVICE", "host")
    main(["--people"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].split()[-5:] == ["none", "unseen", "1", "4", "8"]
    end = next(n for n, line in enumerate(lines) if line.startswith("entries a view"))
    rows = {line.split()[0]: [float(x) for x in line.split()[1:]] for line in lines[3:end]}
    assert rows["emit_entries"][0] > 0 and rows["emit_parts"][0] == 0 < rows["emit_parts"][4]
