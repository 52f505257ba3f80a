"""The wheel holds the package and nothing of the checkout beside it."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_the_wheel_holds_no_figures_trials_or_tests(tmp_path: Path) -> None:
    wheel = pytest.importorskip(
        "hatchling.builders.wheel", reason="needs hatchling: pip install -e '.[dev]'"
    )
    path = next(wheel.WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"]))
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    rooms = {name.split("/")[1] for name in names if name.startswith("gn0/") and "/" in name}
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"gn0"}
    assert {"scenes", "render", "sim", "bench", "data", "testing", "py.typed"} <= rooms
    assert not {"figures", "trials", "tests"} & rooms
    assert not [name for name in names if "test_" in name or "__pycache__" in name]
    assert {".py", ".pyi", ".cu", ".cuh", ".js"} <= {Path(name).suffix for name in names}
    prompts = {name for name in names if name.startswith("gn0/policies/bae/prompts/")}
    folder = ROOT / "src" / "gn0" / "policies" / "bae" / "prompts"
    assert {Path(name).name for name in prompts} == {path.name for path in folder.iterdir()}
    assert "gn0/kernels/kernel_list.txt" in names, "an install could compile nothing ahead"
    weights = [path for path in (ROOT / "release").rglob("*") if path.is_file()]
    assert {f"gn0/release/{path.relative_to(ROOT / 'release')}" for path in weights} <= set(names)
    assert Path(path).stat().st_size < 60e6, "then the weights must lie outside of the wheel"
    assert all(one.stat().st_size <= 15e6 for one in weights)
