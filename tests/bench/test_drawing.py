"""Pictures of a run may be drawn by one process for all workers; who sees none opens no device."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import msgspec
import pytest

from gn0.bench.runner import run_suite
from gn0.errors import BenchError
from gn0.render.light import LightCondition
from gn0.render.share.server_process import DrawServer
from gn0.suites import scene_drawing
from gn0.suites.run_files import RESULTS, RUN, TRAJECTORIES
from gn0.suites.scene_drawing import Look, choose_run_backend, load_look, needs_renderer
from gn0.suites.suite import Suite, load_suite

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="Unix sockets"),
    pytest.mark.usefixtures("workers_here"),
]
PLUGIN = ("seeing_policies",)


@pytest.fixture(autouse=True)
def plugin_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent / "plugin"))


@pytest.fixture(scope="module")
def small_suite(flats_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """The flats seen through a camera of 48x36."""
    sys.path.insert(0, str(Path(__file__).parent / "plugin"))
    import seeing_policies  # noqa: F401  (knows the camera)

    folder = tmp_path_factory.mktemp("small") / "suite"
    shutil.copytree(flats_suite.folder, folder)
    suite = load_suite(folder)
    about = msgspec.structs.replace(suite.about, camera="small")
    return Suite(suite.folder, about, suite.episodes)


def files(out: Path) -> tuple[bytes, bytes]:
    return (out / RESULTS).read_bytes(), (out / TRAJECTORIES).read_bytes()


def test_one_process_draws_for_all_workers(small_suite, tmp_path, monkeypatch) -> None:
    options = {"plugin_modules": PLUGIN, "backend": "cpu", "max_episodes": 8}
    run_suite(small_suite, "seeing", tmp_path / "alone", **options)
    monkeypatch.setattr(scene_drawing, "SHARED", frozenset({"cpu"}))
    run_suite(small_suite, "seeing", tmp_path / "shared", workers=2, **options)
    assert files(tmp_path / "alone") == files(tmp_path / "shared")
    run = json.loads((tmp_path / "shared" / RUN).read_text())
    assert run["sessions"][0]["card"] == "CPU" and "drawing" not in run["settings"]
    assert "card" not in json.loads((tmp_path / "alone" / RUN).read_text())["sessions"][0]


def test_who_sees_no_pictures_opens_no_device(flats_suite, tmp_path, monkeypatch) -> None:
    """The same bytes, and the same run: its record can go on on any machine."""

    def refuse(server: DrawServer) -> DrawServer:
        raise AssertionError("a device is opened")

    monkeypatch.setattr(DrawServer, "__enter__", refuse)
    monkeypatch.setenv("GN0_DEVICE", "cuda:99")  # would fail
    run_suite(flats_suite, "oracle", tmp_path / "cpu", max_episodes=3)
    run_suite(flats_suite, "oracle", tmp_path / "cuda", max_episodes=3, backend="cuda")
    assert files(tmp_path / "cpu") == files(tmp_path / "cuda")
    for name in ("summary.json",):
        assert (tmp_path / "cpu" / name).read_bytes() == (tmp_path / "cuda" / name).read_bytes()
    assert choose_run_backend("cuda", "oracle", "prior") == "auto"


def test_what_needs_a_renderer() -> None:
    assert not needs_renderer({"pose", "ranges", "goal_vector"}, "prior")
    assert not needs_renderer({"occupancy"}, "prior") and needs_renderer({"occupancy"}, "explored")
    assert needs_renderer({"bev"}, "prior") and needs_renderer({"history"}, "none")


def test_a_lost_drawing_process_ends_the_run_and_it_goes_on(
    small_suite, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(scene_drawing, "SHARED", frozenset({"cpu"}))
    options = {"plugin_modules": PLUGIN, "backend": "cpu", "max_episodes": 8}
    entered = DrawServer.__enter__

    def enter(server: DrawServer) -> DrawServer:
        found = entered(server)
        found.end()
        return found

    monkeypatch.setattr(DrawServer, "__enter__", enter)
    with pytest.raises(BenchError, match="drawing process"):
        run_suite(small_suite, "seeing", tmp_path / "d", **options)
    monkeypatch.setattr(DrawServer, "__enter__", entered)
    assert run_suite(small_suite, "seeing", tmp_path / "d", **options).ok


def test_a_look_is_its_scene_in_its_light(flats_suite) -> None:
    scene = flats_suite.about.scenes[0]
    folder = str(flats_suite.scene_folder(scene.id))
    plain, lit = (
        Look(folder, scene.id, scene.hash, light)
        for light in (None, LightCondition(name="evening", exposure=-1.0))
    )
    named = Look(folder, scene.id, scene.hash, LightCondition(name="as it was"))
    assert plain.key == named.key != lit.key
    assert load_look(plain.source).sh.mean() > load_look(lit.source).sh.mean()
    with pytest.raises(BenchError):
        load_look(Look(folder, scene.id, "0" * 32).source)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_a_run_on_a_device_says_so(small_suite, tmp_path, monkeypatch) -> None:
    """End to end on the emulation: the pictures of a few steps, drawn by kernels."""
    monkeypatch.setenv("GN0_DEVICE", "host")
    options = {"plugin_modules": PLUGIN, "max_episodes": 2}
    summary = run_suite(small_suite, "seeing", tmp_path / "d", backend="auto", **options)
    assert summary.ok
    run = json.loads((tmp_path / "d" / RUN).read_text())
    assert run["settings"]["backend"] == "cuda"
    assert run["sessions"][0]["card"] == "host emulation"
    assert any("CUDA renderer" in how for what, how in summary.protocol if what == "pictures")
    run_suite(small_suite, "seeing", tmp_path / "e", backend="cuda", workers=2, **options)
    assert files(tmp_path / "d") == files(tmp_path / "e")
