"""Another light changes colours alone, the same from everywhere, and by the numbers it names."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.config import check_config
from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.film import BRIGHTEST, decode_srgb, develop_film, encode_srgb, expose_film
from gn0.render.light import (
    LightCondition,
    condition_names,
    draw_condition,
    light_gain,
    planck_colour,
    relight_cloud,
)

LUMA = np.array([0.2126, 0.7152, 0.0722])


def cloud_of(colour: np.ndarray, degree: int = 0, **extra: np.ndarray) -> GaussianCloud:
    n = len(colour)
    rng = np.random.default_rng(n)
    sh = rng.normal(0, 0.05, (n, (degree + 1) ** 2, 3))
    sh[:, 0] = (colour - 0.5) / 0.28209479177387814
    quats = np.tile([1.0, 0, 0, 0], (n, 1))
    cloud = GaussianCloud(
        means=rng.normal(size=(n, 3)).astype(np.float32),
        quats=quats.astype(np.float32),
        scales=np.full((n, 3), 0.02, np.float32),
        opacities=np.full(n, 0.9, np.float32),
        sh=sh.astype(np.float32),
        **{k: v.astype(np.float32) for k, v in extra.items()},
    )
    return cloud


def baked(n: int = 400) -> GaussianCloud:
    rng = np.random.default_rng(3)
    albedo = rng.uniform(0.05, 0.85, (n, 3))
    irradiance = rng.lognormal(-1.0, 0.8, (n, 1)) * np.array([1.05, 1.0, 0.9])
    return cloud_of(develop_film(albedo * irradiance), albedo=albedo, irradiance=irradiance)


CONDITIONS = [draw_condition(5, "test", mood, mood=mood) for mood in condition_names()]


def test_a_neutral_condition_gives_the_very_same_cloud() -> None:
    cloud = baked()
    assert relight_cloud(cloud, LightCondition()) is cloud
    assert relight_cloud(cloud, LightCondition(name="noon")) is cloud


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda c: c.name)
@pytest.mark.parametrize(
    "cloud", [baked(), cloud_of(np.full((9, 3), 0.4), 3)], ids=["baked", "SH3"]
)
def test_geometry_opacity_and_labels_are_the_same_arrays(
    cloud: GaussianCloud, condition: LightCondition
) -> None:
    lit = relight_cloud(cloud, condition)
    for field in fields(cloud):
        if field.name not in ("sh", "irradiance"):
            assert getattr(lit, field.name) is getattr(cloud, field.name)
    assert np.isfinite(lit.sh).all() and not np.array_equal(lit.sh, cloud.sh)


def test_a_gain_on_spherical_harmonics_is_exact_from_every_direction() -> None:
    """k·c for every view-dependent colour c = 0.5 + Σ sh·Y: so 0.5 moves into the first term."""
    cloud = cloud_of(np.random.default_rng(0).uniform(0.1, 0.9, (50, 3)), 2)
    condition = LightCondition(exposure=-1.0, kelvin=3500)
    lit = relight_cloud(cloud, condition)
    basis = np.random.default_rng(1).normal(size=9)
    basis[0] = 0.28209479177387814
    before = 0.5 + np.einsum("k,nkc->nc", basis, cloud.sh.astype(float))
    after = 0.5 + np.einsum("k,nkc->nc", basis, lit.sh.astype(float))
    np.testing.assert_allclose(after, before * light_gain(condition) ** (1 / 2.2), atol=2e-6)


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda c: c.name)
def test_baked_scenes_are_lit_as_if_baked_again(condition: LightCondition) -> None:
    """Against albedo times the new light through the film curve, up to what it had clipped."""
    cloud = baked()
    plain = LightCondition(**{**_numbers(condition), "saturation": 1.0})
    lit = relight_cloud(cloud, plain)
    assert cloud.albedo is not None and lit.irradiance is not None
    again = develop_film(cloud.albedo * lit.irradiance)
    unclipped = (cloud.rgb() < 0.99).all(axis=1)
    assert unclipped.mean() > 0.7
    assert np.abs(lit.rgb() - again)[unclipped].max() < 2e-3


def test_each_splat_is_lit_alone_whoever_is_lit_beside_it() -> None:
    """To the bit; only contrast asks what light is usual in the scene."""
    cloud, condition = baked(20_001), LightCondition(exposure=0.7, kelvin=4000.0, saturation=0.8)
    whole = relight_cloud(cloud, condition)
    for some in (slice(0, 5), slice(8_190, 8_195), slice(20_000, 20_001), slice(3, None, 7)):
        part = relight_cloud(cloud.select(some), condition)
        assert part.sh.tobytes() == np.ascontiguousarray(whole.sh[some]).tobytes()
        assert part.irradiance is not None and whole.irradiance is not None
        assert (part.irradiance == whole.irradiance[some]).all()
    times, harder = 25, LightCondition(contrast=0.4)
    few, many = baked(), baked().select(np.tile(np.arange(400), times))
    lit = np.tile(relight_cloud(few, harder).sh, (times, 1, 1))
    assert np.abs(relight_cloud(many, harder).sh - lit).max() < 1e-5  # the same light is usual


def _numbers(condition: LightCondition) -> dict[str, float]:
    return {f: getattr(condition, f) for f in condition.__struct_fields__ if f != "name"}


def test_a_scene_that_was_never_filmed_keeps_the_srgb_curve() -> None:
    albedo = np.random.default_rng(2).uniform(0.05, 0.4, (200, 3))
    cloud = cloud_of(encode_srgb(albedo), albedo=albedo, irradiance=np.ones_like(albedo))
    lit = relight_cloud(cloud, LightCondition(exposure=1.0))
    np.testing.assert_allclose(decode_srgb(lit.rgb()), 2 * albedo, atol=2e-3)


@pytest.mark.parametrize("filmed", [True, False])
def test_splats_that_do_not_tell_which_curve_they_saw_are_not_asked_alone(filmed: bool) -> None:
    """Every fifth is black, as it is by either curve: then all others tell."""
    n = 40_960  # of which 8,192 would have told
    rng = np.random.default_rng(4)
    albedo, irradiance = rng.uniform(0.05, 0.85, (n, 3)), rng.uniform(0.1, 0.9, (n, 3))
    albedo[::5] = 0.0
    curve = develop_film if filmed else encode_srgb
    cloud = cloud_of(curve(albedo * irradiance), albedo=albedo, irradiance=irradiance)
    lit = relight_cloud(cloud, LightCondition(exposure=0.1))
    assert np.abs(lit.rgb() - curve(albedo * irradiance * 2.0**0.1))[1::5].max() < 2e-3


def test_contrast_zero_is_the_same_light_everywhere() -> None:
    lit = relight_cloud(baked(), LightCondition(contrast=0.0))
    assert lit.irradiance is not None
    level = lit.irradiance @ LUMA
    assert level.std() / level.mean() < 1e-3


def test_colour_of_light_does_not_change_its_brightness() -> None:
    for kelvin in (1500, 2500, 3999, 4001, 6500, 20000):
        assert light_gain(LightCondition(kelvin=kelvin)) @ LUMA == pytest.approx(1.0)
    warm, cool = (light_gain(LightCondition(kelvin=k)) for k in (2800, 9000))
    assert warm[0] > cool[0] and warm[2] < cool[2]
    daylight = planck_colour(6504) / planck_colour(6504).max()
    assert daylight.min() > 0.9  # D65 is white in sRGB, and the black body of 6504 K nearly so


def test_conditions_come_from_their_seed_and_names_alone() -> None:
    assert draw_condition(1, "flat", 3) == draw_condition(1, "flat", 3)
    drawn = {draw_condition(1, "flat", i) for i in range(60)}
    assert len(drawn) == 60 and {c.name for c in drawn} == set(condition_names())
    with pytest.raises(ConfigError, match="exposure"):
        check_config(LightCondition(exposure=9.0))


@given(st.floats(0, 1))
@settings(deadline=None)
def test_the_film_curve_is_inverted(display: float) -> None:
    exposed = expose_film(np.array([display]))
    assert 0 <= exposed[0] <= BRIGHTEST
    assert develop_film(exposed)[0] == pytest.approx(display, abs=3e-6)
