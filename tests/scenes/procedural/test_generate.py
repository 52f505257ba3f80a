"""`generate_scene`: a seed becomes a scene folder, the same one each time, or a clear refusal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gn0.errors import ConfigError, StorageError
from gn0.scenes.folder import load_scene
from gn0.scenes.procedural.generate import GenerateSettings, build_generated, generate_scene

QUICK = GenerateSettings(seed=5, size="small", density=2000, light="draft")


@pytest.mark.slow
def test_a_seed_becomes_a_scene_folder(tmp_path: Path) -> None:
    stages: list[str] = []
    scene = generate_scene(QUICK, tmp_path / "flat", progress=lambda s, a, b: stages.append(s))
    again = load_scene(tmp_path / "flat")
    assert again.content_hash == scene.content_hash
    assert again.id == "flat" and again.source.kind == "procedural" and again.source.seed == 5
    assert again.source.label_source == "generated" and again.licence == "CC0-1.0"
    assert {"furnishing", "light", "surfels"} <= set(stages)
    cloud = again.gaussians
    area = sum(
        np.ptp([p[0] for p in r.polygon]) * np.ptp([p[1] for p in r.polygon]) for r in again.rooms
    )
    assert 0.7 * 2000 * area < len(cloud) <= 2000 * area
    assert cloud.label is not None and cloud.albedo is not None and cloud.irradiance is not None
    assert cloud.label.max() < len(again.objects)
    assert (cloud.irradiance.max(axis=1) > 0).all()
    assert again.grid.free_area > 0.3 * area
    with pytest.raises(StorageError, match="not empty"):
        generate_scene(QUICK, tmp_path / "flat")
    twin = build_generated(QUICK, "twin")
    assert twin.gaussians.content_hash == scene.gaussians.content_hash or np.array_equal(
        np.sort(twin.gaussians.means[:, 0]), np.sort(scene.gaussians.means[:, 0])
    )


@pytest.mark.parametrize(
    "wrong",
    [
        {"density": 10.0},
        {"density": float("nan")},
        {"seed": -1},
        {"size": "huge"},
        {"kind": "ship"},
    ],
)
def test_wrong_settings_are_refused_before_any_work(
    tmp_path: Path, wrong: dict[str, object]
) -> None:
    values = {f: getattr(QUICK, f) for f in QUICK.__struct_fields__}
    with pytest.raises(ConfigError):
        generate_scene(GenerateSettings(**{**values, **wrong}), tmp_path / "flat")
    assert not (tmp_path / "flat").exists()
