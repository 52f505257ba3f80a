"""Surfels look like the surfaces that they cover, within their budget, without holes."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import trimesh

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.film import decode_srgb, encode_srgb
from gn0.geometry import rotation_from_quaternion, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.renderer import RenderOptions
from gn0.scenes.charts import build_charts
from gn0.scenes.mesh import SceneMesh, join_meshes
from gn0.scenes.shading import SurfaceSample
from gn0.scenes.surfels import build_surfels
from gn0.scenes.truth import render_truth


def part(shape: trimesh.Trimesh, instance: int) -> SceneMesh:
    n = len(shape.faces)
    return SceneMesh(
        np.asarray(shape.vertices, np.float64),
        np.asarray(shape.faces, np.int32),
        np.zeros((n, 3, 2), np.float32),
        np.full(n, instance + 1, np.int32),
        np.full(n, instance, np.int32),
    )


@pytest.fixture(scope="module")
def room() -> SceneMesh:
    walls = trimesh.creation.box((4, 3, 2.6))
    walls.apply_translation((0, 0, 1.3))
    walls.invert()
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.35)
    ball.apply_translation((1.0, 0.3, 0.9))
    table = trimesh.creation.box((0.8, 0.6, 0.5))
    table.apply_translation((1.0, 0.3, 0.25))
    pole = trimesh.creation.cylinder(radius=0.03, height=1.6, sections=24)
    pole.apply_translation((1.3, -0.8, 0.8))
    return join_meshes([part(walls, -1), part(ball, 0), part(table, 1), part(pole, 2)])


class Waves:
    """A smooth pattern in space, one hue an object."""

    def __init__(self, mesh: SceneMesh) -> None:
        self.mesh = mesh

    def shade(self, face: np.ndarray, bary: np.ndarray) -> SurfaceSample:
        p = np.einsum("mk,mki->mi", bary, self.mesh.corners()[face])
        wave = 0.5 + 0.18 * np.sin(p @ np.array([9.0, 7.0, 5.0]))
        hue = np.array([[0.9, 0.9, 0.85], [0.9, 0.4, 0.3], [0.4, 0.7, 0.4], [0.3, 0.4, 0.9]])
        colour = (wave[:, None] * hue[self.mesh.material[face]]).astype(np.float32)
        normal = self.mesh.normals()[face].astype(np.float32)
        return SurfaceSample(decode_srgb(colour), np.ones_like(colour), colour, normal)


@pytest.fixture(scope="module")
def cloud(room: SceneMesh) -> GaussianCloud:
    return build_surfels(room, Waves(room), count=120_000, oriented=True)


def test_budget_shapes_and_labels(room: SceneMesh, cloud: GaussianCloud) -> None:
    assert 100_000 < len(cloud) <= 120_000
    assert cloud.scales.min() >= 0.001 - 1e-9
    assert cloud.opacities.min() > 0 and cloud.opacities.max() <= 1
    rgb = cloud.rgb()
    assert rgb.min() >= -1e-5 and rgb.max() <= 1 + 1e-5
    assert cloud.albedo is not None and cloud.irradiance is not None
    assert cloud.label is not None and set(np.unique(cloud.label)) == {-1, 0, 1, 2}
    normal = rotation_from_quaternion(cloud.quats)[:, :, 2]
    assert cloud.normal is not None
    assert (np.abs((normal * cloud.normal).sum(1)) > 0.9).mean() > 0.99


def test_discs_lie_on_the_surface(room: SceneMesh, cloud: GaussianCloud) -> None:
    surface = trimesh.Trimesh(room.vertices, room.faces, process=False)
    some = cloud.means[:: max(1, len(cloud) // 300)]
    _, distance, _ = trimesh.proximity.closest_point_naive(surface, some)
    assert np.quantile(distance, 0.99) < 0.006


def test_picture_matches_ray_tracing(room: SceneMesh, cloud: GaussianCloud) -> None:
    camera = Camera.from_hfov(640, 480, 79.0)
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    views = [
        view_from_pose(-1.5, 0.2, 1.25, 0.0, -0.1),
        view_from_pose(-0.5, -1.0, 1.25, 0.6, -0.1),
    ]
    shown = RendererCpu(cloud, RenderOptions(rgb_float=True)).render(camera, np.stack(views))
    for k, view in enumerate(views):
        truth, depth = render_truth(room, Waves(room), K, view, (640, 480), samples=2)
        assert shown.rgb is not None and shown.alpha is not None and shown.depth is not None
        error = np.clip(shown.rgb[k], 0, 1) - truth
        assert -10 * np.log10(np.mean(error**2)) > 31.0
        assert (shown.alpha[k] < 0.95).mean() < 1e-3
        assert np.median(np.abs(shown.depth[k] - depth)) < 0.01


def test_same_bytes_on_repeat_and_for_any_thread_count(room: SceneMesh) -> None:
    before = numba.get_num_threads()
    hashes = set()
    try:
        for threads in (1, before, before):
            numba.set_num_threads(threads)
            hashes.add(build_surfels(room, Waves(room), count=8_000, seed=3).content_hash)
    finally:
        numba.set_num_threads(before)
    assert len(hashes) == 1


def test_insides_of_touching_solids_cost_nothing(cloud: GaussianCloud) -> None:
    """The ball rests in the table's top; no disc of either is left inside the other."""
    assert cloud.label is not None
    top = cloud.means[cloud.label == 1]
    under_ball = (np.linalg.norm(top - np.array([1.0, 0.3, 0.9]), axis=1) < 0.33).sum()
    assert under_ball == 0


def test_thin_bevels_get_small_discs() -> None:
    """A strip thinner than any spacing becomes discs on the strip, not one over its bounds."""
    ring = trimesh.creation.annulus(r_min=0.499, r_max=0.5, height=0.0005, sections=64)
    mesh = part(ring, 0)
    cloud = build_surfels(mesh, Waves(mesh), count=300)
    assert cloud.scales.max() < 0.06
    assert np.linalg.norm(cloud.means[:, :2], axis=1).min() > 0.45


def test_charts_cover_every_face_once(room: SceneMesh) -> None:
    charts = build_charts(room)
    assert sorted(charts.faces) == list(range(len(room)))
    assert charts.area.sum() == pytest.approx(room.areas().sum())
    assert (charts.upper >= charts.lower).all()
    # the six walls, the table's six sides and the pole's two ends are flat; they keep whole
    flat = charts.bend == 0
    assert (charts.area[flat] > 2.0).sum() == 6


def test_a_mesh_without_area_is_refused() -> None:
    flat = SceneMesh(
        np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), np.zeros((1, 3, 2), np.float32),
        np.zeros(1, np.int32), np.zeros(1, np.int32),
    )  # fmt: skip
    with pytest.raises(SceneError, match="no surface"):
        build_surfels(flat, Waves(flat), count=10)


def test_srgb_round_trip() -> None:
    x = np.linspace(0, 1, 1001, dtype=np.float32)
    np.testing.assert_allclose(decode_srgb(encode_srgb(x)), x, atol=2e-6)
