"""What furniture is made of: closed solids point outwards, uv are metres, nothing degenerates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.scenes.procedural.palette import WHITE, linear_colour
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_box,
    build_cylinder,
    build_extrusion,
    build_lathe,
    build_panel,
    build_tube,
    rounded_outline,
)
from gn0.scenes.procedural.shapes_soft import build_curtain, build_cushion, build_drape
from gn0.seeds import random_stream


def volume(shape: Shape) -> float:
    p = shape.vertices[shape.faces]
    return float((np.cross(p[:, 0], p[:, 1]) * p[:, 2]).sum() / 6)


SOLIDS = {
    "box": (build_box((1, 2, 0.5), WHITE), 1.0),
    "bevelled box": (build_box((1, 2, 0.5), WHITE, bevel=1e-4), 1.0),
    "cylinder": (build_cylinder(0.5, 1, WHITE, segments=256), math.pi / 4),
    "cone": (build_cylinder(0.5, 1, WHITE, top_radius=0.25, segments=256), math.pi * 0.4375 / 3),
    "ball": (build_ball(0.5, WHITE, segments=200), math.pi / 6),
    "prism": (build_extrusion(rounded_outline(1, 1, 0.0), 0.3, WHITE), 0.3),
    "tube": (build_tube([(0, 0, 0), (0, 0, 1)], 0.1, WHITE, sides=256), math.pi * 0.01),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_enclose_their_volume_with_normals_outwards(name: str) -> None:
    shape, expected = SOLIDS[name]
    assert volume(shape) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_soft_things_hang_and_swell(seed: int) -> None:
    """Cushions are closed; curtains and cloths are one sheet, seen from the front or above."""
    rng = random_stream(seed, "soft")
    cushion = build_cushion(0.45, 0.4, 0.15, WHITE)
    curtain = build_curtain(1.0, 2.2, WHITE, rng)
    drape = build_drape(1.4, 1.2, (0.2, 0.2, 0.1, 0.0), WHITE, rng)
    assert volume(cushion) > 0.005

    def facing(shape: Shape) -> np.ndarray:
        p = shape.vertices[shape.faces]
        return np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]).sum(axis=0) / 2

    assert facing(curtain)[1] == pytest.approx(-2.2, rel=0.1)
    assert facing(drape)[2] > 1.4
    assert curtain.vertices[:, 2].min() == pytest.approx(0.0, abs=0.01)
    assert drape.vertices[:, 2].min() < -0.15


@given(
    st.tuples(*[st.floats(0.05, 3)] * 3),
    st.floats(0, 0.4),
    st.integers(1, 3),
    st.integers(0, 2),
    st.floats(-4, 4),
)
def test_boxes_keep_their_size(
    size: tuple[float, float, float], bevel: float, steps: int, inner: int, yaw: float
) -> None:
    box = build_box(size, WHITE, at=(1, 2, 3), bevel=bevel, round_steps=steps, inner=inner)
    low, high = box.vertices.min(axis=0), box.vertices.max(axis=0)
    np.testing.assert_allclose(high - low, size, atol=1e-9)
    np.testing.assert_allclose(low + np.array([*(np.array(size[:2]) / 2), 0]), (1, 2, 3), atol=1e-9)
    assert 0 < volume(box) <= np.prod(size) * (1 + 1e-9)
    assert volume(box.moved(0.3, -0.2, 0.1, yaw)) == pytest.approx(volume(box), rel=1e-9)


def test_uv_are_metres_on_flat_faces() -> None:
    box = build_box((1.0, 0.5, 0.25), WHITE)
    p, t = box.vertices[box.faces], box.uv.astype(np.float64)
    edge = np.linalg.norm(p[:, 1] - p[:, 0], axis=1)
    np.testing.assert_allclose(np.linalg.norm(t[:, 1] - t[:, 0], axis=1), edge, atol=1e-6)
    fitted = build_panel((0, 0, 0), (2, 0, 0), (0, 0, 1), WHITE, fit=True)
    assert fitted.uv.min() == 0 and fitted.uv.max() == 1


def test_a_vessel_is_hollow() -> None:
    cup = build_lathe(
        [(0, 0), (0.04, 0), (0.04, 0.1), (0.036, 0.1), (0.036, 0.01), (0, 0.01)], WHITE
    )
    assert 0 < volume(cup) < math.pi * 0.04**2 * 0.1 * 0.4


def test_colours_are_linear() -> None:
    assert linear_colour("#ffffff") == (1.0, 1.0, 1.0)
    assert linear_colour("#808080")[0] == pytest.approx(0.2158, abs=1e-3)
