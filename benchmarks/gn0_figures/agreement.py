"""How far pictures of two renderers are apart, on scenes that a renderer may stumble over."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.splat_files import load_cloud
from gn0.geometry import F64, quaternion_from_rotation, view_from_pose
from gn0.render.camera import Camera
from gn0.render.renderer import RenderOptions, RenderResult, SceneRenderer
from gn0.seeds import random_stream
from gn0.testing.renderer_check import psnr
from gn0_figures.device_scenes import FigureScene
from gn0_figures.flat import flat_camera

PERSPECTIVE, BEV = 55.0, 60.0  # dB, at least
DEPTH = 1.0  # mm, p99 at most, where alpha > 0.5
OPTIONS = RenderOptions(rgb_float=True)  # rounding to bytes would hide and add differences


@dataclass(frozen=True)
class Agreement:
    """Distance of one result to another.

    Attributes:
        rgb: PSNR [dB].
        depth: 99th percentile of the depth difference [mm] where both have one and alpha > 0.5.
        alpha: largest difference.
    """

    rgb: float
    depth: float
    alpha: float


@dataclass(frozen=True)
class Setting:
    """What two renderers draw.

    Attributes:
        name: of the scene and kind of picture.
        cloud: the static splats.
        camera, views: of the pictures.
        least: PSNR to reach [dB].
        tail: moving splats.
    """

    name: str
    cloud: GaussianCloud
    camera: Camera
    views: F64
    least: float
    tail: GaussianCloud | None = None

    def draw(self, renderer: SceneRenderer) -> RenderResult:
        """All pictures."""
        return renderer.render(self.camera, self.views, extra=self.tail)


def compare_pictures(got: RenderResult, want: RenderResult) -> Agreement:
    """The distance of float pictures with depth and alpha."""
    assert got.rgb is not None and want.rgb is not None
    assert got.depth is not None and want.depth is not None
    assert got.alpha is not None and want.alpha is not None
    solid = (
        (want.alpha > 0.5) & (got.alpha > 0.5) & np.isfinite(got.depth) & np.isfinite(want.depth)
    )
    error = np.abs(got.depth[solid].astype(float) - want.depth[solid])
    return Agreement(
        rgb=min(psnr(got.rgb, want.rgb), 200.0),
        depth=float(np.percentile(error, 99)) * 1e3 if error.size else 0.0,
        alpha=float(np.abs(got.alpha - want.alpha).max(initial=0.0)),
    )


def scene_settings(
    scene: FigureScene, *, views: int = 4, pixels: int = 224, bev: int = 512
) -> Iterator[Setting]:
    """A scene from inside, with a moving tail, and from above."""
    camera = flat_camera(pixels, pixels)
    poses = scene.views(views, 5)
    yield Setting(f"{scene.name}, perspective", scene.cloud, camera, poses, PERSPECTIVE)
    yield Setting(
        f"{scene.name}, moving tail", scene.cloud, camera, poses, PERSPECTIVE, tail_before(poses)
    )
    above, view = scene.bev(bev)
    yield Setting(f"{scene.name}, BEV", scene.cloud, above, view[None], BEV)


def tail_before(views: F64, count: int = 3000) -> GaussianCloud:
    """A body of splats 1.5 m in front of the first eye, as a walking person would be."""
    stream = random_stream(3, "figure tail")
    view = views[0]
    eye, ahead = -view[:3, :3].T @ view[:3, 3], view[2, :3]
    size = stream.normal(0, (0.18, 0.18, 0.45), (count, 3))
    turn, _ = np.linalg.qr(stream.normal(size=(count, 3, 3)))
    turn[:, :, 0] *= np.sign(np.linalg.det(turn))[:, None]  # rotations, no mirrors
    return GaussianCloud(
        means=(eye + 1.5 * ahead + size).astype(np.float32),
        quats=quaternion_from_rotation(turn).astype(np.float32),
        scales=np.exp(stream.uniform(-6, -3.5, (count, 3))).astype(np.float32),
        opacities=stream.uniform(0.1, 1.0, count).astype(np.float32),
        sh=stream.normal(0, 0.6, (count, 1, 3)).astype(np.float32),
    )


def capture_settings(path: Path, *, views: int = 4, pixels: int = 224) -> Iterator[Setting]:
    """A captured object from round about."""
    cloud = load_cloud(path).cloud
    low, high = np.percentile(cloud.means, (2, 98), axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    poses = []
    for k in range(views):
        yaw = 2 * math.pi * k / views
        x, y = middle[0] - 1.6 * reach * math.cos(yaw), middle[1] - 1.6 * reach * math.sin(yaw)
        poses.append(view_from_pose(float(x), float(y), float(middle[2]), yaw))
    name = f"captured {path.stem}, {len(cloud) / 1e3:.0f} k, SH {cloud.sh_degree}"
    yield Setting(name, cloud, flat_camera(pixels, pixels), np.stack(poses), PERSPECTIVE)
