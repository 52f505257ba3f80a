"""Levels of detail: what merging keeps of a person, and which level is chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gn0.avatars.avatar import Avatar
from gn0.avatars.bank import digest_avatar
from gn0.avatars.detail import (
    GRAIN,
    REACH_PX,
    SHARES,
    _even_sizes,
    _find_linings,
    build_levels,
    choose_level,
    diagonalise,
    merge_avatar,
)
from gn0.avatars.layer import PARTS
from gn0.avatars.poses import stride_pose
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import SkinWeights
from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.film import encode_srgb
from gn0.geometry import F64, rotation_from_quaternion, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.renderer import RenderOptions, RenderResult
from gn0_trials.people_small import small_person


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from((1.0, 1e-3, 1e-9, 0.0)))
def test_eigenvectors_give_the_matrix_again(seed: int, thin: float) -> None:
    stream = np.random.default_rng(seed)
    root = stream.normal(size=(20, 3, 3)) * (1.0, 1.0, thin)
    matrices = root @ root.transpose(0, 2, 1)
    values, vectors = diagonalise(matrices)
    again = vectors @ (values[:, :, None] * vectors.transpose(0, 2, 1))
    np.testing.assert_allclose(again, matrices, atol=1e-10 * max(matrices.max(), 1.0))
    np.testing.assert_allclose(np.linalg.det(vectors), 1.0, atol=1e-9)
    assert (np.diff(values, axis=1) <= 1e-12).all()


def test_eigenvectors_of_a_multiple_of_one_are_a_rotation() -> None:
    values, vectors = diagonalise(np.tile(2.0 * np.eye(3), (2, 1, 1)))
    np.testing.assert_array_equal(values, 2.0)
    np.testing.assert_allclose(np.linalg.det(vectors), 1.0)


def moments(avatar_cloud: GaussianCloud) -> tuple[F64, F64, F64]:
    """Mean, spread and mean colour, weighted by surface and opacity; splats have a width."""
    scales = avatar_cloud.scales.astype(np.float64)
    sizes = np.sort(scales, axis=1)
    weight = sizes[:, 1] * sizes[:, 2] * avatar_cloud.opacities
    weight /= weight.sum()
    mean = weight @ avatar_cloud.means
    own = (rotation_from_quaternion(avatar_cloud.quats) * scales[:, None, :]) ** 2
    spread = weight @ ((avatar_cloud.means - mean) ** 2 + own.sum(axis=2))
    return mean, spread, weight @ avatar_cloud.rgb()


def test_levels_have_their_counts_and_every_part() -> None:
    levels = build_levels(small_person())
    full = levels[0]
    assert full is small_person() and len(levels) == len(SHARES)
    for share, level in zip(SHARES[1:], levels[1:], strict=True):
        assert 0.9 * share * len(full) <= len(level) <= share * len(full) + 1
        large = [p for p in np.unique(full.part) if (full.part == p).sum() > 60]
        assert set(large) <= set(level.part.tolist()), [PARTS[p] for p in large]
        assert np.isfinite(level.points).all() and (level.scales > 0).all()
        np.testing.assert_allclose(np.linalg.norm(level.normals, axis=1), 1.0, atol=1e-4)
        np.testing.assert_allclose(level.weights.weight.sum(axis=1), 1.0)
        assert level.record == full.record


def test_what_becomes_one_splat_keeps_place_spread_and_colour() -> None:
    """To rounding, weighted by disc and opacity: a splat is the Gaussian of its group."""
    full, stream = small_person(), np.random.default_rng(4)
    for _ in range(5):
        some = stream.choice(len(full), 40, replace=False)
        joint = np.full((40, 4), stream.integers(0, 55), np.uint8)
        rows = {
            name: getattr(full, name)[some]
            for name in ("points", "normals", "quats", "scales", "opacities", "albedo")
        }
        group = replace(
            full, **rows, part=np.zeros(40, np.int32),
            weights=SkinWeights(joint, np.tile((1.0, 0.0, 0.0, 0.0), (40, 1))),
        )  # fmt: skip
        one = merge_avatar(group, 1)
        sizes = np.sort(group.scales.astype(np.float64), axis=1)
        share = sizes[:, 1] * sizes[:, 2] * group.opacities
        share /= share.sum()
        mean = share @ group.points
        away = group.points - mean
        spread = np.einsum("n,na,nb->ab", share, away, away)
        spread += np.einsum("n,nab->ab", share, covariances(group))
        assert len(one) == 1
        np.testing.assert_allclose(one.points[0], mean, atol=1e-5)
        np.testing.assert_allclose(covariances(one)[0], spread, atol=1e-4 * np.trace(spread))
        np.testing.assert_allclose(
            encode_srgb(one.albedo)[0], share @ encode_srgb(group.albedo), atol=1e-4
        )
        np.testing.assert_allclose(one.opacities, share @ group.opacities, atol=1e-5)


def covariances(avatar: Avatar) -> F64:
    """Of each splat [N, 3, 3] m²."""
    factor = rotation_from_quaternion(avatar.quats) * avatar.scales[:, None, :].astype(np.float64)
    return np.asarray(factor @ factor.transpose(0, 2, 1))


def test_merging_keeps_place_spread_and_colour_of_parts() -> None:
    """Weighted by disc and opacity; of skin by head and arms, as a face's splats are finer.

    Not of the whole person: parts give up more or less of their overlap. What is seen of the whole
    is below, in `test_levels_look_like_the_level_before_where_they_begin`. Linings are left out,
    as levels leave them out; they are told by how close splats lie where people are as shown.
    """
    full = small_person(0, 1.0)
    merged = merge_avatar(full, 6000)
    sizes = np.sort(full.scales.astype(np.float64), axis=1)
    own = _even_sizes(full.points.astype(np.float64), full.part)
    linings = _find_linings(own, sizes[:, 1] * sizes[:, 2], full.part)
    assert 0.01 < linings.mean() < 0.2
    before, after = (a.pose(stride_pose(), shadow=False) for a in (full, merged))
    compared = 0
    for name, (mine, theirs) in _pieces(full, merged).items():
        if mine.sum() < 200:
            continue
        (mean, spread, colour), (other, wide, shown) = (
            moments(before.select(mine & ~linings)), moments(after.select(theirs))
        )  # fmt: skip
        away = 0.05 if name.startswith("skin") else 0.01
        np.testing.assert_allclose(other, mean, atol=away, err_msg=name)
        np.testing.assert_allclose(wide, spread, rtol=0.15, atol=5e-5, err_msg=name)
        np.testing.assert_allclose(shown, colour, atol=0.02, err_msg=name)
        compared += 1
    assert compared >= 7


def test_strands_of_hair_are_no_lining_however_they_lie_over_each_other() -> None:
    """A lining weighs next to nothing: what is under hair came through at the coarsest level."""
    full = small_person(0, 1.0)
    hair = np.flatnonzero(full.part == PARTS.index("hair"))
    assert len(hair) > 300
    close = full.points.astype(np.float64)
    close[hair] = close[hair].mean(axis=0) + 0.2 * (close[hair] - close[hair].mean(axis=0))
    sizes = np.sort(full.scales.astype(np.float64), axis=1)
    own = _even_sizes(close, full.part)
    found = _find_linings(own, sizes[:, 1] * sizes[:, 2], full.part)
    assert found.any() and not found[hair].any()


def _pieces(*avatars: Avatar) -> dict[str, tuple[NDArray[np.bool_], ...]]:
    """Which splats of each avatar are of a part; skin by head and arms."""
    skin = PARTS.index("skin")
    found: dict[str, tuple[NDArray[np.bool_], ...]] = {
        name: tuple(avatar.part == k for avatar in avatars)
        for k, name in enumerate(PARTS)
        if k != skin
    }
    head = [INDEX[name] for name in ("neck", "head", "jaw")]
    found["skin of the head"] = tuple(
        (avatar.part == skin) & np.isin(avatar.weights.joint[:, 0], head) for avatar in avatars
    )
    found["skin of the arms"] = tuple(
        (avatar.part == skin) & (np.abs(avatar.points[:, 0]) > 0.2) for avatar in avatars
    )
    return found


def test_parts_do_not_mix() -> None:
    """Each merged splat's colour lies within the colours of its own part."""
    full, merged = small_person(), merge_avatar(small_person(), 600)
    for part in np.unique(merged.part):
        own, mixed = full.albedo[full.part == part], merged.albedo[merged.part == part]
        assert (mixed >= own.min(axis=0) - 1e-4).all() and (mixed <= own.max(axis=0) + 1e-4).all()


