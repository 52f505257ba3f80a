"""The drawing kernels in the host emulation: the CPU renderer's pictures, within rounding."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import view_from_above, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.pack import choose_splats, upload_cloud
from gn0.render.renderer import RenderOptions, RenderResult
from gn0.testing.renderer_check import psnr, random_cloud
from gn0_figures.flat import build_flat, flat_bev, flat_camera, flat_views

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

EXACT = RenderOptions(rgb_float=True)
BLACK = np.zeros(3, np.float32)


def draw(cloud, camera, views, options=EXACT, *, extra=None, seed=0, **more) -> RenderResult:
    """Pictures of the emulated device; `more` goes to the Drawer."""
    device = DeviceHost(seed)
    drawer = Drawer(device, **more)
    matrices = views.reshape(-1, 4, 4)
    pictures = drawer.pictures(
        camera, len(matrices), ("rgb", "depth", "alpha"), rgb_float=options.rgb_float
    )
    tails = [] if extra is None else [upload_cloud(device, extra, sort=False)]
    drawer.draw(
        camera,
        matrices,
        [upload_cloud(device, cloud)],
        np.zeros(len(matrices), np.int32),
        tails=tails,
        tail_of=np.zeros(len(matrices), np.int32) if tails else None,
        pictures=pictures,
        background=np.array(options.background, np.float32),
        antialiased=options.antialiased,
    )
    return pictures.numpy()


def check_close(got: RenderResult, want: RenderResult, least: float = 80.0) -> None:
    """Colours and alpha within `least` dB, depth within 0.1 mm (p99) where both see a surface."""
    assert psnr(got.rgb, want.rgb) >= least
    assert psnr(got.alpha, want.alpha) >= least
    both = np.isfinite(want.depth) & np.isfinite(got.depth)
    assert (np.isfinite(want.depth) != np.isfinite(got.depth)).mean() < 1e-4
    if both.any():
        assert np.quantile(abs(got.depth[both] - want.depth[both]), 0.99) < 1e-4


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("antialiased", [False, True])
def test_the_flat_looks_as_on_the_cpu(degree: int, antialiased: bool) -> None:
    cloud = build_flat(6000, sh_degree=degree)
    options = RenderOptions(rgb_float=True, antialiased=antialiased, background=(0.1, 0.5, 0.9))
    cpu = RendererCpu(cloud, options)
    for camera, views in ((flat_camera(64, 48), flat_views(2)), flat_bev(80)):
        check_close(draw(cloud, camera, views, options), cpu.render(camera, views))


@pytest.mark.parametrize("size", [(64, 64), (61, 47), (3, 1), (18, 33)])
def test_any_picture_size(size: tuple[int, int]) -> None:
    """Off-centre, unequal focal lengths, near and far planes within the cloud, u8."""
    w, h = size
    camera = Camera(
        width=w, height=h, fx=0.6 * w, fy=0.8 * w, cx=0.3 * w, cy=0.7 * h, near=1.0, far=5.0
    )
    cloud, view = random_cloud(1500, seed=3, sh_degree=1), view_from_pose(-3, 0.3, 0.2, 0.1)
    options = RenderOptions(background=(1.0, 0.4, 0.2))
    got, want = draw(cloud, camera, view, options), RendererCpu(cloud, options).render(camera, view)
    assert got.rgb.dtype == np.uint8
    assert got.rgb.shape == want.rgb.shape
    assert abs(got.rgb.astype(int) - want.rgb).max() <= 1
    assert abs(got.alpha - want.alpha).max() < 1e-3


def test_splats_around_the_near_plane() -> None:
    """Huge and tiny splats close to the eye and behind it."""
    stream = np.random.default_rng(4)
    cloud = random_cloud(800, seed=4)
    means = cloud.means.copy()
    means[:, 0] = stream.uniform(-0.2, 0.6, len(means))
    scales = np.exp(stream.uniform(-7, 0.5, (len(means), 3))).astype(np.float32)
    near = GaussianCloud(means, cloud.quats, scales, cloud.opacities, cloud.sh)
    camera = Camera.from_hfov(48, 48, 90, near=0.02)
    view = view_from_pose(0, 0, 0, 0)
    check_close(draw(near, camera, view), RendererCpu(near, EXACT).render(camera, view), 70.0)


def floor_of(count: int, seed: int, *, z: float = 0.0) -> GaussianCloud:
    """Splats whose centres lie in one plane, in no order, each of another colour."""
    stream = np.random.default_rng(seed)
    means = stream.uniform(-2, 2, (count, 3))
    means[:, 2] = z
    scales = np.column_stack([stream.uniform(0.02, 0.2, (count, 2)), np.full(count, 1e-3)])
    turn = stream.uniform(0, np.pi, count)
    quats = np.column_stack([np.cos(turn), *np.zeros((2, count)), np.sin(turn)])
    arrays = (means, quats, scales, stream.uniform(0.02, 0.7, count), stream.random((count, 1, 3)))
    return GaussianCloud(*(a.astype(np.float32) for a in arrays))


def test_equal_depths_keep_the_order_of_the_cloud() -> None:
    """Thousands of splats at one depth, from above: far off if drawn in any other order."""
    floor = floor_of(4000, 1)
    camera = Camera.orthographic(64, 64, 4.2 / 64, near=0.0)
    view = view_from_above(0, 0, 2.3)
    want = RendererCpu(floor, EXACT).render(camera, view)
    check_close(draw(floor, camera, view), want)
    shuffled = floor.select(np.random.default_rng(2).permutation(len(floor)))
    assert psnr(RendererCpu(shuffled, EXACT).render(camera, view).rgb, want.rgb) < 40


def test_moving_splats_come_after_all_others_at_equal_depth() -> None:
    floor, extra = floor_of(1500, 1), floor_of(700, 2)
    camera = Camera.orthographic(48, 48, 4.2 / 48, near=0.0)
    view = view_from_above(0, 0, 2.3)
    got = draw(floor, camera, view, extra=extra)
    check_close(got, RendererCpu(floor, EXACT).render(camera, view, extra=extra))
    check_close(got, RendererCpu(join_clouds([floor, extra]), EXACT).render(camera, view))


@pytest.mark.parametrize("count", [0, 1, 300])
def test_nothing_to_see(count: int) -> None:
    """No splats, or all behind the camera: background, no alpha, infinite depth."""
    cloud, view = random_cloud(count, seed=1), view_from_pose(50, 0, 0, 0)
    camera = Camera.from_hfov(20, 18, 90)
    options = RenderOptions(background=(0.25, 0.5, 1.0))
    got = draw(cloud, camera, np.stack([view] * 2), options)
    assert (got.rgb == np.array([64, 128, 255])).all()
    assert (got.alpha == 0).all()
    assert np.isinf(got.depth).all()
    assert draw(cloud, camera, np.zeros((0, 4, 4))).rgb.shape == (0, 18, 20, 3)


def test_one_splat_that_covers_all() -> None:
    """Listed by a whole warp into every tile of a wide picture."""
    cloud = random_cloud(1, seed=1)
    big = GaussianCloud(
        np.zeros((1, 3), np.float32), cloud.quats, np.full((1, 3), 3.0, np.float32),
        np.ones(1, np.float32), cloud.sh,
    )  # fmt: skip
    camera, view = Camera.from_hfov(720, 40, 100), view_from_pose(-4, 0, 0, 0)
    got = draw(big, camera, view)
    check_close(got, RendererCpu(big, EXACT).render(camera, view))
    assert (got.alpha > 0.3).mean() > 0.5


def test_views_of_many_clouds_fill_their_rows() -> None:
    """Three clouds of other SH degrees, some views with tails, rows in another order."""
    device = DeviceHost()
    clouds = [random_cloud(300 * k, seed=k, sh_degree=k) for k in (1, 2, 3)]
    tails = [random_cloud(90, seed=9), random_cloud(40, seed=8, sh_degree=2)]
    cloud_of, tail_of = np.array([2, 0, 1, 2, 0], np.int32), np.array([1, -1, 0, 0, -1], np.int32)
    rows = np.array([4, 0, 3, 1, 5])
    views = np.stack([view_from_pose(-3, 0.1 * k, 0.2, 0.1 * k) for k in range(5)])
    camera = Camera.from_hfov(40, 30, 80)
    drawer = Drawer(device)
    pictures = drawer.pictures(camera, 6, ("rgb", "alpha"), rgb_float=True)
    drawer.draw(
        camera, views, [upload_cloud(device, c) for c in clouds], cloud_of,
        tails=[upload_cloud(device, t, sort=False) for t in tails], tail_of=tail_of,
        pictures=pictures, rows=rows, background=BLACK,
    )  # fmt: skip
    got = pictures.numpy()
    assert got.depth is None
    for v in range(5):
        extra = None if tail_of[v] < 0 else tails[tail_of[v]]
        want = RendererCpu(clouds[cloud_of[v]], EXACT).render(camera, views[v], extra=extra)
        assert psnr(got.rgb[rows[v]], want.rgb[0]) > 80
        assert psnr(got.alpha[rows[v]], want.alpha[0]) > 80
    assert np.isnan(got.alpha[2]).all()  # nobody's row


@pytest.mark.parametrize("ordered", [True, False])
def test_marks_are_those_of_the_cpu(ordered: bool) -> None:
    cloud = build_flat(5000)
    cloud = cloud.select(choose_splats(cloud))
    if not ordered:
        cloud = cloud.select(np.random.default_rng(1).permutation(len(cloud)))
    camera, views = flat_camera(64, 64), flat_views(4)
    device = DeviceHost(seed=2)
    packed = upload_cloud(device, cloud)
    assert packed.ordered == ordered
    marks = device.zeros((2, -(-len(cloud) // 32)), np.uint32)
    rows = np.array([0, 1, 1, 0])
    Drawer(device).mark(
        camera, views, [packed], np.zeros(4, np.int32), threshold=1 / 255, marks=marks, rows=rows
    )
    got = np.unpackbits(marks.numpy().view(np.uint8), axis=1, count=len(cloud))
    cpu = RendererCpu(cloud)
    for row in (0, 1):
        want = np.zeros(len(cloud), np.uint8)
        cpu.mark_visible(camera, views[rows == row], 1 / 255, want)
        assert 200 < want.sum() < len(cloud) / 2
        assert (got[row] != want).sum() <= 2  # weights within rounding of the threshold
