"""`generate_scene`: a seed becomes a scene folder, the same one each time, or a clear refusal."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from gn0.errors import ConfigError, StorageError
from gn0.scenes.folder import load_scene
from gn0.scenes.procedural import finish, generate
from gn0.scenes.procedural.draft import Sky
from gn0.scenes.procedural.generate import GenerateSettings, build_generated, generate_scene
from gn0.scenes.procedural.palette import Palette

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
        {"open_plan": "yes"},
    ],
)
def test_wrong_settings_are_refused_before_any_work(
    tmp_path: Path, wrong: dict[str, object]
) -> None:
    values = {f: getattr(QUICK, f) for f in QUICK.__struct_fields__}
    with pytest.raises(ConfigError):
        generate_scene(GenerateSettings(**{**values, **wrong}), tmp_path / "flat")
    assert not (tmp_path / "flat").exists()


def test_all_that_is_chosen_reaches_the_furnisher(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, object] = {}

    def draft(seed: int, **more: object) -> None:
        asked.update(more, seed=seed)
        raise ConfigError("asked")

    kinds = {"office": SimpleNamespace(draft=draft, density=1.0, version=1)}
    monkeypatch.setattr(generate, "KINDS", kinds)
    settings = GenerateSettings(kind="office", seed=8, size="large", style="classic")
    with pytest.raises(ConfigError, match="asked"):
        build_generated(settings, "office")
    assert asked == {"seed": 8, "size": "large", "style": "classic"}
    thin = msgspec.structs.replace(settings, without=("seats/chair/2",))
    with pytest.raises(ConfigError, match="asked"):
        build_generated(thin, "office")
    style = asked["style"]
    assert isinstance(style, Palette)
    assert (style.style.name, style.without) == ("classic", {"seats/chair/2"})


@pytest.mark.parametrize("outdoors", [False, True])
def test_gaussians_go_to_what_is_seen_from_as_far_as_one_sees(
    outdoors: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Walls round a yard are looked at from afar; a large hall by more cameras."""
    told: dict[str, object] = {}
    weight = np.array([finish.LEAST, 1.0, 2.0])

    def weigh_views(mesh: object, **more: object) -> np.ndarray:
        told.update(more)
        return weight

    monkeypatch.setattr(finish, "weigh_views", weigh_views)
    monkeypatch.setattr(finish, "place_surfels", lambda *_, **more: told.update(more))
    room = SimpleNamespace(polygon=((0, 0), (20, 0), (20, 15), (0, 15)))
    sky = Sky(zenith=(0.4, 0.5, 0.7), horizon=(0.6, 0.7, 0.8)) if outdoors else None
    draft = SimpleNamespace(mesh=None, rooms=(room,), sky=sky)
    finish.place_draft(draft, None, 500, seed=3)  # type: ignore[arg-type]
    assert told["sight"] == (finish.SIGHT_OUTDOORS if outdoors else finish.SIGHT)
    assert told["cameras"] == (finish.CAMERAS if outdoors else int(300 * finish.CAMERAS_PER_M2))
    assert told["count"] == 500 and told["detail"] is weight and told["oriented"]
    np.testing.assert_array_equal(told["unseen"], [True, False, False])
