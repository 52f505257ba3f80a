"""No splat reaches through the next wall, and floors are as deep as rays say."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.geometry import rotation_from_quaternion, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.scenes.charts import build_charts
from gn0.scenes.check import check_scene
from gn0.scenes.example import build_example_scene
from gn0.scenes.mesh import SceneMesh, join_meshes
from gn0.scenes.needles import find_needles
from gn0.scenes.procedural import refine_views
from gn0.scenes.shading import SurfaceSample
from gn0.scenes.surfels import build_surfels, outlines_of, place_surfels, shade_surfels


class Grey:
    """Every surface alike, or walls papered with fine stripes."""

    def __init__(self, mesh: SceneMesh, *, stripes: bool = False) -> None:
        self.corners, self.stripes = mesh.corners(), stripes
        self.normals = mesh.normals().astype(np.float32)

    def shade(self, face: np.ndarray, bary: np.ndarray) -> SurfaceSample:
        grey = np.full((len(face), 3), 0.5, np.float32)
        if self.stripes:
            at = np.einsum("mk,mki->mi", bary, self.corners[face])
            wall = np.abs(self.normals[face, 2]) < 0.5
            grey += (0.3 * wall * np.sign(np.sin(at.sum(axis=1) * 60.0)))[:, None]
        return SurfaceSample(grey, grey, grey, self.normals[face])


def mesh_of(vertices: np.ndarray, faces: list[tuple[int, int, int]]) -> SceneMesh:
    n = len(faces)
    return SceneMesh(
        np.asarray(vertices, np.float64), np.asarray(faces, np.int32),
        np.zeros((n, 3, 2), np.float32), np.zeros(n, np.int32), np.full(n, -1, np.int32),
    )  # fmt: skip


def skirting(x: float, y: float, width: float, z: float) -> SceneMesh:
    """The upper side of a skirting all round a room: four strips in one piece."""
    outer = [(0, 0), (x, 0), (x, y), (0, y)]
    w = width
    inner = [(w, w), (x - w, w), (x - w, y - w), (w, y - w)]
    points = [(*p, z) for p in (*outer, *inner)]
    faces = []
    for k in range(4):
        m = (k + 1) % 4
        faces += [(k, m, 4 + m), (k, 4 + m, 4 + k)]
    return mesh_of(np.array(points), faces)


def ends(cloud: GaussianCloud) -> np.ndarray:
    """Where splats end, two standard deviations out along both axes [N, 4, 3]."""
    axes = rotation_from_quaternion(cloud.quats)
    reach = 2.0 * cloud.scales[:, None, :2] * axes[:, :, :2]
    way = np.concatenate([reach, -reach], 2).transpose(0, 2, 1)
    return np.asarray(cloud.means[:, None] + way)


X, Y, WIDTH = 8.0, 5.0, 0.008


@pytest.fixture(scope="module")
def strip() -> GaussianCloud:
    """A skirting 8 mm wide round a hall, in a budget whose cells are centimetres wide."""
    floor = mesh_of(np.array([(0, 0, 0), (X, 0, 0), (X, Y, 0), (0, Y, 0)]), [(0, 1, 2), (0, 2, 3)])
    mesh = join_meshes([floor, skirting(X, Y, WIDTH, 0.1)])
    cloud = build_surfels(mesh, Grey(mesh), count=20_000)
    return cloud.select(np.flatnonzero(cloud.means[:, 2] > 0.05))


def test_a_skirting_round_a_hall_is_no_needle_through_its_wall(strip: GaussianCloud) -> None:
    at = ends(strip)[..., :2]
    beyond = np.maximum(0, np.maximum(-at, at - (X, Y))).max()
    assert beyond <= 0.10
    # nor across the room
    gap = np.minimum(at, np.array([X, Y]) - at).min(axis=2)
    assert gap.max() <= WIDTH + 0.10
    assert strip.scales.max() < 0.1


def test_the_whole_skirting_is_there(strip: GaussianCloud) -> None:
    """Also those parts that no sample of a cell lies on."""
    along = np.arange(0.1, X - 0.1, 0.05)
    for y in (WIDTH / 2, Y - WIDTH / 2):
        spots = np.stack([along, np.full(len(along), y)], 1)
        nearest = np.linalg.norm(strip.means[:, None, :2] - spots, axis=2).min(axis=0)
        assert nearest.max() < 0.05


def test_coarse_splats_end_at_most_ten_centimetres_beyond_their_face() -> None:
    panel = mesh_of(np.array([(0, 0, 1), (3, 0, 1), (3, 2, 1), (0, 2, 1)]), [(0, 1, 2), (0, 2, 3)])
    cloud = build_surfels(panel, Grey(panel), count=30)
    at = ends(cloud)[..., :2]
    assert cloud.scales.max() > 0.1  # coarse indeed
    assert np.maximum(-at, at - (3, 2)).max() <= 0.10 + 1e-5
    assert cloud.scales.max() <= 0.5


def test_the_splat_of_a_speck_lies_on_the_speck() -> None:
    """A bent flake, 2 mm by 0.2 mm: sunk along its slope, its splat came to lie beside it."""
    size = np.array([0.0021, 0.0002])
    (x, y), lift = size, 25e-6
    flake = np.array([(0, 0, 0), (x, 0, lift), (x, y, 0), (0, y, lift)])
    mesh = mesh_of(flake, [(0, 1, 2), (0, 2, 3)])
    cloud = build_surfels(mesh, Grey(mesh), count=1)
    at = ends(cloud)[..., :2]
    beyond = np.linalg.norm(np.maximum(0, np.maximum(-at, at - size)), axis=-1)
    assert beyond.max() <= size.max() + 1e-4  # one spacing: the flake is one cell
    assert (cloud.means[:, :2] >= -1e-6).all() and (cloud.means[:, :2] <= size + 1e-6).all()


def test_no_splat_of_a_refined_scene_reaches_too_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit that draws each splat as far as it may, on a skirting and a panel of coarse splats."""
    panel = mesh_of(np.array([(0, 0, 1), (3, 0, 1), (3, 2, 1), (0, 2, 1)]), [(0, 1, 2), (0, 2, 3)])
    mesh = join_meshes([panel, skirting(X, Y, WIDTH, 0.1)])
    placement = place_surfels(mesh, Grey(mesh), count=400)
    cloud, outlines = shade_surfels(placement, Grey(mesh)), outlines_of(placement)

    def overdo(cloud: GaussianCloud, **_: object) -> GaussianCloud:
        cloud = cloud.select(morton_order(cloud.means))
        aside = np.float32(0.02) * rotation_from_quaternion(cloud.quats)[:, :, 0]
        grown = cloud.scales * np.array([7.0, 2.5, 1.0], np.float32)
        return replace(cloud, means=(cloud.means + aside).astype(np.float32), scales=grown)

    monkeypatch.setattr(refine_views, "get_plugin", lambda *_: overdo)
    monkeypatch.setattr(refine_views, "place_views", lambda *_: ([np.eye(4)], [0]))
    monkeypatch.setattr(
        refine_views, "trace_picture", lambda *_, **__: np.zeros((480, 640, 3), np.uint8)
    )
    draft: Any = SimpleNamespace(mesh=mesh)
    fitted = refine_views.refine_draft(draft, Grey(mesh), cloud, outlines, area=1.0)
    assert len(fitted) == len(cloud)
    wild = find_needles(overdo(cloud))
    assert len(wild.long) > 10 and len(wild.bare) > 10
    needles = find_needles(fitted)
    assert not len(needles.long) and not len(needles.bare)
    low = fitted.means[:, 2] < 0.5
    assert (fitted.scales[low, 0] > 1.2 * cloud.scales.min()).all(), "none has dwindled to a dot"
    at, bounds = ends(fitted)[..., :2], np.where(low[:, None], (X, Y), (3.0, 2.0))[:, None]
    assert np.maximum(-at, at - bounds).max() <= 0.10 + 1e-5
    assert np.minimum(at, bounds - at).min(axis=2)[low].max() <= WIDTH + 0.10 + 1e-5