def test_merging_again_gives_the_same_bytes() -> None:
    one, two = (merge_avatar(small_person(), 700) for _ in range(2))
    assert digest_avatar(one) == digest_avatar(two)
    assert merge_avatar(one, len(one)) is one
    with pytest.raises(ConfigError, match="0 splats"):
        merge_avatar(one, 0)


@given(st.floats(0.1, 100.0), st.floats(0.1, 100.0), st.floats(30.0, 2000.0))
def test_farther_people_and_smaller_pictures_are_coarser(
    near: float, far: float, focal: float
) -> None:
    near, far = min(near, far), max(near, far)
    assert choose_level(near, focal) <= choose_level(far, focal)
    assert choose_level(near, 2 * focal) <= choose_level(near, focal)
    assert choose_level(0.0, focal) == 0 and choose_level(1e6, focal) == len(SHARES) - 1
    assert choose_level(far, focal) == choose_level(2 * far, 2 * focal)


def psnr(one: RenderResult, two: RenderResult) -> float:
    """Of colours where `one` is opaque [dB]."""
    assert one.alpha is not None and one.rgb is not None and two.rgb is not None
    inside = one.alpha > 0.95
    error = np.clip(one.rgb, 0, 1)[inside] - np.clip(two.rgb, 0, 1)[inside]
    return float(-10 * np.log10((error**2).mean()))


