"""Benchmark runs on a card: what sees no pictures gives the CPU's results, to the byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from gn0.bench.runner import run_suite
from gn0.device.device import Device
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.suites.suite import build_suite, load_suite


@pytest.mark.parametrize("policy", ["oracle", "straight"])
def test_policies_without_pictures_give_the_cpus_results(
    card: Device, tmp_path: Path, policy: str
) -> None:
    save_scene(build_example_scene(), tmp_path / "flat")
    build_suite([tmp_path / "flat"], tmp_path / "suite", 8, 0)
    suite = load_suite(tmp_path / "suite")
    for backend in ("cuda", "auto", "cpu"):
        run_suite(suite, policy, tmp_path / backend, backend=backend, workers=2)
    run_suite(suite, policy, tmp_path / "beside", backend="cuda", agents=5)  # on the card
    results = {
        name: (tmp_path / name / "results.jsonl").read_bytes()
        for name in ("cuda", "auto", "cpu", "beside")
    }
    assert results["cuda"]
    assert results["cuda"] == results["auto"] == results["cpu"] == results["beside"]