def test_floor_depth_reads_short_by_less_than_one_percent() -> None:
    """At the height of an eye, with splats 3 cm apart in the mean: it was 2 %, see the page."""
    shape = trimesh.creation.box((5, 5, 2.6))
    shape.apply_translation((0, 0, 1.3))
    shape.invert()
    room = mesh_of(shape.vertices, shape.faces.tolist())
    count = int(room.areas().sum() / 0.03**2)
    cloud = build_surfels(room, Grey(room, stripes=True), count=count, oriented=True)
    camera = Camera.from_hfov(640, 480, 79.0)
    views = [view_from_pose(-2.0, 0.3, 1.25, 0.1, -0.1), view_from_pose(1.0, -1.5, 1.25, 2.0, -0.1)]
    depth = RendererCpu(cloud).render(camera, np.stack(views), outputs=("depth",)).depth
    assert depth is not None
    x = (np.arange(640) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(480) + 0.5 - camera.cy) / camera.fy
    ray = np.stack([*np.meshgrid(x, y), np.ones((480, 640))], -1)
    errors = []
    for view, shown in zip(views, depth, strict=True):
        way = ray @ view[:3, :3]
        with np.errstate(divide="ignore"):
            true = np.where(way[..., 2] < 0, -1.25 / way[..., 2], np.inf)
        hit = -view[:3, :3].T @ view[:3, 3] + way * np.minimum(true, 99)[..., None]
        floor = np.isfinite(true) & (np.abs(hit[..., :2]) < 2.4).all(axis=2) & np.isfinite(shown)
        assert floor.sum() > 10_000
        errors.append((shown / true - 1)[floor])
    assert np.median(np.abs(np.concatenate(errors))) <= 0.008


