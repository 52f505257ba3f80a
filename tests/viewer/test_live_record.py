"""The recording page without a browser: what is pressed is walked, and ends up in the run."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from gn0.bench.report import load_run
from gn0.bench.walk_recording import WalkRecorder, open_recorder
from gn0.cli.main import main
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.suites.suite import Suite, build_suite, load_suite
from gn0.suites.track import Track
from gn0.viewer.live_loop import LiveLoop
from gn0.viewer.live_record import RecordView
from gn0.viewer.live_server import LiveServer, open_server

pytest.importorskip("viser")


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    root = tmp_path_factory.mktemp("record")
    save_scene(build_example_scene(spacing=0.1), root / "flat")
    build_suite([root / "flat"], root / "suite", count=2, seed=1, max_steps=3)
    return load_suite(root / "suite")


def open_page(live: LiveServer, recorder: WalkRecorder, first: str = "") -> RecordView:
    page = RecordView(live, LiveLoop(), recorder=recorder, first=first)
    page.open()
    page.finish()
    assert page.ready
    return page


def test_what_is_pressed_is_walked_and_ends_with_stop_or_the_last_step(suite, tmp_path) -> None:
    with open_server(port=0) as live, open_recorder(suite, tmp_path / "run") as recorder:
        page = open_page(live, recorder)
        first = page.episode
        page.move("left")
        page.begin_again()
        page.move("right")
        page.stop()
        assert "1 of 2 episodes are walked" in page._status.content
        page.move("left")  # it has ended
        page.begin_again()
        assert not page.walking and len(recorder.results) == 1
        assert page._list.value.startswith(("✓", "✗"))
        page._turn_page()
        assert page.episode != first and page.attempts == 1
        for _ in range(3):
            page.move("left")
        assert "Ran out of steps" in page._status.content
        live.asks[0](first.id)  # a link
        assert page.loop.pending
    run = load_run(tmp_path / "run")
    assert run.summary.ok and run.traces[first.id].actions == (3, 0)
    assert run.about["episodes"][first.id]["attempts"] == 2
    assert run.traces[page.episode.id].actions == (2, 2, 2)


def test_the_page_shows_what_the_track_tells_and_hostile_words_as_words(suite, tmp_path) -> None:
    attack = "<script>window.gn0Hacked=1</script>"
    first, second = suite.episodes
    mission = msgspec.structs.replace(first.mission, instruction=attack)
    hostile = Suite(
        suite.folder, suite.about, (msgspec.structs.replace(first, mission=mission), second)
    )
    told = hostile.with_track(Track(goal="point", pose=True))
    with open_server(port=0) as live, open_recorder(told, tmp_path / "run") as recorder:
        page = open_page(live, recorder, first.id)
        assert "<" not in page._task.content and "gn0Hacked" in page._task.content
        assert "yaw" in page._status.content and "m ahead" in page._status.content
    bare = suite.with_map_mode("none").with_track(Track(goal="object"))
    with open_server(port=0) as live, open_recorder(bare, tmp_path / "bare") as recorder:
        page = open_page(live, recorder)
        assert "yaw" not in page._status.content and page._map is None


def test_a_recording_that_cannot_be_is_refused_before_anything_is_written(
    suite, tmp_path, capsys
) -> None:
    folder, out = str(suite.folder), str(tmp_path / "out")
    for words, more in {
        "no episode 'gone'": [folder, "--record", out, "--episode", "gone"],
        "one suite": [folder, folder, "--record", out],
        "belong to a recording": [folder, "--name", "Ada"],
        "cannot be shown": [folder, "--record", out, "--name", "a\nb"],
    }.items():
        assert main(["view", *more, "--check", "--port", "0"]) != 0
        assert words in capsys.readouterr().err
        assert not Path(out).exists()
    assert main(["view", folder, "--record", out, "--check", "--port", "0"]) == 0
    assert "the page is ready" in capsys.readouterr().out
