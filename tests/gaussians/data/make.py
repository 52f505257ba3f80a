"""Make the golden files again: needs `splat-transform` (npm @playcanvas/splat-transform) on PATH.

    python tests/gaussians/data/make.py

source.ply              260 Gaussians, SH 3, written by save_ply: two chunks, the last one short
theirs.compressed.ply   packed by splat-transform
theirs.decoded.ply      the same file decoded by splat-transform
ours.compressed.ply     packed by save_ply_packed
ours.decoded.ply        the same file decoded by splat-transform
"""

from __future__ import annotations

import subprocess
from pathlib import Path

from gn0.gaussians.ply import save_ply
from gn0.gaussians.ply_packed import save_ply_packed
from gn0_trials.splat_corpus import small_cloud

HERE = Path(__file__).resolve().parent


def splat_transform(source: str, target: str) -> None:
    subprocess.run(
        ["splat-transform", "-q", "-w", str(HERE / source), str(HERE / target)], check=True
    )


if __name__ == "__main__":
    cloud = small_cloud(260, degree=3, seed=7)
    save_ply(cloud, HERE / "source.ply", comments=["260 seeded Gaussians"])
    save_ply_packed(cloud, HERE / "ours.compressed.ply")
    splat_transform("source.ply", "theirs.compressed.ply")
    splat_transform("theirs.compressed.ply", "theirs.decoded.ply")
    splat_transform("ours.compressed.ply", "ours.decoded.ply")
