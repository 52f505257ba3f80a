"""Baked light obeys physics where physics has a closed form, and is the same every time."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from gn0.scenes.bake import BakeSettings, bake_light
from gn0.scenes.light_field import LightField
from gn0.scenes.mesh import SceneMesh, join_meshes
from gn0.scenes.procedural.draft import Lamp, Sky, Sun
from gn0.scenes.tone import ToneCurve, choose_exposure

COARSE = BakeSettings(coarse=0.25, fine=0.12, rays=48, samples=16, bounces=24)


def panel(o: tuple, a: tuple, b: tuple, material: int = 0) -> SceneMesh:
    corner, along, across = (np.array(x, float) for x in (o, a, b))
    v = np.array([corner, corner + along, corner + along + across, corner + across])
    f = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)[f]
    return SceneMesh(v, f, uv, np.full(2, material, np.int32), np.full(2, -1, np.int32))


def closed_room(x: float, y: float, z: float, turned: bool = True) -> SceneMesh:
    """Six walls whose normals point inwards (or outwards)."""
    walls = [
        panel((0, 0, 0), (x, 0, 0), (0, y, 0)), panel((0, 0, z), (0, y, 0), (x, 0, 0)),
        panel((0, 0, 0), (0, 0, z), (x, 0, 0)), panel((0, y, 0), (x, 0, 0), (0, 0, z)),
        panel((0, 0, 0), (0, y, 0), (0, 0, z)), panel((x, 0, 0), (0, 0, z), (0, y, 0)),
    ]  # fmt: skip
    mesh = join_meshes(walls)
    if turned:
        return mesh
    return SceneMesh(
        mesh.vertices, mesh.faces[:, ::-1].copy(), mesh.uv, mesh.material, mesh.instance
    )


class Grey:
    """One albedo and one emission everywhere."""

    def __init__(self, albedo: float, emission: float = 0.0) -> None:
        self.albedo, self.emission = albedo, emission

    def reflect(self, face: np.ndarray, bary: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.full((len(face), 3), self.albedo), np.full((len(face), 3), self.emission)


@pytest.mark.parametrize("albedo", [0.0, 0.5, 0.8])
@pytest.mark.parametrize("turned", [True, False])
def test_furnace(albedo: float, turned: bool) -> None:
    """In a closed box that glows evenly with L, every point receives L / (1 − albedo)."""
    mesh = closed_room(3, 2, 2.5, turned)
    options = BakeSettings(
        coarse=0.25, fine=0.3, rays=32, bounces=60, glow=True, two_sided=not turned
    )
    light = bake_light(mesh, Grey(albedo, 0.7), [], settings=options)
    expected = 0.7 / (1 - albedo)
    np.testing.assert_allclose(light.bounced_value, expected, rtol=2e-3)
    assert not light.direct_value.any()


def irradiance_at(light: LightField, point: tuple, normal: tuple) -> np.ndarray:
    return light.irradiance(np.array([point], np.float32), np.array([normal], np.float32))[0]


def test_lamps_match_their_closed_forms() -> None:
    mesh = closed_room(6, 6, 3)
    ball = Lamp(centre=(3, 3, 1.5), size=(0.2, 0.2), shape="sphere", colour=(10, 20, 30))
    light = bake_light(mesh, Grey(0.0), [ball], settings=COARSE)
    # a far ball of radiance L and radius r: irradiance π L r² / d²; we store it over π
    seen = irradiance_at(light, (3, 3, 0), (0, 0, 1))
    np.testing.assert_allclose(seen, np.array([10, 20, 30]) * 0.1**2 / 1.5**2, rtol=0.05)
    flat = Lamp(centre=(3, 3, 2.9), size=(0.4, 0.3), shape="rectangle", colour=(5, 5, 5))
    light = bake_light(mesh, Grey(0.0), [flat], settings=COARSE)
    seen = irradiance_at(light, (3, 3, 0), (0, 0, 1))
    np.testing.assert_allclose(seen, 5 * 0.12 / (np.pi * 2.9**2), rtol=0.05)
    assert irradiance_at(light, (3, 3, 3), (0, 0, -1)).max() < 1e-3  # it shines down only


def test_sun_falls_through_the_open_side_only() -> None:
    mesh = join_meshes(
        [panel((0, 0, 0), (4, 0, 0), (0, 4, 0)), panel((0, 0, 2), (0, 4, 0), (2, 0, 0))]
    )
    sun = Sun(direction=(0, 0, -1), colour=(3, 3, 3))
    light = bake_light(mesh, Grey(0.5), [], sun, settings=COARSE)
    np.testing.assert_allclose(irradiance_at(light, (3, 2, 0), (0, 0, 1)), 3 / np.pi, rtol=0.05)
    assert irradiance_at(light, (1, 2, 0), (0, 0, 1)).max() < 0.1


def test_light_fades_into_corners_and_never_blows_up() -> None:
    mesh = closed_room(4, 3, 2.6)
    lamp = Lamp(centre=(2, 1.5, 2.55), size=(0.4, 0.4), shape="rectangle", colour=(12, 12, 12))
    light = bake_light(mesh, Grey(0.7), [lamp], settings=COARSE)
    middle = irradiance_at(light, (2, 1.5, 0), (0, 0, 1))
    corner = irradiance_at(light, (0.1, 0.1, 0), (0, 0, 1))
    assert (corner > 0).all() and (corner < middle).all()
    # all that is reflected came from the lamp: with albedo a, no more than 1 / (1 − a) times it
    straight = float((light.direct_value.mean(axis=1) * light.direct.area).sum())
    bounced = float((light.bounced_value.mean(axis=1) * light.bounced.area).sum())
    assert bounced == pytest.approx(straight * 0.7 / 0.3, rel=0.12)


def test_bake_is_the_same_bytes_for_any_thread_count() -> None:
    mesh = closed_room(3, 2, 2.5)
    lamp = Lamp(centre=(1, 1, 1.5), size=(0.2, 0.2), shape="sphere", colour=(9, 8, 7))
    before = numba.get_num_threads()
    results = []
    try:
        for threads in {1, before}:
            numba.set_num_threads(threads)
            light = bake_light(mesh, Grey(0.6), [lamp], settings=COARSE, seed=4)
            results.append((light.direct_value.tobytes(), light.bounced_value.tobytes()))
    finally:
        numba.set_num_threads(before)
    assert all(result == results[0] for result in results)


def test_tone_curve_rises_and_stays_in_range() -> None:
    ramp = np.repeat(np.linspace(0, 40, 4000)[:, None], 3, 1)
    shown = ToneCurve().display(ramp)
    assert shown.min() >= 0 and shown.max() <= 1
    assert (np.diff(shown[:, 0]) >= -1e-6).all()
    assert shown[0, 0] == 0 and shown[-1, 0] > 0.98


def test_exposure_undoes_the_lamp_strength() -> None:
    """A ten times stronger lamp gives the same picture."""
    mesh = closed_room(3, 2, 2.5)
    pictures = []
    for power in (1.0, 10.0):
        lamp = Lamp(centre=(1, 1, 2.0), size=(0.2, 0.2), shape="sphere", colour=(9 * power,) * 3)
        light = bake_light(mesh, Grey(0.6), [lamp], settings=COARSE)
        tone = choose_exposure(light)
        point = light.bounced.point
        exposed = 0.6 * light.irradiance(point, light.bounced.normal) * tone.exposure(point)
        pictures.append(tone.display(exposed))
    np.testing.assert_allclose(pictures[0], pictures[1], atol=5e-3)
    assert 0.25 < np.median(pictures[0]) < 0.75


def test_the_bar_moves_all_through_a_bake(monkeypatch: pytest.MonkeyPatch) -> None:
    """No loop over surfaces is one silent step; telling of it in parts changes no byte."""
    mesh = closed_room(4, 3, 2.5)
    lamp = Lamp(centre=(2, 1.5, 2.2), size=(0.4, 0.4), shape="rectangle", colour=(5, 5, 5))

    def bake(part: int) -> tuple[LightField, list[tuple[str, int, int]]]:
        monkeypatch.setattr("gn0.scenes.bake._PART", part)
        monkeypatch.setattr("gn0.scenes.bake._RAYS", part * COARSE.rays)
        monkeypatch.setattr("gn0.scenes.sky._CHUNK", part * COARSE.rays)
        said: list[tuple[str, int, int]] = []
        sky = Sky(zenith=(0.2, 0.3, 0.5), horizon=(0.5, 0.5, 0.5))
        light = bake_light(
            mesh, Grey(0.5), [lamp], sky=sky, settings=COARSE, seed=3,
            progress=lambda *step: said.append(step),
        )  # fmt: skip
        return light, said

    whole, _ = bake(10**6)
    light, said = bake(100)
    assert light.direct_value.tobytes() == whole.direct_value.tobytes()
    assert light.bounced_value.tobytes() == whole.bounced_value.tobytes()
    assert light.open_area.tobytes() == whole.open_area.tobytes()
    assert [done for stage, done, _ in said if stage == "light"] == list(range(8))
    counts = {
        "light of lamps": len(light.direct),
        "light between surfaces": len(light.bounced),
        "light of the sky": len(light.bounced),
    }
    for stage, count in counts.items():
        moved = [(done, total) for name, done, total in said if name == stage]
        assert count > 300
        assert moved == [(d, count) for d in (*range(0, count, 100), count)]