def test_check_names_a_needle_and_a_giant() -> None:
    scene = build_example_scene(spacing=0.1)
    cloud = scene.gaussians
    assert not len(find_needles(cloud).long) and not len(find_needles(cloud).bare)
    scales, means = cloud.scales.copy(), cloud.means.copy()
    floor = np.flatnonzero(np.abs(means[:, 2]) < 0.02)
    scales[floor[7]] = (0.4, 0.002, 0.001)
    means[floor[7], 2] = 1.5  # in the air: nothing goes on where it ends
    scales[floor[9]] = (0.9, 0.002, 0.001)
    worse = replace(cloud, scales=scales, means=means)
    found = {
        f.code: f for f in check_scene(replace(scene, load_cloud=lambda: worse, cloud_hash=""))
    }
    assert f"#{floor[9]} at" in found["long-splats"].text
    assert f"#{floor[7]} at" in found["needle-splats"].text
    assert "σ 0.40 m" in found["needle-splats"].text
    assert found["needle-splats"].level == "warning" and found["needle-splats"].remedy


def test_check_lets_the_sky_be_coarse_but_names_a_needle_out_there() -> None:
    """Splats of 13 cm whose neighbours are half a metre off: a gap in a room, sky 12 m above it."""
    scene = build_example_scene(spacing=0.1)
    cloud = scene.gaussians
    middle = cloud.means.mean(axis=0)

    def named(height: float, sigma: float, apart: float) -> bool:
        """A row of three of them in the air over the room: is one named?"""
        means, scales, quats = cloud.means.copy(), cloud.scales.copy(), cloud.quats.copy()
        means[:3] = (*middle[:2], height)
        means[:3, 0] += np.array([-apart, 0, apart], np.float32)
        scales[:3], quats[:3] = (sigma, 0.02, 0.001), (1, 0, 0, 0)
        needles = find_needles(replace(cloud, means=means, scales=scales, quats=quats), scene.grid)
        return bool(np.isin(needles.bare, np.arange(3)).any())

    assert named(1.2, 0.13, 0.5)
    assert not named(14.0, 0.13, 0.5)
    assert named(14.0, 0.13, 3.0), "nothing at all goes on there"
    assert named(14.0, 0.45, 3.0)


def test_charts_keep_a_skirting_in_one_piece() -> None:
    """What makes the first test one: corners do not part the strips."""
    assert len(build_charts(skirting(X, Y, WIDTH, 0.1))) == 1
