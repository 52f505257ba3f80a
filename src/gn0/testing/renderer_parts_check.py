"""Whether a renderer draws moving parts as it would draw their moved splats.

from gn0.testing.renderer_parts_check import check_renderer_parts
check_renderer_parts(RendererCpu)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import F64, rotation_from_quaternion, view_from_above, view_from_pose
from gn0.render.camera import Camera
from gn0.render.instance import PARTS_MAX, Instance, Parts, find_normals, move_instance
from gn0.render.renderer import RenderOptions, RenderResult
from gn0.seeds import random_stream
from gn0.testing.renderer_check import RendererFactory, psnr, random_cloud


class RendererOfParts(Protocol):
    """A renderer that knows clouds by name and draws instances of them."""

    def name_cloud(self, name: str, cloud: GaussianCloud) -> None:
        """Make a cloud known by a name."""
        ...

    def render(
        self, camera: Camera, views: NDArray[np.floating], *, parts: Parts = ()
    ) -> RenderResult:
        """Render `views`; see `gn0.render.renderer.Renderer.render`."""
        ...


PartsFactory = Callable[[GaussianCloud, RenderOptions], RendererOfParts]

_FLOATS = RenderOptions(rgb_float=True)
_GAINS: dict[str, NDArray[np.floating] | None] = {
    "no gain": None,
    "a constant gain": np.array([0.4, 1.0, 1.7]),
    "a gain by normal": np.array([[0.6, 0.9, 0.5], [0.5, 0, -0.9], [0, -0.4, 0.3], [0.2, 0.6, 0]]),
}


def check_renderer_parts(
    factory: PartsFactory,
    *,
    truth: RendererFactory | PartsFactory | None = None,
    degrees: Sequence[int] = (0, 3),
    min_psnr: float = 75.0,
    max_depth: float = 1e-4,
) -> None:
    """Check how a renderer draws instances, on small synthetic clouds.

    Args:
        factory: builds a renderer from a cloud and options (a class will do).
        truth: builds the renderer that draws the moved splats, joined to the cloud; the same
            by default.
        degrees: of spherical harmonics, of the parts.
        min_psnr: least agreement with the moved splats [dB].
        max_depth: most difference in depth from them [m], but for one pixel in a thousand, where
            a splat ends at 1/255 of opacity in one picture and a pixel further in the other.

    Raises:
        AssertionError: the first rule that is broken, in plain words.
    """
    for degree in degrees:
        _check_truth(factory, truth or factory, degree, min_psnr, max_depth)
    _check_order(factory, truth or factory)
    _check_nearer(factory)
    _check_batches(factory)
    _check_empty(factory)
    _check_names(factory)
    _check_refusals(factory)


def ball_cloud(count: int, seed: int, *, radius: float = 0.5, sh_degree: int = 0) -> GaussianCloud:
    """A ball of thin discs round the origin that is closed from all sides, of many colours."""
    stream = random_stream(seed, "ball", count)
    out = stream.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    middle = out + np.array([0.0, 0.0, 1.0 + 1e-9])  # half way from +z to the normal
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    quats = np.column_stack([np.zeros(count), middle])  # half a turn about it: +z to the normal
    width = 2.2 * radius / np.sqrt(count)
    scales = stream.uniform(0.7, 1.3, (count, 3)) * (width, width, width / 10)
    sh = stream.normal(0, 0.25, (count, (sh_degree + 1) ** 2, 3))
    sh[:, 0] += out + 0.5
    return GaussianCloud(
        means=(radius * out).astype(np.float32),
        quats=quats.astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=stream.uniform(0.5, 1.0, count).astype(np.float32),
        sh=sh.astype(np.float32),
    )


def pose_at(x: float, y: float, z: float, seed: int | None = None) -> F64:
    """A part-to-world pose [4, 4] at a point [m], turned at random if there is a seed."""
    pose = np.eye(4)
    if seed is not None:
        quat = random_stream(seed, "pose").normal(size=4)
        pose[:3, :3] = rotation_from_quaternion(quat / np.linalg.norm(quat))[0]
    pose[:3, 3] = x, y, z
    return pose


def _expect(held: bool, rule: str) -> None:
    if not held:
        raise AssertionError(f"renderer of parts: {rule}")


def _same(a: RenderResult, b: RenderResult, view: int | None = None) -> bool:
    for name in ("rgb", "depth", "alpha"):
        x, y = getattr(a, name), getattr(b, name)
        if (x if view is None else x[view : view + 1]).tobytes() != y.tobytes():
            return False
    return True


def _cases() -> list[tuple[str, Camera, F64]]:
    """Cameras at a ball at (1, 0.2, 0.1), and where they are."""
    pinhole, above = Camera.from_hfov(64, 48, 90), Camera.orthographic(60, 50, 0.04)
    return [
        ("from the front", pinhole, view_from_pose(-0.6, 0.0, 0.2, 0.1)),
        ("partly out of sight", pinhole, view_from_pose(0.2, -0.3, 0.1, -0.3, 0.2)),
        ("across the near plane", pinhole, view_from_pose(0.55, 0.3, 0.0, 0.4)),
        ("from within", pinhole, view_from_pose(1.0, 0.2, 0.1, 2.0)),
        ("behind the eye", pinhole, view_from_pose(-0.6, 0.0, 0.2, 3.0)),
        ("from above", above, view_from_above(0.7, 0.1, 2.0)),
        ("cut by a map's height", above, view_from_above(1.6, 0.1, 0.1)),
    ]


def _check_truth(
    factory: PartsFactory,
    truth: RendererFactory | PartsFactory,
    degree: int,
    min_psnr: float,
    max_depth: float,
) -> None:
    static, ball = random_cloud(250, seed=1), ball_cloud(700, 2, sh_degree=degree)
    thin = random_cloud(60, seed=3, sh_degree=degree)
    thin = replace(thin, normal=find_normals(thin)[::-1])  # normals of its own, not those found
    renderer = factory(static, _FLOATS)
    renderer.name_cloud("ball", ball)
    renderer.name_cloud("thin", thin)
    for what, gain in _GAINS.items():
        instance = Instance("ball", pose_at(1.0, 0.2, 0.1, 4), gain)
        other = Instance("thin", pose_at(0.9, -0.3, 0.4, 5), gain)
        moved = [move_instance(ball, instance), move_instance(thin, other)]
        judge = truth(join_clouds([static, *moved]), _FLOATS)
        for place, camera, view in _cases():
            rule = f"SH {degree}, {what}, {place}: as the moved splats"
            got = renderer.render(camera, view, parts=[instance, other])
            _compare(got, judge.render(camera, view), rule, min_psnr, max_depth)


def _compare(
    got: RenderResult, want: RenderResult, rule: str, min_psnr: float, max_depth: float
) -> None:
    assert got.rgb is not None and got.depth is not None and got.alpha is not None
    assert want.rgb is not None and want.depth is not None and want.alpha is not None
    value = psnr(got.rgb, want.rgb)
    _expect(value >= min_psnr, f"{rule}: colours agree to {value:.1f} dB, least {min_psnr}")
    value = psnr(got.alpha, want.alpha)
    _expect(value >= min_psnr, f"{rule}: opacity agrees to {value:.1f} dB, least {min_psnr}")
    clear = np.abs(want.alpha - 0.5) > 1e-3  # depth begins at half
    _expect(
        bool((np.isfinite(got.depth) == np.isfinite(want.depth))[clear].all()),
        f"{rule}: depth where alpha is at least 0.5",
    )
    solid = np.isfinite(got.depth) & np.isfinite(want.depth)
    error = np.sort(np.abs(got.depth[solid] - want.depth[solid]))
    kept = error[: len(error) - len(error) // 1000]
    worst = float(kept[-1]) if len(kept) else 0.0
    _expect(worst <= max_depth, f"{rule}: depth agrees to {worst * 1e3:.3f} mm")


def _check_order(factory: PartsFactory, truth: RendererFactory | PartsFactory) -> None:
    """Equal depths, seen from above: floors of the cloud and of parts that lie in one another."""
    clouds = [random_cloud(80, seed) for seed in (1, 2, 3)]
    camera, view = Camera.orthographic(64, 64, 0.07), view_from_above(0, 0, 3)
    renderer = factory(clouds[0], RenderOptions())
    renderer.name_cloud("b", clouds[1])
    renderer.name_cloud("c", clouds[2])
    for order in ("bc", "cb"):
        numbers = [0, *("abc".index(name) for name in order)]
        want = truth(join_clouds([clouds[k] for k in numbers]), RenderOptions())
        got = renderer.render(camera, view, parts=[Instance(name, np.eye(4)) for name in order])
        _expect(
            _same(got, want.render(camera, view)),
            "at equal depth the cloud comes first, then the instances in the order given",
        )


def _check_nearer(factory: PartsFactory) -> None:
    """What is sorted as if nearer comes before a floor and a wall that hid it, and no further."""
    camera, view = Camera.from_hfov(64, 48, 60), view_from_pose(0, 0, 1.0, 0, -0.45)
    across, up = np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.4, 1.2, 9))
    wall = _wall_cloud(np.column_stack([across.ravel() * 0 + 2.3, across.ravel(), up.ravel()]))
    renderer = factory(wall, _FLOATS)
    small = replace(ball_cloud(400, 5, radius=0.1), opacities=np.ones(400, np.float32))
    renderer.name_cloud("ball", small)
    bare = renderer.render(camera, view)

    def at(x: float, nearer: float) -> RenderResult:
        parts = [Instance("ball", pose_at(x, 0.1, 0.2, 6), nearer=nearer)]
        return renderer.render(camera, view, parts=parts)

    before = at(1.9, 0.0)
    _expect(_same(before, at(1.9, 0.2)), "before all else nearer changes nothing, depth included")
    for x, nearer in ((2.45, 0.0), (2.7, 0.0), (2.7, 0.1)):
        _expect(_same(at(x, nearer), bare), f"at {x} m and {nearer} m nearer a wall hides it")
    near = at(2.45, 0.4)
    assert near.depth is not None and bare.depth is not None
    shows = (near.depth > bare.depth + 0.02).sum()
    _expect(shows > 20, "a part that is nearer by more than a wall is away shows, at its own depth")


def _wall_cloud(means: NDArray[np.floating]) -> GaussianCloud:
    """Opaque splats at points [N, 3] m, 0.15 m wide across x, four at each."""
    count = 4 * len(means)
    return GaussianCloud(
        means=np.repeat(means, 4, axis=0).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.tile(np.array([0.002, 0.15, 0.15], np.float32), (count, 1)),
        opacities=np.ones(count, np.float32),
        sh=np.linspace(-1, 1, 3 * count).reshape(count, 1, 3).astype(np.float32),
    )


def _check_batches(factory: PartsFactory) -> None:
    renderer = factory(random_cloud(200, seed=6), RenderOptions())
    renderer.name_cloud("ball", ball_cloud(300, 7))
    a, b = (Instance("ball", pose_at(x, 0.3, 0.2, 8), _GAINS["a gain by normal"]) for x in (0.5, 1))
    camera = Camera.from_hfov(50, 37, 90)
    views = np.stack([view_from_pose(-1.5 - 0.2 * k, 0, 0.2, 0.1 * k) for k in range(4)])
    shared = renderer.render(camera, views, parts=[a, b])
    _expect(
        _same(shared, renderer.render(camera, views, parts=[a, b])), "the same call, same bytes"
    )
    _expect(
        _same(shared, renderer.render(camera, views, parts=[[a, b]] * 4)),
        "one sequence for all views is the same as that one for each",
    )
    rows = [[a], [], [b, a], [b]]
    own = renderer.render(camera, views, parts=rows)
    for view, row in enumerate(rows):
        alone = renderer.render(camera, views[view], parts=row)
        _expect(_same(own, alone, view), "a view and its parts do not depend on the batch")


def _check_empty(factory: PartsFactory) -> None:
    renderer = factory(random_cloud(150, seed=9), RenderOptions())
    camera, view = Camera.from_hfov(50, 37, 90), view_from_pose(-2, 0, 0.2, 0.1)[None]
    want = renderer.render(camera, view)
    ball = ball_cloud(100, 7)
    renderer.name_cloud("ball", ball)
    renderer.name_cloud("nothing", ball.select(slice(0, 0)))
    away = [Instance("ball", pose_at(-9, 0, 0)), Instance("nothing", np.eye(4))]
    for what, parts in (("no parts", []), ("a view of none", [[]]), ("parts out of sight", away)):
        _expect(_same(want, renderer.render(camera, view, parts=parts)), f"{what}: same bytes")
    seen = renderer.render(camera, view, parts=[Instance("ball", np.eye(4))])
    _expect(not _same(want, seen), "a part in sight shows")
    _expect(_same(want, renderer.render(camera, view)), "parts leave no trace")


def _check_names(factory: PartsFactory) -> None:
    renderer = factory(random_cloud(50, seed=10), RenderOptions())
    camera, view = Camera.from_hfov(40, 30, 90), view_from_pose(-1.5, 0, 0, 0)
    parts = [Instance("it", np.eye(4), _GAINS["a gain by normal"])]
    small, large = ball_cloud(100, 1, radius=0.3), ball_cloud(200, 1, radius=0.6)
    inward = replace(small, normal=-find_normals(small))
    pictures = []
    for cloud in (small, replace(small), large, inward, small):
        renderer.name_cloud("it", cloud)
        pictures.append(renderer.render(camera, view, parts=parts))
    _expect(_same(pictures[0], pictures[1]), "the same cloud under its name changes nothing")
    _expect(not _same(pictures[0], pictures[2]), "another cloud replaces what had the name")
    _expect(not _same(pictures[0], pictures[3]), "other normals are another cloud")
    _expect(_same(pictures[0], pictures[4]), "and back again")


def _check_refusals(factory: PartsFactory) -> None:
    cloud = random_cloud(50, seed=11)
    renderer = factory(cloud, RenderOptions())
    renderer.name_cloud("it", ball_cloud(50, 1))
    camera, view = Camera.from_hfov(16, 16, 90), view_from_pose(-2, 0, 0, 0)
    good = Instance("it", np.eye(4))
    bad: dict[str, Parts] = {
        "a pose with NaN": [good, Instance("it", np.full((4, 4), np.nan))],
        "a pose with scale": [good, Instance("it", np.diag([2, 2, 2, 1.0]))],
        "a gain with NaN": [good, Instance("it", np.eye(4), np.full(3, np.nan, np.float32))],
        "a gain of another shape": [good, Instance("it", np.eye(4), np.ones((3, 3), np.float32))],
        "a cloud of no name": [good, Instance("that", np.eye(4))],
    }
    for what, parts in bad.items():
        _refused(what, "instance 1", lambda p=parts: renderer.render(camera, view, parts=p))  # type: ignore[misc]
    many = [good] * (PARTS_MAX + 1)
    _refused("too many", "instance", lambda: renderer.render(camera, view, parts=many))
    _refused("parts of 2 views", "", lambda: renderer.render(camera, view, parts=[[good], []]))
    broken = replace(cloud, means=np.full_like(cloud.means, np.inf))
    _refused("a cloud with infinities", "", lambda: renderer.name_cloud("it", broken))
    _refused("no name", "", lambda: renderer.name_cloud("", cloud))
    renderer.render(camera, view, parts=[good])  # all goes on as before


def _refused(what: str, where: str, call: Callable[[], object]) -> None:
    try:
        call()
    except RenderError as error:
        _expect(where in error.where, f"{what} is refused, and {where} named")
        return
    _expect(False, f"{what} is refused with RenderError")
