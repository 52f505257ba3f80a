"""The reference for all renderers: float64, one pixel at a time, over all splats.

It shares no code with any backend and follows the textbook, not the fast forms: covariance
R S Sᵀ Rᵀ, EWA projection J W Σ Wᵀ Jᵀ, its plain inverse, exact exp, harmonics from Legendre
polynomials. Use it at about 64x64.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import lpmv

from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import F64, rotation_from_quaternion
from gn0.jit import njit, prange
from gn0.render.camera import Camera
from gn0.render.renderer import (
    ALPHA_CAP,
    ALPHA_MIN,
    DILATION,
    EXTENT_MAX,
    TRANSMITTANCE_STOP,
    Output,
    RenderOptions,
    RenderResult,
    check_views,
)


class RendererReference:
    """Slow and exact: the `Renderer` protocol in float64, for clouds entirely in view."""

    name = "reference"

    def __init__(self, cloud: GaussianCloud, options: RenderOptions | None = None) -> None:
        self.cloud = cloud
        self.options = options or RenderOptions()

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = ("rgb", "depth", "alpha"),
        background: tuple[float, float, float] | None = None,
    ) -> RenderResult:
        """Render as the protocol says; pictures are computed in float64, returned in float32."""
        cloud = self.cloud if extra is None else join_clouds([self.cloud, extra])
        behind = np.array(self.options.background if background is None else background, float)
        pictures = []
        for view in check_views(views):
            splats = project_splats(cloud, camera, view, antialiased=self.options.antialiased)
            pictures.append(_blend(*splats, camera.width, camera.height, behind))
        stacked = np.stack(pictures)
        rgb, depth, alpha = stacked[..., :3], stacked[..., 3], stacked[..., 4]
        if self.options.rgb_float:
            colour: NDArray[np.generic] = rgb.astype(np.float32)
        else:
            colour = np.floor(np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
        return RenderResult(
            colour if "rgb" in outputs else None,  # type: ignore[arg-type]
            depth.astype(np.float32) if "depth" in outputs else None,
            alpha.astype(np.float32) if "alpha" in outputs else None,
        )


def project_splats(
    cloud: GaussianCloud, camera: Camera, view: F64, *, antialiased: bool = False
) -> tuple[F64, F64, F64, F64, F64]:
    """Splats in the picture, front to back: centre [M, 2] px, conic [M, 3], opacity, rgb, z."""
    centre, conic, opacity, colour, z, _ = _project(cloud, camera, view, antialiased)
    return centre, conic, opacity, colour, z


def find_labels(
    cloud: GaussianCloud, camera: Camera, view: F64, *, antialiased: bool = False
) -> tuple[NDArray[np.int64], F64]:
    """The object that each pixel shows, and how clearly, a pixel and a splat at a time.

    Returns:
        label of the greatest summed weight [H, W], -1 for splats without, -2 where nothing shows;
        and its lead over the next label [H, W], a weight: where it is next to nothing, rounding
        decides.

    Raises:
        ValueError: the cloud has no labels.
    """
    if cloud.label is None:
        raise ValueError("the cloud has no labels")
    centre, conic, opacity, _, _, index = _project(cloud, camera, view, antialiased)
    labels = np.maximum(cloud.label[index], -1).tolist()
    shown = np.full((camera.height, camera.width), -2, np.int64)
    lead = np.ones((camera.height, camera.width))
    for row in range(camera.height):
        for column in range(camera.width):
            dx, dy = column + 0.5 - centre[:, 0], row + 0.5 - centre[:, 1]
            s = 0.5 * (conic[:, 0] * dx * dx + conic[:, 2] * dy * dy) + conic[:, 1] * dx * dy
            alpha = np.minimum(ALPHA_CAP, opacity * np.exp(-np.maximum(s, 0)))
            through, sums = 1.0, dict[int, float]()
            for i in np.flatnonzero((s >= 0) & (alpha >= ALPHA_MIN)).tolist():
                after = through * (1 - alpha[i])
                if after <= TRANSMITTANCE_STOP:
                    break
                sums[labels[i]] = sums.get(labels[i], 0.0) + alpha[i] * through
                through = after
            if sums:  # the first of equals: a dictionary keeps the order in which it was filled
                shown[row, column] = best = max(sums, key=lambda label: sums[label])
                first, *others = sorted(sums.values(), reverse=True)
                lead[row, column] = first - max(others, default=0.0)
                assert sums[best] == first
    return shown, lead


def _project(
    cloud: GaussianCloud, camera: Camera, view: F64, antialiased: bool
) -> tuple[F64, F64, F64, F64, F64, NDArray[np.int64]]:
    """As `project_splats`, and each splat's index in the cloud."""
    rotation, shift = view[:3, :3], view[:3, 3]
    point = cloud.means.astype(float) @ rotation.T + shift
    z = point[:, 2]
    kept = np.flatnonzero((z >= camera.near) & (z <= camera.far))
    point, z = point[kept], z[kept]
    turn = rotation_from_quaternion(cloud.quats[kept])
    turn = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    spread = cloud.scales[kept].astype(float)
    world = turn @ (spread[:, :, None] ** 2 * turn.transpose(0, 2, 1))
    local = rotation @ world @ rotation.T
    jacobian = np.zeros((len(kept), 2, 3))
    size, focal = (camera.width, camera.height), (camera.fx, camera.fy)
    principal = (camera.cx, camera.cy)
    centre = np.empty((len(kept), 2))
    for axis in range(2):
        f, c = focal[axis], principal[axis]
        if camera.model == "ortho":
            centre[:, axis] = f * point[:, axis] + c
            jacobian[:, axis, axis] = f
            continue
        tangent = point[:, axis] / z
        widened = 0.3 * size[axis] / (2 * f)
        clamped = np.clip(tangent, -(c / f + widened), (size[axis] - c) / f + widened)
        centre[:, axis] = f * tangent + c
        jacobian[:, axis, axis] = f / z
        jacobian[:, axis, 2] = -f * clamped / z
    flat = jacobian @ local @ jacobian.transpose(0, 2, 1)
    before = np.maximum(flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] ** 2, 0)
    a, b, d = flat[:, 0, 0] + DILATION, flat[:, 0, 1], flat[:, 1, 1] + DILATION
    determinant = a * d - b * b
    opacity = cloud.opacities[kept].astype(float)
    if antialiased:
        opacity = opacity * np.sqrt(before / determinant)
    visible = (opacity >= ALPHA_MIN) & (determinant > 0)
    extent = np.minimum(EXTENT_MAX, np.sqrt(2 * np.log(np.maximum(opacity * 255, 1))))
    for axis, variance in enumerate((a, d)):
        radius = np.ceil(extent * np.sqrt(variance))
        visible &= (centre[:, axis] + radius > 0) & (centre[:, axis] - radius < size[axis])
    eye = -rotation.T @ shift
    colour = sh_colours(cloud.sh[kept], cloud.means[kept].astype(float) - eye)
    conic = np.stack([d, -b, a], 1) / determinant[:, None]
    order = np.flatnonzero(visible)
    # the protocol's order: float32 depth, then index in the cloud
    order = order[np.argsort(z[order].astype(np.float32), kind="stable")]
    return centre[order], conic[order], opacity[order], colour[order], z[order], kept[order]


