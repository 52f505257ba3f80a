"""The renderer protocol: one scene, one camera, many views a call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.config import Config
from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64
from gn0.render.camera import Camera

ALPHA_CAP = 0.99  # gsplat main and the original 3DGS; gsplat 1.5.3 caps at 0.999
ALPHA_MIN = 1.0 / 255.0
TRANSMITTANCE_STOP = 1e-4
DILATION = 0.3  # px², added to both diagonal terms of the 2D covariance ("eps2d")
EXTENT_MAX = 3.33  # standard deviations

VISIBLE = "cpu-visible"  # backend name of the CPU renderer with visible sets
VISIBLE_CUDA = "cuda-visible"  # of the CUDA renderer with visible sets
VISIBLE_BACKENDS = {VISIBLE: "cpu", VISIBLE_CUDA: "cuda"}  # and who draws for them
VIEW_TOLERANCE = 1e-4  # how far a view's rotation may be from orthonormal

Output = Literal["rgb", "depth", "alpha"]


class RenderOptions(Config, frozen=True):
    """Image-formation settings.

    Attributes:
        background: colour behind everything, 0..1.
        antialiased: compensate opacity for the dilation (gsplat "antialiased" mode).
        rgb_float: return RGB as float32 (not clamped) instead of uint8.
        threads: worker threads; 0 means all. Never changes a byte of the result.
    """

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    antialiased: bool = False
    rgb_float: bool = False
    threads: int = 0


@dataclass(frozen=True, eq=False)
class RenderResult:
    """Pictures of V views; a field is None when it was not asked for.

    Attributes:
        rgb: uint8 [V, H, W, 3], or float32 with `rgb_float`.
        depth: camera z of the expected surface [V, H, W] float32 m; +inf where alpha < 0.5.
        alpha: accumulated opacity [V, H, W] float32 in 0..1.
    """

    rgb: NDArray[np.uint8] | F32 | None
    depth: F32 | None
    alpha: F32 | None


class Renderer(Protocol):
    """Renders one GaussianCloud. Built once per scene; safe to call from one thread at a time."""

    name: str

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = ("rgb", "depth", "alpha"),
        background: tuple[float, float, float] | None = None,
    ) -> RenderResult:
        """Render `views` (world-to-camera [4, 4] or [V, 4, 4]).

        `extra` holds moving splats (avatars), drawn with the static cloud and never copied into
        it. `background` overrides the option for this call.

        Raises:
            RenderError: a view is not finite or not a rigid transform.
        """
        ...


def check_views(views: NDArray[np.floating]) -> F64:
    """Views as float64 [V, 4, 4].

    Raises:
        RenderError: wrong shape, not finite, or not a rigid transform.
    """
    matrices = np.asarray(views, np.float64)
    if matrices.ndim == 2:
        matrices = matrices[None]
    if matrices.ndim != 3 or matrices.shape[1:] != (4, 4):
        raise RenderError(
            f"views have shape {matrices.shape}, expected [V, 4, 4]", remedy="world-to-camera"
        )
    finite = np.isfinite(matrices).all(axis=(1, 2))
    if not finite.all():
        raise RenderError("a view is not finite", where=f"view {int(np.argmin(finite))}")
    rotation = matrices[:, :3, :3]
    off = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bottom = np.abs(matrices[:, 3] - (0, 0, 0, 1)).max(axis=1)
    rigid = (off < VIEW_TOLERANCE) & (bottom < VIEW_TOLERANCE) & (np.linalg.det(rotation) > 0)
    if not rigid.all():
        raise RenderError(
            "a view is not a rigid transform",
            where=f"view {int(np.argmin(rigid))}",
            remedy="give a rotation and a translation, world to camera",
        )
    return matrices
