"""Light of the open sky: exact on a bare plain, halved beside a wall, blue in the shade."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.scenes.bake import BakeSettings, bake_light
from gn0.scenes.charts import build_charts
from gn0.scenes.lumels import build_lumels
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.procedural.assembly import Assembly
from gn0.scenes.procedural.courtyard import build_vault
from gn0.scenes.procedural.draft import Material, SceneDraft, Sky, Sun
from gn0.scenes.procedural.finish import cover_draft, light_draft
from gn0.scenes.procedural.palette import plain
from gn0.scenes.procedural.shapes import build_box, build_panel
from gn0.scenes.rays import RayCaster
from gn0.scenes.scene import SceneRoom
from gn0.scenes.sky import find_vault, gather_sky, sky_radiance

EVEN = Sky(zenith=(0.5, 0.6, 0.8), horizon=(0.5, 0.6, 0.8))
COARSE = BakeSettings(coarse=1.0, fine=1.0, rays=32, bounces=1)
MATT = plain("matt", "paint", "#808080", contrast=0.0)


def yard_mesh(*, wall: bool) -> SceneMesh:
    assembly = Assembly()
    assembly.add_shell(build_panel((-20, -20, 0), (40, 0, 0), (0, 40, 0), MATT))
    if wall:  # endless for a lumel at its foot
        assembly.add_shell(build_panel((-20, 0, 0), (40, 0, 0), (0, 0, 60), MATT))
    return assembly.finish()[0]


class Black:
    """A surface that reflects nothing."""

    def reflect(self, face: np.ndarray, bary: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((len(face), 3)), np.zeros((len(face), 3))


def test_a_bare_plain_gets_the_whole_sky() -> None:
    mesh = yard_mesh(wall=False)
    lumels = build_lumels(mesh, build_charts(mesh), 2.0)
    light, share = gather_sky(lumels, RayCaster(mesh), EVEN, 64, seed=3)
    np.testing.assert_allclose(light, np.tile(EVEN.zenith, (len(light), 1)), rtol=1e-5)
    np.testing.assert_array_equal(share, 1.0)


def test_a_wall_takes_half_of_it() -> None:
    mesh = yard_mesh(wall=True)
    lumels = build_lumels(mesh, build_charts(mesh), 1.0)
    light, share = gather_sky(lumels, RayCaster(mesh), EVEN, 128, seed=3)
    up = (lumels.normal[:, 2] > 0.9) & (lumels.point[:, 1] < -0.3) & (lumels.point[:, 1] > -1.2)
    middle = up & (np.abs(lumels.point[:, 0]) < 6)
    assert middle.any()
    assert share[middle].mean() == pytest.approx(0.5, abs=0.05)
    np.testing.assert_allclose(light[middle].mean(axis=0), 0.5 * np.array(EVEN.zenith), rtol=0.1)


def test_rays_below_the_horizon_bring_nothing() -> None:
    np.testing.assert_array_equal(sky_radiance(EVEN, np.array([[0.0, 0.8, -0.6]])), 0.0)


@given(
    height=st.floats(0.0, 1.0),
    turn=st.floats(0.0, 6.28),
    zenith=st.tuples(*[st.floats(0, 4)] * 3),
    horizon=st.tuples(*[st.floats(0, 4)] * 3),
)
@settings(max_examples=60, deadline=None)
def test_the_sky_lies_between_zenith_and_horizon(height, turn, zenith, horizon) -> None:  # type: ignore[no-untyped-def]
    flat = math.sqrt(1 - height * height)
    way = np.array([[flat * math.cos(turn), flat * math.sin(turn), height]])
    got = sky_radiance(Sky(zenith=zenith, horizon=horizon), way)[0]
    low, high = np.minimum(zenith, horizon), np.maximum(zenith, horizon)
    if height > 0:
        assert (got >= low - 1e-9).all() and (got <= high + 1e-9).all()


def test_a_bake_adds_the_sky_and_without_one_is_dark() -> None:
    mesh = yard_mesh(wall=False)
    point = np.array([[1.0, 2.0, 0.0]], np.float32)
    up = np.array([[0.0, 0.0, 1.0]], np.float32)
    lit = bake_light(mesh, Black(), [], sky=EVEN, settings=COARSE)
    dark = bake_light(mesh, Black(), [], settings=COARSE)
    np.testing.assert_allclose(lit.irradiance(point, up)[0], EVEN.zenith, rtol=1e-4)
    np.testing.assert_array_equal(dark.irradiance(point, up), 0.0)
    assert lit.open_area.sum() > 0  # what faces the sky counts for the exposure


@pytest.fixture(scope="module")
def small_yard() -> SceneDraft:
    """Six metres of grey ground, a wall along its south side, the sun from the south, a sky."""
    assembly = Assembly()
    assembly.add_shell(build_panel((-3, -3, 0), (12, 0, 0), (0, 12, 0), MATT))
    assembly.add_shell(build_box((6.0, 0.3, 3.0), MATT, at=(3.0, 0.15, 0)))
    heaven = Material(
        name="sky", pattern="open_sky", colour=(0.1, 0.3, 0.7), colour2=(0.6, 0.7, 0.9),
        contrast=0.0, detail=0.3,
    )  # fmt: skip
    assembly.add_shell(build_vault(6.0, 6.0, heaven))
    mesh, materials = assembly.finish()
    room = SceneRoom("yard", "yard", ((0, 0), (6, 0), (6, 6), (0, 6)))
    return SceneDraft(
        mesh=mesh, materials=materials, objects=(), rooms=(room,), walls=(), openings=(), lamps=(),
        sun=Sun(direction=(0.0, 0.7071, -0.7071), colour=(8.0, 7.0, 6.0)), ceiling=3.0,
        sky=Sky(zenith=(0.3, 0.4, 0.7), horizon=(0.5, 0.6, 0.8), shown=2.0),
    )  # fmt: skip


def test_a_yard_is_sunny_shady_and_under_a_blue_sky(small_yard: SceneDraft) -> None:
    shader = light_draft(small_yard, quality="draft")
    cloud = cover_draft(small_yard, shader, 9_000)
    assert cloud.irradiance is not None and cloud.albedo is not None
    high = cloud.means[:, 2] > 8.0
    assert high.sum() > 100  # the vault is there, although no lamp lights it
    colour = cloud.sh[:, 0] * 0.28209479 + 0.5
    mean = colour[high].mean(axis=0)
    assert mean[2] > mean[0] + 0.1  # and blue, but for the clouds
    ground = np.abs(cloud.means[:, 2]) < 0.05
    x, y = cloud.means[:, 0], cloud.means[:, 1]
    shade = ground & (y > 0.8) & (y < 2.0) & (np.abs(x - 3) < 1.5)
    sun = ground & (y > 4.5) & (y < 6.0) & (np.abs(x - 3) < 1.5)
    assert shade.any() and sun.any()
    lit = {
        name: cloud.irradiance[mask].mean(axis=0) for name, mask in (("shade", shade), ("sun", sun))
    }
    assert lit["sun"][1] > 2.0 * lit["shade"][1]
    assert lit["shade"][1] > 0.05 * lit["sun"][1]  # the sky fills shadows
    bluer = lit["shade"][2] / lit["shade"][0] - lit["sun"][2] / lit["sun"][0]
    assert bluer > 0.2
    vault = find_vault(small_yard.mesh, small_yard.materials)
    assert 0 < vault.sum() < len(vault)
