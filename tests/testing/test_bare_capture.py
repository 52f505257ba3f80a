"""A scene written as a stranger's scan: every format, any frame, found again by the import."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gn0.cli.main import main
from gn0.errors import ConfigError, StorageError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.splat_files import load_cloud
from gn0.scenes.capture.pose import propose_pose
from gn0.scenes.capture.settings import CaptureSettings
from gn0.scenes.example import build_example_scene
from gn0.testing.bare_capture import FORMATS, BareSettings, save_bare_capture


@pytest.fixture(scope="module")
def flat() -> GaussianCloud:
    return build_example_scene().gaussians


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_holds_the_same_scan(suffix: str, flat: GaussianCloud, tmp_path: Path) -> None:
    """What a page writes with one suffix can be written with any other, and lies the same way."""
    path = tmp_path / f"scan{suffix}"
    frame = save_bare_capture(flat, path, BareSettings(tilt=8.0, scale=0.4, seed=3))
    read = load_cloud(path).cloud
    assert len(read) == len(flat)
    size = float(np.ptp(read.means, axis=0).max())
    back = 0.4 * (read.means.astype(np.float64) - frame.shift) @ frame.rotation
    np.testing.assert_allclose(back.min(axis=0), flat.means.min(axis=0), atol=1e-3 * size)
    np.testing.assert_allclose(back.max(axis=0), flat.means.max(axis=0), atol=1e-3 * size)


@pytest.mark.parametrize(("up", "tilt"), [("-y", 8.0), ("x", 0.0), ("-z", 20.0)])
def test_the_import_finds_the_frame(
    up: str, tilt: float, flat: GaussianCloud, tmp_path: Path
) -> None:
    settings = BareSettings(up=up, tilt=tilt, scale=0.5, seed=1)
    frame = save_bare_capture(flat, tmp_path / "scan.ply", settings)
    axis = np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    assert float(frame.rotation[:, 2] @ axis) == pytest.approx(math.cos(math.radians(tilt)))
    pose = propose_pose(load_cloud(tmp_path / "scan.ply").cloud, CaptureSettings(scale=0.5))
    assert float(pose.rotation[2] @ frame.rotation[:, 2]) > math.cos(math.radians(0.5))


def test_same_seed_same_bytes(flat: GaussianCloud, tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        save_bare_capture(flat, tmp_path / f"{name}.splat", BareSettings(seed=seed))
    a, b, c = ((tmp_path / f"{name}.splat").read_bytes() for name in "abc")
    assert a == b != c


def test_what_cannot_be_written_is_refused_before_any_work(
    flat: GaussianCloud, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def told(*arguments: str) -> str:
        assert main(["scene", "generate", *arguments]) == 2
        return capsys.readouterr().err

    out = tmp_path / "scan.splat"
    assert ".compressed.ply" in told("--as-capture", "--out", str(tmp_path / "folder"))
    assert "add --as-capture" in told("--capture-scale", "2", "--out", str(out))
    assert "up must be given" in told("--as-capture", "--capture-up", "auto", "--out", str(out))
    out.write_bytes(b"mine")
    assert "--overwrite" in told("--as-capture", "--out", str(out))
    assert out.read_bytes() == b"mine" and sorted(tmp_path.iterdir()) == [out]
    with pytest.raises(StorageError):
        save_bare_capture(flat, out, BareSettings())
    with pytest.raises(ConfigError):
        save_bare_capture(flat, tmp_path / "b.ply", BareSettings(scale=0.0))
