"""Fit the splats of a cloud to pictures of it, on a CPU and without torch.

Each flat splat keeps its plane. Its centre may move by a bounded step, its two axes, its opacity
and its colour are free: what a widened footprint adds at an outline, its neighbours take away.
Stochastic gradient descent (Adam, as Kingma and Ba 2015), one picture a step, with per-splat
moments that only advance where the splat is seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.config import Config
from gn0.errors import RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.geometry import F32, F64, quaternion_from_rotation, rotation_from_quaternion
from gn0.progress import Progress, no_progress
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu, spread_rows, view_parameters
from gn0.render.cpu_pack import CHUNK
from gn0.render.cpu_project import cull_chunks
from gn0.render.gradient import SUMS, sort_tiles, sum_entries, sum_rows
from gn0.render.refine_step import PARAMETERS, THIRD, descend, write_pack
from gn0.render.renderer import RenderOptions, check_views
from gn0.seeds import random_stream

_PARTS = 8  # shares of the rows that are summed side by side
_SCALE = np.float32(1e-3)  # of the loss: Adam does not see it, float32 likes it
_GROWTH = 2.5  # of the longest axis at most
_LAST = 0.04  # of the first step length is left at the end


class RefineSettings(Config, frozen=True):
    """How far and how fast splats move.

    Attributes:
        steps: pictures looked at, one a step.
        move: step of a centre, in sizes of the splat.
        shape: step of the axes, in sizes of the splat.
        opacity: step of the logit of opacity.
        colour: step of the display colour, 0..1.
        bound: farthest that a centre may go within its plane [m]; half of it off the plane.
    """

    steps: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 2000
    move: float = 0.2
    shape: float = 0.1
    opacity: float = 0.2
    colour: float = 0.02
    bound: float = 0.02


def refine_cloud(
    cloud: GaussianCloud,
    lenses: Sequence[tuple[int, int, float]],
    views: NDArray[np.floating],
    picture: Callable[[int], NDArray[np.uint8]],
    *,
    steps: int | None = None,
    settings: RefineSettings | None = None,
    closed: bool = False,
    seed: int = 0,
    progress: Progress = no_progress,
) -> GaussianCloud:
    """The cloud with its splats fitted to pictures, in Morton order; as many splats as before.

    Splats that no picture shows stay as they are. Where the cloud has albedo, it follows the
    change of colour, so that relighting starts from what is seen.

    Args:
        cloud: flat splats (third axis the thinnest), colours without view dependence (SH 0).
        lenses: (width, height [pixels], hfov [degrees]) of each view.
        views: world-to-camera [V, 4, 4].
        picture: uint8 [H, W, 3] display colours of view v, before a black background.
        steps: pictures looked at; as in `settings` when None.
        settings: steps and rates.
        closed: whether whatever is not black in the pictures is solid. Gaps between splats then
            count as errors even where a surface is about as dark as the background.
        seed: seed of the order of the pictures.
        progress: progress sink.

    Raises:
        RenderError: view-dependent colours, no views, or a picture of the wrong size or type.
    """
    settings = settings or RefineSettings()
    total = settings.steps if steps is None else steps
    cameras = [Camera.from_hfov(*lens) for lens in lenses]
    matrices = check_views(views)
    if cloud.sh_degree:
        raise RenderError("only splats of one colour (SH degree 0) can be refined")
    if not len(matrices) or len(cameras) != len(matrices):
        raise RenderError(
            f"{len(matrices)} views and {len(cameras)} cameras", remedy="give one camera per view"
        )
    if not len(cloud) or not total:
        return cloud
    fit = _Fit(cloud, settings, closed)
    order = random_stream(seed, "refine order")
    queue: list[int] = []
    for step in range(total):
        progress("refining", step, total)
        if not queue:
            queue = order.permutation(len(matrices)).tolist()
        v = queue.pop()
        target = picture(v)
        shape = (cameras[v].height, cameras[v].width, 3)
        if target.shape != shape or target.dtype != np.uint8:
            raise RenderError(
                f"picture of shape {target.shape} and type {target.dtype}, expected {shape} uint8",
                where=f"view {v}",
            )
        cosine = 0.5 * (1 + math.cos(math.pi * step / total))
        fit.step(cameras[v], matrices[v], target, _LAST + (1 - _LAST) * cosine)
    progress("refining", total, total)
    return fit.cloud_now()


class _Fit:
    """Parameters, their moments and the renderer that shows them."""

    def __init__(
        self, cloud: GaussianCloud, settings: RefineSettings, closed: bool = False
    ) -> None:
        cloud = cloud.select(morton_order(cloud.means))  # the order of the packed chunks
        self.start, self.closed = cloud, closed
        n = len(cloud)
        axes = rotation_from_quaternion(cloud.quats).transpose(0, 2, 1)
        self.frame = np.ascontiguousarray(axes.reshape(n, 9), np.float32)
        self.base = np.ascontiguousarray(cloud.means)
        opacity = np.clip(cloud.opacities.astype(np.float64), 0.01, 0.999)
        # centre along the three axes, 2x2 matrix of the flat axes, logit, colour
        self.param = np.zeros((n, PARAMETERS), np.float32)
        self.param[:, 3], self.param[:, 6] = cloud.scales[:, 0], cloud.scales[:, 1]
        self.param[:, 7] = np.log(opacity / (1 - opacity))
        self.param[:, 8:] = cloud.rgb()
        self.size = np.sqrt(cloud.scales[:, 0] * cloud.scales[:, 1])
        self.limit = np.float32(_GROWTH) * cloud.scales[:, :2].max(axis=1)
        self.first, self.second = np.zeros_like(self.param), np.zeros_like(self.param)
        self.seen = np.zeros(n, np.int32)
        s = settings
        self.rates = np.array(
            [s.move] * 2 + [s.move / 5] + [s.shape] * 4 + [s.opacity] + [s.colour] * 3, np.float32
        )
        self.bound = np.array([s.bound, s.bound, s.bound / 2], np.float32)
        # every splat keeps its place in the packed chunks, however faint it becomes
        visible = replace(cloud, opacities=np.maximum(cloud.opacities, np.float32(0.01)))
        self.renderer = RendererCpu(visible, RenderOptions(rgb_float=True))
        self.packed = self.renderer.cloud
        self.sums = np.empty((0, SUMS), np.float32)
        self.rows = np.empty((0, SUMS), np.float32)
        write_pack(
            *(self.param, self.base, self.frame, self.start.scales[:, 2]),
            *(np.arange(self.packed.chunks, dtype=np.int32), self.packed.pack, self.packed.boxes),
        )

    def step(self, camera: Camera, view: F64, target: NDArray[np.uint8], length: float) -> float:
        """One step towards a picture; returns the mean squared error before it."""
        packed = self.packed
        parameters = view_parameters(camera, view)
        listed = np.empty(packed.chunks, np.int32)
        chunks = listed[: cull_chunks(packed.boxes, parameters, False, listed)]
        if not len(chunks):
            return 0.0
        arranged = self.renderer.arrange(camera, view, [(packed, 0)])
        records, indices, ordered, starts, rows, keys, spare_rows, spare_keys, _ = arranged.unboxed
        sort_tiles(rows, keys, spare_rows, spare_keys, starts, indices, records, ordered)
        entries = int(starts[-1])
        if len(self.sums) < entries:
            self.sums = np.empty((entries + entries // 4, SUMS), np.float32)
        count = len(chunks) * CHUNK
        if len(self.rows) < count:
            self.rows = np.empty((count + count // 4, SUMS), np.float32)
        errors = np.zeros(len(starts) - 1)
        sum_entries(
            *(records, rows, starts, spread_rows(-(-camera.height // 16))),
            *(-(-camera.width // 16), camera.width, camera.height, target, _SCALE),
            *(self.closed, self.sums, errors),
        )
        sum_rows(rows, entries, self.sums, _PARTS, self.rows[:count])
        descend(
            *(self.rows[:count], indices, records, self.param, self.base, self.frame),
            *(
                self.size,
                self.limit,
                parameters,
                self.first,
                self.second,
                self.seen,
                self.rates * np.float32(length),
            ),
            self.bound,
        )
        write_pack(
            *(self.param, self.base, self.frame, self.start.scales[:, 2]),
            *(chunks, packed.pack, packed.boxes),
        )
        return float(errors.sum()) / (camera.width * camera.height * 3)

    def cloud_now(self) -> GaussianCloud:
        """The fitted cloud; axes are those of each splat's 2x2 matrix."""
        p = self.param.astype(np.float64)
        frame = self.frame.reshape(-1, 3, 3).astype(np.float64)
        means = self.base + np.einsum("nk,nka->na", p[:, :3], frame)
        turn, scale, _ = np.linalg.svd(p[:, 3:7].reshape(-1, 2, 2))
        flat = np.einsum("nka,nkb->nba", frame[:, :2], turn)
        rotation = np.stack([flat[:, 0], flat[:, 1], np.cross(flat[:, 0], flat[:, 1])], 2)
        scales = np.concatenate([scale, self.start.scales[:, THIRD:]], 1)
        colour = np.maximum(p[:, 8:], 0.0)
        start = self.start
        moved = (self.seen > 0)[:, None]
        albedo = start.albedo
        if albedo is not None:
            ratio = _linear(colour) / np.maximum(_linear(start.rgb()), 1e-4)
            albedo = np.where(moved, np.clip(albedo * ratio, 0, 1), albedo).astype(np.float32)

        def choose(new: NDArray[np.floating], old: F32) -> F32:
            keep = moved if old.ndim == 2 else moved[:, 0]
            return np.where(keep, new, old).astype(np.float32)

        return replace(
            start,
            means=choose(means, start.means),
            quats=choose(quaternion_from_rotation(rotation), start.quats),
            scales=choose(np.maximum(scales, start.scales[:, THIRD:]), start.scales),
            opacities=choose(1 / (1 + np.exp(-p[:, 7])), start.opacities),
            sh=choose((colour - 0.5) / SH_C0, start.sh[:, 0])[:, None, :],
            albedo=albedo,
        )


def _linear(display: NDArray[np.floating]) -> F64:
    """Linear light of display values (IEC 61966-2-1)."""
    x = np.clip(np.asarray(display, np.float64), 0, 1)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
