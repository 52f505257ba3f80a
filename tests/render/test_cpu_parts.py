"""Moving parts on the CPU: as their splats would look if they were moved, and the same bytes."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import view_from_above, view_from_pose
from gn0.render import cpu_parts
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cpu_pack import pack_cloud
from gn0.render.cpu_project import project_chunks
from gn0.render.instance import Instance, find_normals, move_instance
from gn0.render.renderer import RenderOptions
from gn0.testing.renderer_check import psnr, random_cloud
from gn0.testing.renderer_parts_check import ball_cloud, check_renderer_parts, pose_at

CAMERA = Camera.from_hfov(90, 70, 90)
VIEW = view_from_pose(-2, 0, 0.2, 0.1)
TINT = np.array([[0.6, 0.9, 0.5], [0.5, 0, -0.9], [0, -0.4, 0.3], [0.2, 0.6, 0]])


def bytes_of(result) -> list[bytes]:
    return [a.tobytes() for a in (result.rgb, result.depth, result.alpha) if a is not None]


def test_parts_look_as_their_moved_splats() -> None:
    check_renderer_parts(RendererCpu)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("gain", [None, [0.3, 1.0, 1.8], TINT], ids=["none", "constant", "linear"])
def test_a_part_is_what_extra_would_show(degree: int, gain) -> None:
    """An eye before the ball, at its rim with the near plane across, and above it."""
    ball = ball_cloud(3000, 1, sh_degree=degree)
    renderer = RendererCpu(random_cloud(300, 2), RenderOptions(rgb_float=True))
    renderer.name_cloud("ball", ball)
    instance = Instance("ball", pose_at(0.4, 0.3, 0.2, 3), gain)
    extra = move_instance(ball, instance)
    close = view_from_pose(-0.05, 0.2, 0.3, 0.3)
    for camera, view in (
        (CAMERA, VIEW),
        (CAMERA, close),
        (Camera.orthographic(80, 60, 0.03), view_from_above(0.6, 0, 3.0)),
    ):
        got = renderer.render(camera, view, parts=[instance])
        want = renderer.render(camera, view, extra=extra)
        assert psnr(got.rgb, want.rgb) > 100
        assert psnr(got.rgb, renderer.render(camera, view).rgb) < 30
        solid = np.isfinite(want.depth)
        assert solid.sum() > 300 and (np.isfinite(got.depth) == solid).all()
        assert np.abs(got.depth[solid] - want.depth[solid]).max() < 1e-4


def test_far_from_the_origin_a_part_stays_whole() -> None:
    """40 m away, where float32 positions are 4 µm apart, and with compensated opacity."""
    ball = ball_cloud(2000, 1, sh_degree=1)
    options = RenderOptions(rgb_float=True, antialiased=True)
    renderer = RendererCpu(random_cloud(1, 2), options)
    renderer.name_cloud("ball", ball)
    instance = Instance("ball", pose_at(40, 30, 1, 3), TINT)
    view = view_from_pose(38.5, 30, 1.2, 0.1)
    got = renderer.render(CAMERA, view, parts=[instance])
    want = renderer.render(CAMERA, view, extra=move_instance(ball, instance))
    assert psnr(got.rgb, want.rgb) > 75
    solid = np.isfinite(want.depth) & np.isfinite(got.depth)
    assert solid.sum() > 800 and np.abs(got.depth[solid] - want.depth[solid]).max() < 1e-4


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core: nothing to compare")
@pytest.mark.parametrize("degree", [0, 3])
def test_parts_are_the_same_bytes_for_any_thread_count(degree: int) -> None:
    pictures = []
    for threads in (1, 2, 1):
        renderer = RendererCpu(random_cloud(300, 1), RenderOptions(threads=threads))
        renderer.name_cloud("ball", ball_cloud(5000, 2, sh_degree=degree))
        parts = [Instance("ball", pose_at(x, 0.2, 0.1, 4), TINT) for x in (0, 0.3, 0.9)]
        pictures.append(bytes_of(renderer.render(CAMERA, VIEW, parts=parts)))
    assert pictures[0] == pictures[1] == pictures[2]


def test_extra_comes_after_the_cloud_and_before_instances_at_equal_depth() -> None:
    """All three hold a floor at one height; seen from above, only their order tells."""
    static, extra, part = (random_cloud(200, seed) for seed in (1, 2, 3))
    camera, view = Camera.orthographic(64, 64, 0.07), view_from_above(0, 0, 3)
    renderer = RendererCpu(static)
    renderer.name_cloud("part", part)
    here = [Instance("part", np.eye(4))]
    together = bytes_of(renderer.render(camera, view, extra=extra, parts=here))
    joined = RendererCpu(join_clouds([static, extra, part])).render(camera, view)
    assert together == bytes_of(joined)
    swapped = RendererCpu(join_clouds([static, part, extra])).render(camera, view)
    assert together != bytes_of(swapped)


def test_instances_of_one_cloud_are_told_apart_at_equal_depth() -> None:
    """Two of the same place and colour gains of their own: the first is in front."""
    part = replace(random_cloud(60, 3), opacities=np.full(60, 0.7, np.float32))
    part = replace(part, means=part.means * np.float32([1, 1, 0]), sh=np.abs(part.sh))
    renderer = RendererCpu(random_cloud(1, 1))
    renderer.name_cloud("part", part)
    camera, view = Camera.orthographic(64, 64, 0.07), view_from_above(0, 0, 3)
    red, blue = (Instance("part", np.eye(4), gain) for gain in ([1, 0, 0], [0, 0, 1]))
    first = renderer.render(camera, view, parts=[red, blue]).rgb.astype(int).sum(axis=(0, 1, 2))
    second = renderer.render(camera, view, parts=[blue, red]).rgb.astype(int).sum(axis=(0, 1, 2))
    assert first[0] > 1.2 * first[2] and second[2] > 1.2 * second[0]


def test_a_named_cloud_is_packed_once(monkeypatch) -> None:
    """The very same, and an equal one: nothing is packed; another one is, and replaces it."""
    packed = []
    monkeypatch.setattr(
        cpu_parts, "pack_cloud", lambda c, **more: packed.append(c) or pack_cloud(c, **more)
    )
    renderer, ball = RendererCpu(random_cloud(20, 1)), ball_cloud(100, 1)
    for cloud in (ball, ball, replace(ball), replace(ball, means=ball.means.copy())):
        renderer.name_cloud("ball", cloud)
    assert len(packed) == 1
    renderer.name_cloud("other", ball)
    renderer.name_cloud("ball", ball_cloud(100, 2))
    renderer.name_cloud("ball", replace(ball, normal=-find_normals(ball)))
    assert len(packed) == 4
    before = bytes_of(renderer.render(CAMERA, VIEW, parts=[Instance("ball", np.eye(4))]))
    with pytest.raises(RenderError, match="not finite"):
        renderer.name_cloud("ball", replace(ball, sh=ball.sh * np.float32(np.nan)))
    after = bytes_of(renderer.render(CAMERA, VIEW, parts=[Instance("ball", np.eye(4))]))
    assert before == after, "what is refused replaces nothing"


def test_poses_of_one_body_are_sorted_once_and_drawn_as_if_each_was(monkeypatch) -> None:
    """Clouds that share their scales: the order of the first serves all, and no picture tells."""
    sorted_ones = []
    order = cpu_parts.morton_order
    monkeypatch.setattr(
        cpu_parts, "morton_order", lambda means: sorted_ones.append(means) or order(means)
    )
    rng = np.random.default_rng(5)
    rest = ball_cloud(700, 4)
    poses = [
        replace(
            rest,
            means=rng.permutation(rest.means) + np.float32(0.1 * k),
            opacities=np.where(rng.random(700) < 0.1, 0, rest.opacities).astype(np.float32),
        )
        for k in range(3)
    ]
    renderer = RendererCpu(random_cloud(20, 1))
    parts = [Instance("pose", np.eye(4))]
    for pose in poses:
        renderer.name_cloud("pose", pose)
        fresh = RendererCpu(random_cloud(20, 1))
        fresh.name_cloud("pose", replace(pose, scales=pose.scales.copy()))
        mine, its = (each.render(CAMERA, VIEW, parts=parts) for each in (renderer, fresh))
        assert bytes_of(mine) == bytes_of(its)
    assert len(sorted_ones) == 1 + len(poses)


def test_renderers_of_two_scenes_share_their_named_clouds() -> None:
    """What one was told, the other draws."""
    named = cpu_parts.NamedClouds()
    first, second = (RendererCpu(random_cloud(20, seed), named=named) for seed in (1, 2))
    first.name_cloud("ball", ball_cloud(100, 1))
    parts = [Instance("ball", np.eye(4))]
    alone = RendererCpu(random_cloud(20, 2))
    with pytest.raises(RenderError, match="'ball'"):
        alone.render(CAMERA, VIEW, parts=parts)
    alone.name_cloud("ball", ball_cloud(100, 1))
    want = alone.render(CAMERA, VIEW, parts=parts)
    assert bytes_of(second.render(CAMERA, VIEW, parts=parts)) == bytes_of(want)


def test_parts_and_gains_compile_nothing_anew() -> None:
    """One kernel serves static clouds and parts, whatever their gains."""
    renderer = RendererCpu(random_cloud(20, 1))
    renderer.render(CAMERA, VIEW)
    compiled = len(project_chunks.signatures)
    renderer.name_cloud("ball", ball_cloud(50, 1))
    for gain in (None, [1, 1, 2], TINT):
        renderer.render(CAMERA, VIEW, parts=[Instance("ball", np.eye(4), gain)])
    assert len(project_chunks.signatures) == compiled


def test_many_parts_few_parts_and_sizes_leave_no_trace() -> None:
    """Buffers grown for thirty parts of a large picture serve one part of a small one."""
    cloud, ball = random_cloud(200, 1), ball_cloud(300, 2)
    kept = RendererCpu(cloud)
    kept.name_cloud("ball", ball)
    for size, count in [
        ((33, 17), 1),
        ((160, 120), 30),
        ((16, 16), 2),
        ((50, 70), 0),
        ((90, 9), 5),
    ]:
        camera = Camera.from_hfov(*size, 90)
        parts = [Instance("ball", pose_at(0.3 * k - 1, 0.1 * k, 0, k), TINT) for k in range(count)]
        fresh = RendererCpu(cloud)
        fresh.name_cloud("ball", ball)
        got, want = (r.render(camera, VIEW, parts=parts) for r in (kept, fresh))
        assert bytes_of(got) == bytes_of(want)


def test_wrong_parts_are_refused_before_a_picture_is_drawn() -> None:
    renderer = RendererCpu(random_cloud(20, 1))
    renderer.name_cloud("ball", ball_cloud(20, 1))
    good, bad = Instance("ball", np.eye(4)), Instance("ball", np.diag([1, 1, 2.0, 1]))
    views = np.stack([VIEW, VIEW])
    drawn = dict(renderer.stage_seconds)
    with pytest.raises(RenderError, match=r"^view 1, instance 1: pose is not a rigid"):
        renderer.render(CAMERA, views, parts=[[good], [good, bad]])
    with pytest.raises(RenderError, match=r"^instance 0: no cloud is named 'door'"):
        renderer.render(CAMERA, views, parts=[Instance("door", np.eye(4))])
    assert renderer.stage_seconds == drawn
    if numba.config.NUMBA_NUM_THREADS > 1:
        before = numba.get_num_threads()
        single = RendererCpu(random_cloud(20, 1), RenderOptions(threads=1))
        with pytest.raises(RenderError):
            single.name_cloud("", random_cloud(20, 1))
        assert numba.get_num_threads() == before


def test_a_shoe_shows_on_a_floor_of_large_splats() -> None:
    """Whose middles are nearer to the camera; what floor and shoe are, and how deep, stays."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(1.0, 3.0, 0.15), np.arange(-1, 1, 0.15)))
    count = len(x)
    floor = GaussianCloud(
        means=np.column_stack([x, y, 0 * x]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.tile(np.array([0.1, 0.1, 0.002], np.float32), (count, 1)),
        opacities=np.full(count, 0.99, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )
    shoe = replace(ball_cloud(400, 5, radius=0.06), opacities=np.ones(400, np.float32))
    renderer = RendererCpu(floor)
    renderer.name_cloud("shoe", shoe)
    camera, view = Camera.from_hfov(90, 70, 60), view_from_pose(0, 0, 1.25, 0, -0.55)
    place = pose_at(2.0, 0.03, 0.06)
    seen = [
        renderer.render_who(camera, view, parts=[Instance("shoe", place, nearer=m)]).seen[0][0]
        for m in (0.0, 0.06)
    ]
    assert seen[0].share < 0.8 and seen[1].share == 1.0
    assert seen[0].whole == seen[1].whole
    drawn = renderer.render(camera, view, parts=[Instance("shoe", place, nearer=0.06)])
    alone = RendererCpu(floor.select(slice(0, 0)))
    alone.name_cloud("shoe", shoe)
    depth = alone.render(camera, view, parts=[Instance("shoe", place)]).depth
    solid = np.isfinite(depth)
    assert np.quantile(np.abs(drawn.depth[solid] - depth[solid]), 0.5) < 0.01


def test_ties_in_long_lists_keep_the_order_that_nearer_gives() -> None:
    """A floor seen from above, all at one depth; a part in its plane, sorted as if above it."""
    floor, part = (plane_cloud(3000, seed) for seed in (1, 2))
    camera, view = Camera.orthographic(16, 16, 0.02), view_from_above(0, 0, 3)
    renderer = RendererCpu(floor)
    renderer.name_cloud("part", part)
    got = renderer.render(camera, view, parts=[Instance("part", np.eye(4), nearer=0.1)])
    want = RendererCpu(join_clouds([part, floor])).render(camera, view)
    assert got.rgb.tobytes() == want.rgb.tobytes()
    last = renderer.render(camera, view, parts=[Instance("part", np.eye(4))])
    assert psnr(got.rgb, last.rgb) < 30


def plane_cloud(count: int, seed: int) -> GaussianCloud:
    """Splats in one plane, in no order."""
    cloud = random_cloud(count, seed)
    means = cloud.means * np.array([0.1, 0.1, 0.0], np.float32)
    return replace(cloud, means=means, opacities=cloud.opacities * np.float32(0.01) + 0.004)


class _Broken(RendererCpu):
    """Draws instances, but not as it was told."""

    def change(self, parts: list[Instance]) -> list[Instance]:
        raise NotImplementedError

    def render(self, *args, parts=(), **options):  # type: ignore[no-untyped-def, override]
        if not all(isinstance(part, Instance) and part.fault is None for part in parts):
            return super().render(*args, parts=parts, **options)
        return super().render(*args, parts=self.change(list(parts)), **options)


class _Forgets(_Broken):
    def change(self, parts):  # type: ignore[no-untyped-def]
        return parts[:1]


class _Reverses(_Broken):
    def change(self, parts):  # type: ignore[no-untyped-def]
        return parts[::-1]


class _GoesBack(_Broken):
    def change(self, parts):  # type: ignore[no-untyped-def]
        return [Instance(p.cloud, np.linalg.inv(p.pose), p.gain) for p in parts]


class _StaysUnturned(_Broken):
    def change(self, parts):  # type: ignore[no-untyped-def]
        return [Instance(p.cloud, pose_at(*p.pose[:3, 3]), p.gain) for p in parts]


class _StaysGrey(_Broken):
    def change(self, parts):  # type: ignore[no-untyped-def]
        return [Instance(p.cloud, p.pose) for p in parts]


class _IsLitFromNowhere(_Broken):
    def change(self, parts):  # type: ignore[no-untyped-def]
        gains = [p.gain if p.gain is None or p.gain.ndim == 1 else p.gain[0] for p in parts]
        return [Instance(p.cloud, p.pose, gain) for p, gain in zip(parts, gains, strict=True)]


class _StaysAsFar(_Broken):
    def change(self, parts):  # type: ignore[no-untyped-def]
        return [Instance(p.cloud, p.pose, p.gain) for p in parts]


class _IsLitInItsOwnFrame(_Broken):
    def change(self, parts):  # type: ignore[no-untyped-def]
        for part in parts:
            if part.gain is not None and part.gain.ndim == 2:
                part.__dict__["part_gain"] = part.gain
        return parts


@pytest.mark.parametrize(
    ("broken", "rule"),
    [
        (_Forgets, "SH 0, no gain, from the front"),
        (_Reverses, "at equal depth"),
        (_GoesBack, "SH 0, no gain, from the front"),
        (_StaysUnturned, "SH 0, no gain, from the front"),
        (_StaysGrey, "SH 0, a constant gain, from the front"),
        (_IsLitFromNowhere, "SH 0, a gain by normal, from the front"),
        (_IsLitInItsOwnFrame, "SH 0, a gain by normal, from the front"),
        (_StaysAsFar, "nearer by more than a wall is away"),
    ],
)
def test_the_contract_names_what_is_broken(broken, rule: str) -> None:
    with pytest.raises(AssertionError, match=rule):
        check_renderer_parts(broken, truth=RendererCpu)
