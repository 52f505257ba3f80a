"""Refined apartments: photographs from where one can stand, and splats that come nearer to them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.renderer import RenderOptions
from gn0.scenes.procedural import refine_views
from gn0.scenes.procedural.apartment import draft_apartment
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.generate import GenerateSettings, build_generated
from gn0.scenes.procedural.refine_views import LENSES, place_views
from gn0.scenes.rays import RayCaster


@cache
def flat() -> tuple[SceneDraft, RayCaster]:
    draft = draft_apartment(3, size="small")
    return draft, RayCaster(draft.mesh)


def test_views_stand_free_and_are_repeatable() -> None:
    draft, caster = flat()
    views, lenses = place_views(draft, caster, 40, 5)
    again, _ = place_views(draft, caster, 40, 5)
    np.testing.assert_array_equal(views, again)
    assert set(lenses) == set(range(len(LENSES)))
    for view in views:
        eye = -view[:3, :3].T @ view[:3, 3]
        _, far, _ = caster.cast(
            np.repeat(eye[None], 4, 0), np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0.0]])
        )
        assert far.min() >= refine_views.CLEARANCE


def test_views_look_where_there_is_something_to_see() -> None:
    """Farther than a view to a random side does: the farthest of three is taken."""
    draft, caster = flat()
    views, _ = place_views(draft, caster, 60, 6)
    eyes = np.array([-view[:3, :3].T @ view[:3, 3] for view in views])
    ahead = np.array([view[2, :3] * (1, 1, 0) for view in views])
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    seen = np.minimum(caster.cast(eyes, ahead)[1], 6.0)
    angle = np.arange(12) * np.pi / 6
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    around = np.minimum(caster.cast(np.repeat(eyes, 12, 0), np.tile(ring, (60, 1)))[1], 6.0)
    assert seen.mean() > 1.25 * around.mean()


@pytest.mark.parametrize("index", range(len(LENSES)))
def test_photographs_are_taken_through_the_lens_that_is_named(index: int) -> None:
    intrinsics, size = refine_views._lens(index)
    width, height, hfov = LENSES[index]
    camera = Camera.from_hfov(width, height, hfov)
    assert size == (width, height)
    assert intrinsics[0, 0] == pytest.approx(camera.fx) and intrinsics[1, 1] == camera.fy
    assert (intrinsics[0, 2], intrinsics[1, 2]) == (camera.cx, camera.cy)


@pytest.mark.slow
def test_a_refined_apartment_is_nearer_to_its_photographs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer photographs and steps than `--refine` takes: enough to see it go the right way."""
    monkeypatch.setattr(refine_views, "VIEWS_PER_M2", 0.3)
    monkeypatch.setattr(refine_views, "STEPS_PER_M2", 2.0)
    taken = []
    trace = refine_views.trace_picture

    def watch(mesh, shader, intrinsics, size, view, rng, *, caster):  # type: ignore[no-untyped-def]
        taken.append((size, view, trace(mesh, shader, intrinsics, size, view, rng, caster=caster)))
        return taken[-1][2]

    monkeypatch.setattr(refine_views, "trace_picture", watch)
    settings = GenerateSettings(seed=3, size="small", density=5000, light="draft")
    plain = build_generated(settings, "plain").gaussians
    fitted_scene = build_generated(
        GenerateSettings(seed=3, size="small", density=5000, light="draft", refine=True), "fitted"
    )
    fitted = fitted_scene.gaussians
    assert fitted_scene.source.settings["refine"] is True
    assert len(fitted) == len(plain) and len(taken) > 10

    def error(cloud) -> float:  # type: ignore[no-untyped-def]
        renderer = RendererCpu(cloud, RenderOptions(rgb_float=True))
        total = []
        for (width, height), view, picture in taken:
            hfov = next(h for w, _, h in LENSES if w == width)
            shown = renderer.render(Camera.from_hfov(width, height, hfov), view, outputs=("rgb",))
            assert shown.rgb is not None
            total.append(np.mean((np.clip(shown.rgb[0], 0, 1) - picture / 255.0) ** 2))
        return float(np.mean(total))

    assert error(fitted) < 0.8 * error(plain)
