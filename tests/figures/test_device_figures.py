"""The device's figures, each run whole on the host emulation: nothing is tried first on a card."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceError, DeviceMemoryError
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.scenes.folder import save_scene
from gn0.storage import cache_dir
from gn0.testing.scenes import build_room_scene
from gn0_figures import (
    device_checks,
    device_labels,
    device_parts,
    device_people,
    device_rates,
    device_sanitizers,
    device_suite,
    device_table,
    ego,
    people_render_cuda,
    rival,
)
from gn0_figures.agreement import tail_before
from gn0_figures.board import Figure, FigureContext, FigureSkipped
from gn0_figures.catalogue import all_figures
from gn0_figures.device import interleave, measure_ceilings
from gn0_figures.device_scenes import flat_scene
from gn0_figures.flat import build_flat, flat_bev, flat_camera, flat_views
from gn0_figures.floor import count_work

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="the emulation needs g++")
MODULES = (
    *(device_checks, device_table, device_parts, device_labels, device_rates, device_suite),
    *(device_sanitizers, device_people, ego, people_render_cuda),
)
FIGURES = [figure for module in MODULES for figure in module.FIGURES]


class FakeRival(RendererCpu):
    """gsplat's place in a figure, without gsplat."""

    views_that_fit = 10**9

    def place(self, camera: Camera, views: Any) -> tuple[Any, Any]:
        return views, views

    def rasterize(self, camera: Camera, placed: Any, *, packed: bool | None = None) -> Any:
        if len(placed[0]) > self.views_that_fit:
            raise DeviceMemoryError("too many views")
        return self.render(camera, placed[0]), packed


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    for name in ("apartment", "small_house"):
        save_scene(build_room_scene(), folder / name)
    return folder


@pytest.fixture
def ctx(tmp_path: Path, scenes: Path, monkeypatch: pytest.MonkeyPatch) -> FigureContext:
    said: list[Any] = []
    monkeypatch.setenv("GN0_DEVICE", "host")
    context = FigureContext(
        data=None, work=tmp_path, device=DeviceHost(), scenes=scenes, report=said.append
    )
    object.__setattr__(context, "said", said)
    return context


@pytest.fixture
def fake_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (device_table, device_checks):
        monkeypatch.setattr(module, "release_memory", lambda: None)
    monkeypatch.setattr(rival, "release_memory", lambda: None)
    monkeypatch.setattr(device_checks, "memory_peak", lambda reset=False: 0)
    monkeypatch.setattr(device_table, "open_rival", FakeRival)


def _rows(figure: Figure, ctx: FigureContext) -> dict[str, Any]:
    rows = figure.measure(ctx)
    assert rows
    assert all(np.isfinite(row.value) for row in rows)
    names = [row.name for row in rows]
    assert len(names) == len(set(names)), "no two rows of a figure have one name"
    return {row.name: row for row in rows}


# which others' tests go through as well
LONG = {"render.cuda.suite", "render.cuda.sim", "people.sim.cuda"}


@pytest.mark.parametrize(
    "figure",
    [
        pytest.param(figure, id=figure.id, marks=[pytest.mark.slow] * (figure.id in LONG))
        for figure in FIGURES
    ],
)
def test_every_figure_runs(figure: Figure, ctx: FigureContext, fake_rival: None) -> None:
    if figure.id == "render.cuda.sanitizers":
        with pytest.raises(FigureSkipped, match="compute-sanitizer"):
            figure.measure(ctx)
        return
    rows = _rows(figure, ctx)
    said = [row.name for row in ctx.said]  # type: ignore[attr-defined]
    assert said == list(rows)[: len(said)], "reported as they come"
    if figure in device_table.FIGURES:
        ratios = [name for name in rows if name.endswith("against gsplat")]
        assert ratios
        assert "packed" in rows[ratios[0]].detail
        assert any("time over floor" in name for name in rows)
        assert any("in float32, against gsplat" in name for name in rows)
        assert any("sorting counted" in name for name in rows)
    missed = [row for row in rows.values() if row.passed is False]
    assert not missed or figure.id == "render.cuda.visible", missed


