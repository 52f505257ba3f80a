"""What a draft leaves out: fewer looks and look-ups, for nearly the same light."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from gn0.scenes.bake import BakeSettings, bake_light
from gn0.scenes.charts import build_charts, charts_of
from gn0.scenes.exposure import LEAST, weigh_views
from gn0.scenes.light_field import LightField
from gn0.scenes.lumels import build_lumels
from gn0.scenes.mesh import SceneMesh, join_meshes
from gn0.scenes.procedural.draft import Lamp
from gn0.scenes.rays import caster_of
from gn0.scenes.shading import ShaderOfGroups
from gn0.scenes.tone import BakedShader, ToneCurve


def plate(centre: tuple, along: tuple, across: tuple, parts: int = 4) -> SceneMesh:
    """A plate of 2 · parts² faces that looks along `along` × `across`."""
    a, b = np.array(along, float), np.array(across, float)
    step = np.linspace(-0.5, 0.5, parts + 1)
    v = np.array([np.array(centre) + s * a + t * b for s in step for t in step])
    low = np.array([i * (parts + 1) + j for i in range(parts) for j in range(parts)])
    one, two = low + parts + 1, low + parts + 2
    faces = np.concatenate([np.stack([low, one, two], 1), np.stack([low, two, low + 1], 1)])
    n = len(faces)
    return SceneMesh(
        v, faces.astype(np.int32), np.zeros((n, 3, 2), np.float32), np.zeros(n, np.int32),
        np.full(n, -1, np.int32),
    )  # fmt: skip


@pytest.fixture(scope="module")
def room() -> SceneMesh:
    """Six walls that look inwards, and a shelf in a corner."""
    x, y, z = (4, 0, 0), (0, 3, 0), (0, 0, 2.5)
    walls = [
        plate((2, 1.5, 0), x, y), plate((2, 1.5, 2.5), y, x),
        plate((2, 0, 1.25), z, x), plate((2, 3, 1.25), x, z),
        plate((0, 1.5, 1.25), y, z), plate((4, 1.5, 1.25), z, y),
        plate((0.4, 2.7, 1.0), (0.6, 0, 0), (0, 0.4, 0)),
    ]  # fmt: skip
    return join_meshes(walls)


class Stripes:
    """Albedo that differs from point to point, and no light of its own."""

    def reflect(self, face: np.ndarray, bary: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 0.2 + 0.6 * np.asarray(bary, np.float64), np.zeros((len(face), 3))


@pytest.fixture(scope="module")
def light(room: SceneMesh) -> Iterator[LightField]:
    lamp = Lamp(centre=(2, 1.5, 2.4), size=(0.4, 0.4), shape="rectangle", colour=(9, 8, 7))
    yield bake_light(room, Stripes(), [lamp], settings=BakeSettings(coarse=0.2, fine=0.1))


def places(room: SceneMesh, count: int = 500) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    face = rng.integers(len(room), size=count)
    return face, rng.dirichlet((1, 1, 1), count).astype(np.float32)


def test_finer_cells_of_the_search_find_the_same_light(room: SceneMesh) -> None:
    face, bary = places(room)
    point = np.einsum("nk,nki->ni", bary, room.corners()[face]).astype(np.float32)
    normal = room.normals()[face].astype(np.float32)
    one, two = (build_lumels(room, charts_of(room), 0.2, across=across) for across in (1, 2))
    assert len(one) == len(two) and one.radius == pytest.approx(two.radius)
    value = np.float32([[1, 2, 3]]) * (1 + one.point[:, :1])
    other = np.float32([[1, 2, 3]]) * (1 + two.point[:, :1])
    np.testing.assert_allclose(
        one.lookup(value, point, normal), two.lookup(other, point, normal), rtol=1e-5
    )
    near, far = one.nearest(point, normal), two.nearest(point, normal)
    assert (near >= 0).all()
    away = np.linalg.norm(one.point[near] - point, axis=1)
    np.testing.assert_allclose(away, np.linalg.norm(two.point[far] - point, axis=1), atol=1e-3)


@pytest.mark.parametrize(("across", "two_sided"), [(1, False), (1, True), (2, False)])
def test_the_nearest_lumel_has_the_largest_share(
    room: SceneMesh, across: int, two_sided: bool
) -> None:
    """Of all lumels, each asked what it brings to a point: none that was passed over says more."""
    face, bary = places(room)
    rng = np.random.default_rng(5)
    point = np.einsum("nk,nki->ni", bary, room.corners()[face])
    point = (point + rng.normal(0, 0.01, point.shape)).astype(np.float32)
    normal = room.normals()[face].astype(np.float32)
    lumels = build_lumels(room, charts_of(room), 0.2, two_sided=two_sided, across=across)
    shares = np.empty((len(point), len(lumels)), np.float32)
    for first in range(0, len(lumels), 3):
        alone = np.zeros((len(lumels), 3), np.float32)
        count = min(3, len(lumels) - first)
        alone[first : first + count, :count] = np.eye(count)
        shares[:, first : first + count] = lumels.lookup(alone, point, normal)[:, :count]
    found = lumels.nearest(point, normal)
    near = found >= 0
    np.testing.assert_array_equal(near, shares.max(1) > 0)
    assert near.mean() > 0.9
    assert (shares[near, found[near]] >= shares[near].max(1) * (1 - 1e-6)).all()


def test_merged_light_is_the_light(room: SceneMesh, light: LightField) -> None:
    """Looked up once instead of twice: a little smoother, not darker or brighter."""
    face, bary = places(room)
    point = np.einsum("nk,nki->ni", bary, room.corners()[face]).astype(np.float32)
    normal = room.normals()[face].astype(np.float32)
    exact, merged = (field.irradiance(point, normal) for field in (light, light.merged()))
    assert merged.mean() == pytest.approx(exact.mean(), rel=0.02)
    assert np.median(np.abs(merged - exact) / exact) < 0.05


def test_points_that_are_lit_together_keep_their_own_albedo(
    room: SceneMesh, light: LightField
) -> None:
    shader = BakedShader(room, Stripes(), light, ToneCurve())
    rng = np.random.default_rng(2)
    face = np.repeat(rng.integers(len(room), size=60), 4)
    corner = np.repeat(rng.dirichlet((2, 2, 2), 60), 4, axis=0)
    bary = (0.97 * corner + 0.03 * rng.dirichlet((1, 1, 1), 240)).astype(np.float32)
    alone, together = shader.shade(face, bary), ShaderOfGroups(shader, 4).shade(face, bary)
    np.testing.assert_array_equal(alone.albedo, together.albedo)
    np.testing.assert_array_equal(alone.normal, together.normal)
    lit = together.irradiance.reshape(-1, 4, 3)
    assert (lit == lit[:, :1]).all()
    np.testing.assert_allclose(lit.mean(1), alone.irradiance.reshape(-1, 4, 3).mean(1), rtol=0.05)


def test_pieces_of_surface_are_looked_at_instead_of_faces(room: SceneMesh) -> None:
    """All faces of a wall weigh the same, about as much as one by one; the hidden side nothing."""
    charts = build_charts(room)
    faces, pieces = weigh_views(room, seed=3), weigh_views(room, seed=3, charts=charts)
    areas = room.areas()
    owner = np.empty(len(room), int)
    owner[charts.faces] = np.repeat(np.arange(len(charts)), np.diff(charts.start))
    for chart in range(len(charts)):
        mine = owner == chart
        assert len(set(pieces[mine])) == 1
        assert pieces[mine][0] == pytest.approx(np.average(faces[mine], weights=areas[mine]), 0.35)
    buried = join_meshes([room, plate((2, 1.5, -0.5), (1, 0, 0), (0, 1, 0))])
    weight = weigh_views(buried, seed=3, charts=build_charts(buried))
    assert (weight[len(room) :] == LEAST).all()


def test_what_is_built_of_a_mesh_is_built_once(room: SceneMesh) -> None:
    assert charts_of(room) is charts_of(room)
    assert caster_of(room) is caster_of(room)
    assert charts_of(room.select(np.arange(8))) is not charts_of(room)
    assert room.normals() is room.normals()


def test_a_draft_plans_fewer_discs_than_it_may_have(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that placed too many would have to place all of them again."""
    from gn0.scenes.procedural import finish

    told: dict[str, object] = {}
    monkeypatch.setattr(finish, "charts_of", lambda mesh: "charts")
    monkeypatch.setattr(finish, "weigh_views", lambda _, **more: told.update(more) or np.ones(3))
    monkeypatch.setattr(finish, "place_surfels", lambda *_, **more: told.update(more))
    square = SimpleNamespace(polygon=((0, 0), (10, 0), (10, 10), (0, 10)))
    draft = SimpleNamespace(mesh=None, rooms=(square,), sky=None)
    finish.place_draft(draft, None, 500, quality="draft")  # type: ignore[arg-type]
    assert told["first"] < 1 and told["count"] == 500 and told["charts"] == "charts"
    finish.place_draft(draft, None, 500)  # type: ignore[arg-type]
    assert told["first"] == 1 and told["charts"] is None