def sh_colours(sh: NDArray[np.floating], directions: F64) -> F64:
    """Colours [N, 3] of coefficients [N, K, 3] along `directions` [N, 3]."""
    length = np.linalg.norm(directions, axis=1)
    x, y, z = (directions / np.maximum(length, 1e-300)[:, None]).T
    azimuth = np.arctan2(y, x)
    total = np.zeros((len(sh), 3))
    for index in range(sh.shape[1]):
        degree = math.isqrt(index)
        m = index - degree * degree - degree
        k = abs(m)
        norm = (2 * degree + 1) / (4 * math.pi)
        norm *= math.factorial(degree - k) / math.factorial(degree + k)
        basis = math.sqrt(norm) * lpmv(k, degree, z)  # carries the Condon-Shortley sign
        if m:
            basis = basis * math.sqrt(2) * (np.cos(k * azimuth) if m > 0 else np.sin(k * azimuth))
        total += basis[:, None] * sh[:, index]
    return np.maximum(total + 0.5, 0)


@njit(parallel=True)
def _blend(centre, conic, opacity, colour, z, width, height, background):  # type: ignore[no-untyped-def]
    picture = np.zeros((height, width, 5))
    for pixel in prange(width * height):
        row, column = pixel // width, pixel % width
        transmittance, depth = 1.0, 0.0
        red, green, blue = 0.0, 0.0, 0.0
        for i in range(len(z)):
            dx, dy = column + 0.5 - centre[i, 0], row + 0.5 - centre[i, 1]
            s = 0.5 * (conic[i, 0] * dx * dx + conic[i, 2] * dy * dy) + conic[i, 1] * dx * dy
            if s < 0 or s > 6:  # e^-6 is under 1/255
                continue
            alpha = min(ALPHA_CAP, opacity[i] * math.exp(-s))
            if alpha < ALPHA_MIN:
                continue
            after = transmittance * (1 - alpha)
            if after <= TRANSMITTANCE_STOP:
                break
            weight = alpha * transmittance
            red += weight * colour[i, 0]
            green += weight * colour[i, 1]
            blue += weight * colour[i, 2]
            depth += weight * z[i]
            transmittance = after
        opaque = 1 - transmittance
        picture[row, column, 0] = red + transmittance * background[0]
        picture[row, column, 1] = green + transmittance * background[1]
        picture[row, column, 2] = blue + transmittance * background[2]
        picture[row, column, 3] = depth / opaque if opaque >= 0.5 else math.inf
        picture[row, column, 4] = opaque
    return picture
