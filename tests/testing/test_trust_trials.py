"""Trials of trust on small inputs; `gn0 figures trust` runs them at full length."""

from __future__ import annotations

import mmap
from pathlib import Path

import pytest
from numba.core import caching

from gn0.errors import StorageError
from gn0.jit import njit
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.storage import read_bytes
from gn0.suites.suite import Suite, build_suite
from gn0_trials.crash import crash_runs
from gn0_trials.disk_trials import run_disk_trials, why_no_small_disk
from gn0_trials.peak_memory import memory_bytes
from gn0_trials.soak import open_files, soak_simulators, soak_worker

needs_proc = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """Two scenes of ten episodes."""
    root = tmp_path_factory.mktemp("soak")
    for number, spacing in enumerate((0.1, 0.2)):
        scene = build_example_scene(spacing)
        object.__setattr__(scene, "id", f"flat{number}")
        save_scene(scene, root / scene.id)
    return build_suite([root / "flat0", root / "flat1"], root / "suite", 10, 0, max_steps=60)


@pytest.mark.slow
@needs_proc
def test_twenty_kills_lose_nothing_but_what_was_in_flight(tmp_path: Path) -> None:
    report = crash_runs(tmp_path, 20, seed=1)
    assert report.kills >= 20 and report.parents and report.workers
    assert report.ok, report


@pytest.mark.slow
def test_bad_disks_end_work_cleanly_and_it_goes_on_when_they_are_mended(tmp_path: Path) -> None:
    reason = why_no_small_disk(tmp_path)
    if reason:
        pytest.skip(f"this system lends no small disk: {reason}")
    trials = run_disk_trials(tmp_path, caches=False)
    assert len(trials) == 13
    assert [t for t in trials if not t.ok] == []
    assert {t.fault for t in trials} == {"full", "read-only", "failing read"}


@needs_proc
def test_a_failing_disk_is_told_as_such() -> None:
    with pytest.raises(StorageError, match="Input/output error") as caught:
        read_bytes("/proc/self/mem")
    assert "check the disk" in caught.value.remedy


def test_a_kernel_whose_cache_fails_still_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    failed = []

    def fail(*_: object) -> None:
        failed.append(True)
        raise OSError(28, "No space left on device")

    for name in ("save_overload", "load_overload"):
        monkeypatch.setattr(caching.Cache, name, fail)

    @njit(cache=True)
    def double(x: float) -> float:
        return 2.0 * x

    assert double(2.0) == 4.0
    assert failed


@pytest.mark.slow
@needs_proc
def test_many_resets_cost_no_memory_and_no_files(suite: Suite) -> None:
    soak = soak_simulators(suite, 3000)
    assert soak.growth <= 20e6 and soak.files == 0
    switched = soak_worker(suite, 30)
    assert switched.growth <= 20e6 and switched.files == 0


@needs_proc
def test_growth_and_open_files_are_seen(tmp_path: Path) -> None:
    memory, files = memory_bytes(), open_files()
    hoard = mmap.mmap(-1, 40_000_000)  # pages that are new, as what a process has freed is not
    hoard.write(b"x" * len(hoard))
    (tmp_path / "x").write_text("x")
    with open(tmp_path / "x"):
        assert open_files() == files + 1
    assert memory_bytes() - memory > 30e6
    hoard.close()
    assert open_files() == files
