"""Rays hit what an independent ray tracer hits, for any thread count."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import SceneError
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.rays import RayCaster


def mesh_of(shape: trimesh.Trimesh) -> SceneMesh:
    n = len(shape.faces)
    return SceneMesh(
        np.asarray(shape.vertices, np.float64),
        np.asarray(shape.faces, np.int32),
        np.zeros((n, 3, 2), np.float32),
        np.zeros(n, np.int32),
        np.full(n, -1, np.int32),
    )


@pytest.fixture(scope="module")
def clutter() -> SceneMesh:
    rng = np.random.default_rng(3)
    parts = [trimesh.creation.box((10, 8, 5))]
    for _ in range(25):
        part = trimesh.creation.icosphere(subdivisions=3, radius=rng.uniform(0.05, 0.5))
        part.apply_translation(rng.uniform((-4, -3, -2), (4, 3, 2)))
        parts.append(part)
    return mesh_of(trimesh.util.concatenate(parts))


def random_rays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    origin = rng.uniform((-4, -3, -2), (4, 3, 2), (count, 3)).astype(np.float32)
    direction = rng.normal(size=(count, 3)).astype(np.float32)
    return origin, direction / np.linalg.norm(direction, axis=1, keepdims=True)


def test_hits_agree_with_embree(clutter: SceneMesh) -> None:
    scene_module = pytest.importorskip("embreex.rtcore_scene")
    mesh_module = pytest.importorskip("embreex.mesh_construction")
    judge = scene_module.EmbreeScene()
    mesh_module.TriangleMesh(judge, clutter.vertices.astype(np.float32), clutter.faces)
    origin, direction = random_rays(200_000, 1)
    face, t, _ = RayCaster(clutter).cast(origin, direction)
    truth = judge.run(origin, direction, output=True)
    assert (face == truth["primID"]).mean() > 0.9999  # the rest meet an edge shared by two faces
    hit = face >= 0
    assert (hit == (truth["primID"] >= 0)).all()
    np.testing.assert_allclose(t[hit], truth["tfar"][hit], rtol=1e-4, atol=1e-4)


def test_weights_give_the_hit_point(clutter: SceneMesh) -> None:
    origin, direction = random_rays(5_000, 2)
    face, t, uv = RayCaster(clutter).cast(origin, direction)
    hit = face >= 0
    p = clutter.corners()[face[hit]]
    u, v = uv[hit].astype(np.float64).T[:, :, None]
    on_face = (1 - u - v) * p[:, 0] + u * p[:, 1] + v * p[:, 2]
    np.testing.assert_allclose(on_face, (origin + t[:, None] * direction)[hit], atol=2e-5)


def test_no_ray_leaves_a_closed_box_through_its_edges() -> None:
    mesh = mesh_of(trimesh.creation.icosphere(subdivisions=2, radius=1.0))
    targets = np.concatenate([mesh.vertices, mesh.corners().mean(axis=1), np.eye(3)])
    edges = (mesh.corners() + np.roll(mesh.corners(), 1, axis=1)).reshape(-1, 3) / 2
    direction = np.concatenate([targets, edges])
    face, _, _ = RayCaster(mesh).cast(np.zeros_like(direction), direction)
    assert (face >= 0).all()


def test_occlusion_is_a_hit_before_the_limit(clutter: SceneMesh) -> None:
    caster = RayCaster(clutter)
    origin, direction = random_rays(20_000, 4)
    _, t, _ = caster.cast(origin, direction)
    np.testing.assert_array_equal(caster.occluded(origin, direction, 1.5), t < 1.5)


def test_any_thread_count_gives_the_same_bytes(clutter: SceneMesh) -> None:
    caster = RayCaster(clutter)
    origin, direction = random_rays(30_000, 5)
    before = numba.get_num_threads()
    results = []
    try:
        for threads in {1, before}:
            numba.set_num_threads(threads)
            results.append([part.tobytes() for part in caster.cast(origin, direction)])
    finally:
        numba.set_num_threads(before)
    assert all(result == results[0] for result in results)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**31),
    st.sampled_from([(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 0.0)]),
)
def test_axis_rays_and_scaled_directions(seed: int, way: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(seed)
    mesh = mesh_of(trimesh.creation.box((2, 2, 2)))
    origin = rng.uniform(-0.9, 0.9, (1, 3))
    scale = float(rng.uniform(0.1, 10))
    _, t, _ = RayCaster(mesh).cast(origin, np.array([way]) * scale)
    d = np.array(way)
    reach = min((np.sign(d[k]) - origin[0, k]) / d[k] for k in range(3) if d[k])
    assert t[0] * scale == pytest.approx(reach, rel=1e-4, abs=1e-5)


def test_bad_meshes_are_refused() -> None:
    empty = SceneMesh(
        np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3, 2), np.float32),
        np.zeros(0, np.int32), np.zeros(0, np.int32),
    )  # fmt: skip
    with pytest.raises(SceneError, match="no faces"):
        RayCaster(empty)
    broken = mesh_of(trimesh.creation.box((1, 1, 1)))
    broken.vertices[0, 0] = np.nan
    with pytest.raises(SceneError, match="not finite"):
        RayCaster(broken)
