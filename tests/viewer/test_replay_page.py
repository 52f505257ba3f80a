"""The replay page without a browser: it plays at the pace that is asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gn0.bench.runner import run_suite
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.suites.suite import build_suite
from gn0.viewer.floor_plan import _quiet_spots
from gn0.viewer.live_loop import LiveLoop
from gn0.viewer.live_server import open_server
from gn0.viewer.recorded_runs import load_replay
from gn0.viewer.replay_live import ReplayView

pytestmark = pytest.mark.usefixtures("workers_here")

pytest.importorskip("viser")
STEPS = {"gn_bench": 0.5, "follower": 0.2}  # s of simulated time that a step of the body takes


def record(root: Path, camera: str) -> Path:
    save_scene(build_example_scene(spacing=0.1), root / "flat")
    suite = build_suite(
        [root / "flat"], root / "suite", count=1, seed=1, max_steps=40, camera=camera
    )
    run_suite(suite, "oracle", root / "oracle", workers=1)
    return root / "oracle"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("page"), "gn_bench")


@pytest.mark.parametrize("camera", STEPS)
def test_a_replay_goes_on_from_where_it_was_in_simulated_time(
    run: Path, camera: str, tmp_path: Path
) -> None:
    run = run if camera == "gn_bench" else record(tmp_path, camera)
    with open_server(port=0) as live:
        page = ReplayView(live, LiveLoop(), replay=load_replay([run]), splats=2000)
        page.open()
        page.finish()
        assert page.ready and page.step == 0
        assert page.tick(5.0) is None  # nothing plays, nothing is due
        page._toggle()
        page.speed = 1.0
        step = STEPS[camera]
        wait = page.tick(100.0)  # whatever the clock says when it begins
        assert page.step == 0 and wait == pytest.approx(step / 2)  # looks twice a step
        page.tick(100.0 + 2.1 * step)
        assert page.step == 2
        page.tick(100.0 + 1000 * step)
        assert page.step == page.replay.length(page.episode) and not page.playing


def test_the_plan_of_a_replay_is_that_of_its_scene(run: Path) -> None:
    with open_server(port=0) as live:
        page = ReplayView(live, LiveLoop(), replay=load_replay([run]), splats=2000)
        page.open()
        assert page.scene is not None and page._plan is not None
        assert page.scene.id == page.episode.scene_id


def test_a_rooms_name_is_written_inside_it() -> None:
    scene = build_example_scene(spacing=0.2)
    for room in scene.rooms:
        polygon = np.asarray(room.polygon, float)
        spots = np.array(_quiet_spots(scene, polygon))
        assert len(spots)
        assert (spots > polygon.min(axis=0)).all() and (spots < polygon.max(axis=0)).all()
