"""Where sheets end, and how far discs keep from there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.avatars.layer import Layer
from gn0.avatars.rims import find_rim, keep_from_rim
from gn0.avatars.skinning import SkinWeights


def sheet(side: int = 9) -> Layer:
    """A metre square in z = 0, of `side` by `side` squares."""
    u, v = (a.ravel() / side for a in np.meshgrid(np.arange(side + 1), np.arange(side + 1)))
    at = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = (k.ravel() for k in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    return Layer(
        part="top",
        over=3.0,
        vertices=np.stack([u, v, 0.0 * u], 1),
        triangles=triangles,
        uv=np.zeros((len(triangles), 3, 2)),
        weights=SkinWeights(np.zeros((len(u), 1), np.uint8), np.ones((len(u), 1))),
    )


def test_a_rim_is_that_of_the_mesh_and_of_the_cut() -> None:
    whole = sheet()
    rim, ways = find_rim(whole, whole.vertices)
    out = np.abs(rim[:, :2] - 0.5).max(axis=1)
    assert np.allclose(out, 0.5) and len(rim) > 4 / 0.002
    assert np.allclose(np.sort(np.abs(ways), axis=1), (0, 0, 1))
    cut = replace(whole, cut=lambda p: p[:, 0] + 0.3 * p[:, 1] < 0.63)
    rim, ways = find_rim(cut, cut.vertices)
    across = rim[:, 0] + 0.3 * rim[:, 1] - 0.63
    inner = np.abs(across) < 1e-3
    assert across.max() < 1e-3 and np.allclose(np.abs(rim[~inner, :2] - 0.5).max(axis=1), 0.5)
    # all along it, without a hole
    height = np.sort(rim[inner, 1])
    assert height[0] < 0.01 and height[-1] > 0.99 and np.diff(height).max() < 0.0021
    # in another pose it is at the same places of the sheet
    posed = cut.vertices * (2.0, 1.0, 1.0) + (0.0, 0.0, 1.0)
    moved, _ = find_rim(cut, posed)
    assert np.abs(moved[:, 0] / 2 + 0.3 * moved[:, 1] - 0.63).min() < 1e-3
    assert (moved[:, 2] == 1).all()


def test_points_keep_from_a_rim_and_stay_on_their_sheet() -> None:
    stream = np.random.default_rng(0)
    points = np.column_stack([stream.uniform(0, 1, (4000, 2)), np.zeros(4000)])
    normals = np.tile((0.0, 0.0, 1.0), (4000, 1))
    whole = sheet()
    least, none = np.full(4000, 0.05), np.zeros((0, 3))
    moved = keep_from_rim(points, normals, find_rim(whole, whole.vertices), least)
    away = 0.5 - np.abs(moved[:, :2] - 0.5).max(axis=1)
    apart = 0.5 - np.abs(points[:, :2] - 0.5).max(axis=1)
    corner = (np.abs(points[:, :2] - 0.5) > 0.44).all(axis=1)  # which have two rims
    assert away[~corner].min() > 0.0499 and (moved[:, 2] == 0).all()
    assert (moved[apart > 0.051] == points[apart > 0.051]).all()
    assert np.linalg.norm(moved - points, axis=1).max() < 0.0501
    assert (keep_from_rim(points, normals, (none, none), least) == points).all()