def seen(picture: RenderResult) -> tuple[F64, F64, F64, F64]:
    """Surface [V] px, middle and spread [V, 2] px of who is drawn, and mean colour [V, 3]."""
    assert picture.alpha is not None and picture.rgb is not None
    alpha = picture.alpha.astype(np.float64)
    rgb = picture.rgb - 0.5 * (1.0 - alpha[..., None])  # the background
    surface = alpha.sum((1, 2))
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in alpha.shape[:0:-1])), axis=-1)
    share = alpha[..., None] / surface[:, None, None, None]
    middle = (share * grid).sum((1, 2))
    spread = np.sqrt((share * (grid - middle[:, None, None]) ** 2).sum((1, 2)))
    return surface, middle, spread, rgb.sum((1, 2)) / surface[:, None]


def test_levels_look_like_the_level_before_where_they_begin() -> None:
    """Inside the outline; and more like the full person than as many of its splats by chance.

    All in all a person is where it was, as tall and as wide, and as light.
    """
    camera = Camera.from_hfov(160, 160, 90.0)
    levels = build_levels(small_person(density=1.0))
    clouds = [level.pose(stride_pose()) for level in levels]
    stream = np.random.default_rng(1)
    least = (0.0, 36.0, 32.0, 26.0, 23.0)  # dB
    for number in range(1, len(SHARES)):
        distance = 1.001 * GRAIN[number] * camera.fx / REACH_PX[number]
        assert choose_level(distance, camera.fx) == number
        views = np.stack(
            [
                view_from_pose(distance * np.cos(a), distance * np.sin(a), 1.2, a + np.pi)
                for a in (0.3, 2.0, 4.0)
            ]
        )
        chance = clouds[0].select(stream.permutation(len(clouds[0]))[: len(clouds[number])])
        full, before, here, some = (
            RendererCpu(cloud, RenderOptions(rgb_float=True)).render(
                camera, views, background=(0.5, 0.5, 0.5)
            )
            for cloud in (clouds[0], *clouds[number - 1 : number + 1], chance)
        )
        assert psnr(before, here) > least[number], number
        assert psnr(full, here) > psnr(full, some), number
        (surface, middle, spread, colour), (covered, at, wide, shown) = map(seen, (full, here))
        np.testing.assert_allclose(at, middle, atol=0.5, err_msg=str(number))  # half a pixel
        np.testing.assert_allclose(wide[:, 1], spread[:, 1], rtol=0.02, err_msg=str(number))
        np.testing.assert_allclose(wide[:, 0], spread[:, 0], rtol=0.05, err_msg=str(number))
        np.testing.assert_allclose(covered, surface, rtol=0.1, err_msg=str(number))
        np.testing.assert_allclose(shown, colour, atol=0.02, err_msg=str(number))