def test_without_gsplat_times_are_said_all_the_same(
    ctx: FigureContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(cloud: Any) -> Any:
        raise DeviceError("torch is not installed", remedy="install it")

    monkeypatch.setattr(device_table, "open_rival", absent)
    rows = _rows(device_table.FIGURES[1], ctx)
    assert not any("against" in name for name in rows)
    assert "no ratio to gsplat: torch is not installed" in next(iter(rows.values())).detail


def test_the_rival_is_timed_in_its_quick_forms(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rival, "release_memory", lambda: None)
    fake = FakeRival(build_flat(500))
    batches = [flat_views(6, seed=k) for k in range(2)]
    calls, forms = rival.quick_calls(DeviceHost(), fake, flat_camera(8, 8), batches)  # type: ignore[arg-type]
    assert "packed" in forms
    assert "unpacked" in forms
    assert {"gsplat packed", "gsplat unpacked"} >= set(calls)
    assert all(len(call(1)) == 1 for call in calls.values())
    fake.views_that_fit = 3
    calls, forms = rival.quick_calls(DeviceHost(), fake, flat_camera(8, 8), batches)  # type: ignore[arg-type]
    assert "in 2 calls" in forms
    for call in calls.values():
        assert [len(pictures.rgb) for pictures, _ in call(0)] == [3, 3]
    fake.views_that_fit = 0
    with pytest.raises(DeviceMemoryError):
        rival.quick_calls(DeviceHost(), fake, flat_camera(8, 8), batches)  # type: ignore[arg-type]


def test_a_library_that_is_absent_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(rival.LIBRARY, str(tmp_path / "gsplat_cuda.so"))
    monkeypatch.setattr(rival, "open_torch", lambda: None)
    with pytest.raises(Exception, match="no such library"):
        rival.open_rival(build_flat(10))
    (tmp_path / "gsplat_cuda.so").write_bytes(b"no library")
    with pytest.raises(Exception, match="gsplat_cuda"):
        rival.open_rival(build_flat(10))
    assert "gsplat.csrc" not in sys.modules


def test_contenders_take_turns_with_new_poses() -> None:
    turns: list[tuple[str, int]] = []
    calls = {name: lambda k, name=name: turns.append((name, k)) for name in "abc"}
    times = interleave(DeviceHost(), calls, 7, warm=1)
    rounds = [turns[k : k + 3] for k in range(0, len(turns), 3)]
    assert [sorted(one) for one in rounds] == [[(n, k) for n in "abc"] for k in range(8)]
    behind = {(x[0], y[0]) for one in rounds for x, y in pairwise(one)}
    assert behind == {(x, y) for x in "abc" for y in "abc" if x != y}, "each comes behind each"
    assert [len(taken) for taken in times.values()] == [7, 7, 7]
    walls: dict[str, list[float]] = {}
    interleave(DeviceHost(), {"a": lambda _: None}, 3, warm=0, walls=walls)
    assert len(walls["a"]) == 3
    assert all(value > 0 for value in measure_ceilings(DeviceHost()))


def test_work_is_counted() -> None:
    """A floor of one view counts what the CPU lists; more views take more, never less."""
    cloud = build_flat(4000)
    judge = RendererCpu(cloud)
    views = flat_views(3)
    work = count_work(judge, flat_camera(64, 64), views)
    assert 0 < work.visible <= work.tested <= len(cloud) + 256
    assert work.visible <= work.entries
    assert 0 < work.reached <= work.entries
    assert work.blended > 0
    many = work.scaled(10)
    assert many.chunks == work.chunks
    assert many.entries == 10 * work.entries
    one, ten = (w.floor(0, 1e12, 1e13) for w in (work, many))
    assert one < ten < 10 * one * 1.001
    assert work.bytes_of(3)[1] > work.bytes_of(0)[1], "harmonics are read too"
    assert work.floor(0, 2e12, 2e13) == pytest.approx(one / 2)
    assert work.sort_bytes == 88 * work.entries
    above = count_work(judge, *flat_bev(64)[:1], flat_bev(64)[1][None])
    assert above.entries > 0


def test_nothing_in_sight_takes_nothing() -> None:
    away = flat_views(1)
    away[0, 2, 3] -= 1000.0  # everything is behind the eye
    work = count_work(RendererCpu(build_flat(500)), flat_camera(32, 32), away)
    assert (work.tested, work.entries, work.reached) == (0, 0, 0)


def test_poses_stand_on_the_floor() -> None:
    scene = flat_scene(100)
    views = scene.views(20, 1)
    assert views.shape == (20, 4, 4)
    for view in views:
        x, y, z = -view[:3, :3].T @ view[:3, 3]
        assert scene.floor.is_free(x, y)
        assert z == pytest.approx(scene.eye)
    assert (scene.views(20, 1) == views).all()
    assert not (scene.views(20, 2) == views).all()
    tail = tail_before(views, 50)
    assert np.isfinite(tail.means).all()
    np.testing.assert_allclose(np.linalg.norm(tail.quats, axis=1), 1, atol=1e-5)


def test_they_are_in_the_catalogue_and_need_a_card() -> None:
    known = all_figures()
    for figure in FIGURES:
        assert known[figure.id] is figure
        assert figure.backend == "cuda"
        assert figure.minutes <= 5


def _sleeper(folder: Path) -> Path:
    """In Python's place: something that hangs in modules and leaves a process behind."""
    path = folder / "sleeper"
    scripts = f'[ "$1" = -c ] && exec {sys.executable} "$@"'
    path.write_text(f"#!/bin/sh\n{scripts}\nsetsid sleep 5 &\nexec sleep 60\n")
    path.chmod(0o755)
    return path


@pytest.mark.slow
def test_the_script_runs_groups_and_says_what_is_done(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[2]
    script = [str(root / "runs" / "gpu-figures.sh"), str(tmp_path / "out")]
    environment = {
        **os.environ,
        "GN0_DEVICE": "host",
        "PYTHON": sys.executable,
        "GN0_CACHE": str(cache_dir()),
        "KEEP": str(tmp_path / "kept"),
        "GN0_GSPLAT_LIBRARY": str(tmp_path / "none.so.xz"),
    }
    done = subprocess.run(
        [*script, "check", "sanitizers"], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "missing: nothing" in done.stdout
    assert "sanitizers: skipped" in done.stdout
    assert "sanitizers: done" in done.stdout
    assert "start: not done" in done.stdout
    assert (tmp_path / "out" / "figures.json").exists()
    assert {p.name for p in (tmp_path / "kept").iterdir()} == {
        "figures.json", "figures.md", "log.tar.gz"
    }  # fmt: skip
    late = subprocess.run(
        [*script, "small"], env={**environment, "BUDGET": "1"}, capture_output=True,
        text=True,
    )  # fmt: skip
    assert "small: no time left for it" in late.stdout
    assert "small: not done" in late.stdout
    hanging = {**environment, "LIMIT": "1", "PYTHON": str(_sleeper(tmp_path))}
    stuck = subprocess.run([*script, "start"], env=hanging, capture_output=True, text=True)
    assert "start did not end well (124)" in stuck.stdout
    wrong = subprocess.run([*script, "cellar"], env=environment, capture_output=True, text=True)
    assert wrong.returncode == 2
    assert "no group cellar" in wrong.stdout
