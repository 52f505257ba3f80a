"""The light of a scene on people: gains of known light, lamps found again, walls that hide it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.avatars.light import CELL, HEIGHTS, NORMALS, find_probes, fit_gains, place_probes
from gn0.avatars.light_sources import find_glow
from gn0.avatars.light_voxels import spread_directions
from gn0.errors import SceneError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.film import develop_film, encode_srgb, expose_film
from gn0.geometry import F64, quaternion_from_rotation
from gn0.maps.grid import OccupancyGrid
from gn0.render.light import LightCondition

STEP = 0.1  # between splats of a room [m]


def room(size: tuple[float, float, float], x0: float = 0.0) -> tuple[F64, F64]:
    """Points all over the inside of a box with a corner at (x0, 0, 0), and their normals."""
    points, normals = [], []
    for axis in range(3):
        a, b = [k for k in range(3) if k != axis]
        u, v = np.meshgrid(
            np.arange(STEP / 2, size[a], STEP), np.arange(STEP / 2, size[b], STEP), indexing="ij"
        )
        for side in (0, 1):
            p, n = np.zeros((u.size, 3)), np.zeros((u.size, 3))
            p[:, a], p[:, b], p[:, axis] = u.ravel(), v.ravel(), side * size[axis]
            n[:, axis] = 1.0 - 2.0 * side
            points.append(p)
            normals.append(n)
    return np.concatenate(points) + np.array([x0, 0.0, 0.0]), np.concatenate(normals)


def cover(points: F64, normals: F64, colour: F64) -> GaussianCloud:
    """Discs of display colours [N, 3] or [3]."""
    other = np.where(np.abs(normals[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    first = np.cross(normals, other)
    axes = np.stack([first, np.cross(normals, first), normals], axis=2)
    n = len(points)
    shown = np.broadcast_to(np.asarray(colour, np.float64), (n, 3))
    return GaussianCloud(
        means=points.astype(np.float32),
        quats=quaternion_from_rotation(axes).astype(np.float32),
        scales=np.tile(np.array([0.6 * STEP, 0.6 * STEP, 0.001], np.float32), (n, 1)),
        opacities=np.full(n, 0.99, np.float32),
        sh=((shown - 0.5) / SH_C0)[:, None].astype(np.float32),
        normal=normals.astype(np.float32),
    )


def floor_of(width: float, depth: float) -> OccupancyGrid:
    return OccupancyGrid(
        np.zeros((round(depth * 10), round(width * 10)), np.uint8), 0.1, (0.0, 0.0)
    )


@settings(max_examples=40, deadline=None)
@given(st.floats(0.02, 3.0), st.booleans())
def test_even_light_has_an_even_gain_that_shows_grey_as_the_scene_does(
    level: float, film: bool
) -> None:
    gain = fit_gains(np.full((1, len(NORMALS), 3), level), film=film)[0]
    np.testing.assert_allclose(gain[1:], 0.0, atol=1e-4 * max(level, 1.0))
    curve = develop_film if film else encode_srgb
    for grey in (0.1, 0.2, 0.4):
        wanted = float(curve(np.array(grey * level)))
        shown = min(float(gain[0, 0] * encode_srgb(np.array(grey))), 1.0)
        assert abs(shown - wanted) < 0.18  # one factor for all greys: film is not a power


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-2.0, 2.0))
def test_exposure_is_more_light(seed: int, stops: float) -> None:
    light = np.random.default_rng(seed).uniform(0, 2, (3, len(NORMALS), 3))
    brighter = fit_gains(light, LightCondition(exposure=stops))
    np.testing.assert_allclose(brighter, fit_gains(light * 2.0**stops), atol=1e-5)
    np.testing.assert_array_equal(fit_gains(light, LightCondition(name="same")), fit_gains(light))
    even = fit_gains(np.tile(light[:1], (3, 1, 1)), LightCondition(contrast=0.0))
    np.testing.assert_allclose(even, np.tile(even[:1], (3, 1, 1)))
    grey = fit_gains(light, LightCondition(saturation=0.0))
    np.testing.assert_allclose(grey, np.repeat(grey[:, :, :1], 3, axis=2), atol=1e-5)


def test_light_from_one_side_falls_on_that_side() -> None:
    light = np.maximum(NORMALS @ np.array([0.0, 1.0, 0.0]), 0.0)[None, :, None] + np.full(3, 0.2)
    gain = fit_gains(light)[0]
    assert gain[2, 0] > 0.2 and np.abs(gain[[1, 3], 0]).max() < 0.03


def test_a_room_of_one_colour_lights_people_with_it() -> None:
    """Colours are light where nothing else is known: a furnace, as bright from everywhere."""
    light = np.array([0.5, 0.3, 0.1])
    cloud = cover(*room((4.0, 3.0, 2.6)), encode_srgb(light).astype(np.float64))
    probes = find_probes(cloud, floor_of(4.0, 3.0), cache=False)
    np.testing.assert_allclose(probes.light.mean(axis=(0, 1, 2)), light, rtol=0.03)
    np.testing.assert_allclose(probes.gain_at(2.0, 1.5)[1:], 0.0, atol=0.02)
    assert not probes.film


def test_a_lamp_that_the_film_has_cut_off_is_as_strong_as_its_light() -> None:
    """A panel on the ceiling of a dark room, of radiance 30 where the film ends at 6.4."""
    size, strength, side = (4.0, 4.0, 2.5), 30.0, 0.4
    points, normals = room(size)
    ceiling = (normals[:, 2] < -0.5) & (np.abs(points[:, :2] - 2.0) < side / 2).all(axis=1)
    away = points[:, None] - points[None, ceiling]
    far = np.maximum(np.linalg.norm(away, axis=2), 1e-6)
    leaves, meets = -away[:, :, 2] / far, -np.einsum("nka,na->nk", away, normals) / far
    seen = np.maximum(leaves, 0) * np.maximum(meets, 0) / np.maximum(far, 0.1) ** 2
    irradiance = strength * seen.sum(axis=1) * STEP**2 / np.pi
    albedo = 0.05
    shown = develop_film(np.where(ceiling, strength, albedo * irradiance))
    n = len(points)
    cloud = replace(
        cover(points, normals, np.repeat(shown[:, None], 3, axis=1).astype(np.float64)),
        albedo=np.full((n, 3), albedo, np.float32),
        irradiance=np.repeat(irradiance[:, None], 3, axis=1).astype(np.float32),
    )
    assert cloud.albedo is not None and cloud.irradiance is not None
    exposed = expose_film(np.clip(cloud.rgb(), 0, 1))
    glows = find_glow(cloud, exposed, (cloud.albedo * cloud.irradiance).astype(np.float64))
    np.testing.assert_array_equal(glows, ceiling)
    probes = find_probes(cloud, floor_of(4.0, 4.0), cache=False)
    assert probes.film
    # under the lamp, 1.25 m up, facing up: as the panel shines straight on it
    column = int(np.argmin(((probes.places - 2.0) ** 2).sum(axis=1)))
    at = np.array([*probes.places[column], HEIGHTS[2]])
    away = at - points[ceiling]
    far = np.linalg.norm(away, axis=1)
    truth = strength * ((-away[:, 2] / far) ** 2 / far**2).sum() * STEP**2 / np.pi
    up = int(np.argmax(NORMALS[:, 2]))
    assert abs(probes.light[column, 2, up, 0] / truth - 1.0) < 0.15


def test_the_light_of_the_next_room_does_not_come_through_the_wall() -> None:
    """A bright room, a wall of 0.1 m, a dark room."""
    (p, n), (q, m) = room((2.95, 3.0, 2.6)), room((2.95, 3.0, 2.6), x0=3.05)
    colour = np.concatenate([np.full((len(p), 3), 0.9), np.full((len(q), 3), 0.2)])
    cloud = cover(np.concatenate([p, q]), np.concatenate([n, m]), colour)
    cells = np.zeros((30, 60), np.uint8)
    cells[:, 29:31] = 1
    probes = find_probes(cloud, OccupancyGrid(cells, 0.1, (0.0, 0.0)), cache=False)
    bright, dark = (probes.gain_at(x, 1.5)[0, 0] for x in (1.5, 4.5))
    assert bright > 3 * dark
    for x in (2.75, 2.85):
        assert abs(probes.gain_at(x, 1.5)[0, 0] - bright) < 0.15 * bright
    for x in (3.15, 3.25):
        assert abs(probes.gain_at(x, 1.5)[0, 0] - dark) < 0.3 * dark


def test_probes_stand_on_free_floor() -> None:
    cells = np.ones((40, 50), np.uint8)
    cells[7:33, 12:29] = 0
    grid = OccupancyGrid(cells, 0.1, (-1.0, 2.0))
    places, column = place_probes(grid)
    assert all(grid.is_free(x, y) for x, y in places)
    cell = np.floor((places - grid.origin) / CELL).astype(int)
    assert (column[cell[:, 0], cell[:, 1]] == np.arange(len(places))).all()
    assert (column >= 0).sum() == len(places)
    with pytest.raises(SceneError, match="no cell of the map is free"):
        place_probes(OccupancyGrid(np.ones((4, 4), np.uint8), 0.1, (0.0, 0.0)))


def test_probes_come_from_the_cache_and_are_found_again_when_it_is_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path))
    cloud = cover(*room((2.0, 2.0, 2.4)), np.array([0.6, 0.5, 0.4]))
    first = find_probes(cloud, floor_of(2.0, 2.0))
    (path,) = (tmp_path / "people_light").glob("*.npz")
    again = find_probes(cloud, floor_of(2.0, 2.0))
    np.testing.assert_array_equal(first.light, again.light)
    path.write_bytes(path.read_bytes()[:100])
    third = find_probes(cloud, floor_of(2.0, 2.0))
    np.testing.assert_array_equal(first.light, third.light)
    assert find_probes(cloud, floor_of(2.0, 2.1)).digest != first.digest


def test_directions_are_even() -> None:
    ways = spread_directions(256)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 1.0)
    np.testing.assert_allclose(ways.mean(axis=0), 0.0, atol=5e-3)
    np.testing.assert_allclose(ways.T @ ways / 256, np.eye(3) / 3, atol=5e-3)
