"""PlayCanvas's splat-transform as a judge of our compressed PLY, where it is installed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np

from gn0.gaussians.cloud import GaussianCloud

PACKAGE = "@playcanvas/splat-transform"


def find_splat_transform() -> list[str] | None:
    """How splat-transform is called here: on PATH, or through npx without a download."""
    if shutil.which("splat-transform"):
        return ["splat-transform"]
    if shutil.which("npx"):
        call = ["npx", "--no-install", PACKAGE]
        known = subprocess.run([*call, "--version"], capture_output=True, timeout=60)
        if known.returncode == 0:
            return call
    return None


def run_splat_transform(call: list[str], source: Path, target: Path, *actions: str) -> Path:
    """Convert `source` into `target`, with actions in between; returns `target`.

    Raises:
        subprocess.CalledProcessError: it refused.
    """
    command = [*call, "-q", "-w", str(source), *actions, str(target)]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    return target


def round_trip_errors(source: GaussianCloud, packed: GaussianCloud) -> dict[str, float]:
    """Root mean square errors by field of a packed cloud, given in the order of `source`.

    Positions [m], logs of scales, the angle between rotations [rad], SH DC, opacity, SH rest.
    """
    dots = np.abs((source.quats.astype(np.float64) * packed.quats).sum(axis=1))
    floor = np.float32(np.exp(-20.0))  # the least scale that the format stores
    errors = {
        "position": packed.means - source.means,
        "log scale": np.log(packed.scales) - np.log(np.maximum(source.scales, floor)),
        "rotation": 2 * np.arccos(np.clip(dots, 0, 1)),
        "SH DC": packed.sh[:, 0] - source.sh[:, 0],
        "opacity": packed.opacities - source.opacities,
    }
    if source.sh_degree:
        errors["SH rest"] = packed.sh[:, 1:] - source.sh[:, 1:]
    return {n: float(np.sqrt((e.astype(np.float64) ** 2).mean())) for n, e in errors.items()}
