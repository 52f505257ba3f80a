"""RendererGsplat: the same protocol through gsplat, as reference and as a fallback on a GPU.

Needs the extra `gsplat`: torch, and gsplat's own kernels, which its wheel compiles with nvcc at
first use (about a minute). The image formation is the house's (docs/renderer.md) but for one
constant: gsplat 1.5.3 caps a splat's alpha at 0.999; we, and gsplat's main branch, at 0.99.
Whether pictures are the same bytes on repeat is gsplat's business; it sorts stably.

`extra` splats are appended to the static ones on the device for the call. Views go in batches that
fit the free memory; when one does not, it is halved, and that is logged once.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import DeviceError, DeviceMemoryError, RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud, join_clouds
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.labels import refuse_labels
from gn0.render.renderer import (
    OUTPUTS,
    Output,
    RenderOptions,
    RenderResult,
    check_outputs,
    check_views,
)

_log = logging.getLogger(__name__)

_FIELDS = ("means", "quats", "scales", "opacities", "sh")
_SPLAT_BYTES = 112  # a splat and view while a batch is drawn, packed, SH 3 (measured: 74 to 96)
_PIXEL_BYTES = 64
_MEMORY_SHARE = 0.6  # of what is free: the estimate is rough
_INDEX_LIMIT = 2**31 - 1  # gsplat counts (view, splat) pairs in 32 bits

Splats = tuple[Any, ...]  # torch tensors: means, quats, scales, opacities, sh
Placed = tuple[Any, Any]  # torch tensors: viewmats [V, 4, 4], K [V, 3, 3]


class RendererGsplat:
    """Renders one cloud with `gsplat.rasterization`.

    Args:
        cloud: uploaded once.
        options: as for every renderer; `threads` has no meaning here.
        packed: gsplat's packed mode: less memory, usually quicker for many views.

    Raises:
        DeviceError: torch, gsplat, its kernels or a GPU is missing.
        RenderError: the cloud holds values that are not finite.
    """

    name = "gsplat"

    def __init__(
        self, cloud: GaussianCloud, options: RenderOptions | None = None, *, packed: bool = True
    ) -> None:
        self.options = options or RenderOptions()
        self.packed = packed
        self.size = len(cloud)
        self._torch = open_torch()
        self._rasterization = _open_rasterization()
        self._splats, self._degree = self._upload(cloud), cloud.sh_degree
        self._colours: Any = None  # [N, 3], once asked for, where they are the same all round
        self._batch = 0  # most views a call, once one did not fit

    def _upload(self, cloud: GaussianCloud) -> Splats:
        for name in _FIELDS:
            if not np.isfinite(getattr(cloud, name)).all():
                raise RenderError("cloud holds values that are not finite", where=f"cloud.{name}")
        return tuple(self._tensor(getattr(cloud, name)) for name in _FIELDS)

    def _tensor(self, array: NDArray[Any]) -> Any:
        writable = np.array(array, np.float32)  # torch warns of read-only memory
        return self._guard(lambda: self._torch.as_tensor(writable, device="cuda"))

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = OUTPUTS,
        background: tuple[float, float, float] | None = None,
    ) -> RenderResult:
        """Render `views` (world-to-camera [4, 4] or [V, 4, 4]); see `Renderer.render`.

        Raises:
            RenderError: a view is not finite or not rigid, an output is unknown, or a colour or
                a splat is not finite.
            DeviceMemoryError: not even one view fits.
            DeviceError: the GPU failed.
        """
        matrices = check_views(views)
        check_outputs(outputs)
        refuse_labels(outputs, self.name)
        colour = np.array(self.options.background if background is None else background, np.float32)
        if colour.shape != (3,) or not np.isfinite(colour).all():
            raise RenderError("background is not three finite numbers", where="background")
        splats, degree = self._splats, self._degree
        if extra is not None and len(extra):
            splats, degree = self._append(extra)
        shape = (len(matrices), camera.height, camera.width)
        rgb_type: Any = np.float32 if self.options.rgb_float else np.uint8
        result = RenderResult(
            np.empty((*shape, 3), rgb_type) if "rgb" in outputs else None,
            np.empty(shape, np.float32) if "depth" in outputs else None,
            np.empty(shape, np.float32) if "alpha" in outputs else None,
        )
        done = 0
        while done < len(matrices):
            views_now = min(self._views_a_call(camera, len(splats[0])), len(matrices) - done)
            part = slice(done, done + views_now)
            fits = True
            try:
                self._draw(camera, matrices[part], splats, degree, colour, result, part)
            except DeviceMemoryError:
                if views_now == 1:
                    raise
                fits = False
            if fits:
                done += views_now
            else:  # out here: inside, the error's frames still hold the tensors
                self._shrink(views_now // 2)
        return result

    def _append(self, extra: GaussianCloud) -> tuple[Splats, int]:
        """The static splats with the moving ones after them."""
        have = self._splats[-1].shape[1]
        wide = extra if extra.sh.shape[1] >= have else _widen(extra, have)
        static = self._splats
        if wide.sh.shape[1] > have:
            rows = np.zeros((self.size, wide.sh.shape[1] - have, 3), np.float32)
            static = (*static[:-1], self._torch.cat([static[-1], self._tensor(rows)], 1))
        moving = self._upload(wide)
        joined = self._guard(
            lambda: tuple(self._torch.cat([a, b], 0) for a, b in zip(static, moving, strict=True))
        )
        return joined, wide.sh_degree

    def _views_a_call(self, camera: Camera, splats: int) -> int:
        free, _ = self._torch.cuda.mem_get_info()
        cached = self._torch.cuda.memory_reserved() - self._torch.cuda.memory_allocated()
        view = splats * _SPLAT_BYTES + camera.width * camera.height * _PIXEL_BYTES
        fits = int((free + cached) * _MEMORY_SHARE) // max(view, 1)
        most = min(fits, _INDEX_LIMIT // max(splats, 1))
        return max(min(most, self._batch or most), 1)

    def _shrink(self, views: int) -> None:
        if not self._batch:
            _log.warning(
                "the GPU's memory holds no more than %d views of this scene at once", views
            )
        self._batch = views
        self._torch.cuda.empty_cache()

    def _draw(
        self,
        camera: Camera,
        matrices: F64,
        splats: Splats,
        degree: int,
        background: NDArray[np.float32],
        result: RenderResult,
        part: slice,
    ) -> None:
        """Draw a batch of views into their rows of `result`."""
        if not len(splats[0]):  # gsplat takes no empty arrays
            _fill_empty(result, part, background)
            return
        placed = self.place(camera, matrices)
        mode = "ED" if result.rgb is None else "RGB" if result.depth is None else "RGB+ED"
        colours, alphas = self.rasterize(camera, placed, mode=mode, splats=splats, degree=degree)
        self._guard(lambda: self._store(colours, alphas, background, result, part))

    def _store(
        self,
        colours: Any,
        alphas: Any,
        background: NDArray[np.float32],
        result: RenderResult,
        part: slice,
    ) -> None:
        torch = self._torch
        alpha = alphas[..., 0]  # [V, H, W]
        if result.rgb is not None:
            rgb = colours[..., :3]
            if background.any():  # gsplat 1.5.3 takes none in packed mode
                rgb = rgb + (1.0 - alphas) * self._tensor(background)
            if not self.options.rgb_float:
                rgb = (rgb.clamp(0.0, 1.0) * 255.0 + 0.5).to(torch.uint8)
            result.rgb[part] = rgb.cpu().numpy()
        if result.depth is not None:
            depth = torch.where(alpha < 0.5, float("inf"), colours[..., -1])
            result.depth[part] = depth.cpu().numpy()
        if result.alpha is not None:
            result.alpha[part] = alpha.cpu().numpy()

    def place(self, camera: Camera, views: NDArray[np.floating]) -> Placed:
        """Views [V, 4, 4] and the camera's K for each [V, 3, 3], on the GPU, for `rasterize`."""
        k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float32)
        return self._tensor(views), self._tensor(np.tile(k, (len(views), 1, 1)))

    def rasterize(
        self,
        camera: Camera,
        placed: Placed,
        *,
        mode: str = "RGB+ED",
        packed: bool | None = None,
        splats: Splats | None = None,
        degree: int | None = None,
    ) -> tuple[Any, Any]:
        """Call gsplat and nothing else: what a figure times; behind the splats is black.

        Args:
            camera: size, model and clipping depths.
            placed: from `place`.
            mode: gsplat's render mode.
            packed: overrides the renderer's.
            splats: other tensors than the renderer's own.
            degree: their SH degree.

        Returns:
            Colours [V, H, W, C] and alphas [V, H, W, 1] as torch tensors on the GPU.

        Raises:
            DeviceMemoryError: the GPU has too little memory for so many views.
            DeviceError: the GPU failed.
        """
        means, quats, scales, opacities, sh = splats or self._splats
        degree = self._degree if degree is None else degree
        colours, sh_degree = (sh, degree) if degree else (self._base_colours(sh), None)
        near = max(camera.near, 1e-6) if camera.model == "pinhole" else camera.near
        settings = {
            "sh_degree": sh_degree,
            "near_plane": near,
            "far_plane": camera.far,
            "packed": self.packed if packed is None else packed,
            "render_mode": mode,
            "rasterize_mode": "antialiased" if self.options.antialiased else "classic",
            "camera_model": camera.model,
        }

        def call() -> tuple[Any, Any]:
            with self._torch.no_grad():
                pictures, alphas, _ = self._rasterization(  # its third holds all intermediates
                    *(means, quats, scales, opacities, colours, *placed),
                    *(camera.width, camera.height),
                    **settings,
                )
            return pictures, alphas

        return self._guard(call)

    def _base_colours(self, sh: Any) -> Any:
        """Colours [N, 3] of SH 0: given them, gsplat saves its directions and harmonics."""
        own = sh is self._splats[-1]
        if own and self._colours is not None:
            return self._colours
        found = self._guard(lambda: (sh[:, 0] * SH_C0 + 0.5).clamp(0.0, float("inf")))
        if own:
            self._colours = found
        return found

    def _guard(self, call: Callable[[], Any]) -> Any:
        """Run a call; torch's errors become ours."""
        try:
            return call()
        except self._torch.cuda.OutOfMemoryError as error:
            raise DeviceMemoryError(
                "the GPU has too little memory", where="gsplat", remedy="render fewer views a call"
            ) from error
        except RuntimeError as error:
            raise DeviceError(f"the GPU failed: {str(error)[:300]}", where="gsplat") from error


def _widen(cloud: GaussianCloud, rows: int) -> GaussianCloud:
    """The cloud with zeros for the spherical harmonics that it lacks."""
    blank = cloud.select(slice(0, 0))
    shaped = GaussianCloud(
        means=blank.means,
        quats=blank.quats,
        scales=blank.scales,
        opacities=blank.opacities,
        sh=np.zeros((0, rows, 3), np.float32),
    )
    return join_clouds([cloud, shaped])


def _fill_empty(result: RenderResult, part: slice, background: NDArray[np.float32]) -> None:
    if result.rgb is not None:
        if result.rgb.dtype == np.uint8:
            result.rgb[part] = (np.clip(background, 0, 1) * np.float32(255) + 0.5).astype(np.uint8)
        else:
            result.rgb[part] = background
    if result.depth is not None:
        result.depth[part] = np.inf
    if result.alpha is not None:
        result.alpha[part] = 0


def open_torch() -> Any:
    """The torch module, when it is here and sees a GPU.

    Raises:
        DeviceError: it is not, or does not.
    """
    try:
        import torch
    except ImportError as error:
        raise DeviceError(
            f"torch is not installed ({error})", remedy="pip install -e '.[gsplat]'"
        ) from None
    if not torch.cuda.is_available():
        raise DeviceError("torch sees no GPU", remedy="use backend 'cpu'")
    return torch


def _open_rasterization() -> Callable[..., Any]:
    """The `rasterization` of gsplat, its kernels compiled or loaded."""
    try:
        from gsplat import rasterization
        from gsplat.cuda import _backend
    except ImportError as error:
        raise DeviceError(
            f"gsplat is not installed ({error})", remedy="pip install -e '.[gsplat]'"
        ) from None
    except (OSError, RuntimeError) as error:
        raise DeviceError(
            f"gsplat's kernels do not build or load: {str(error)[:300]}",
            remedy="see gsplat's notes on its wheels, or use backend 'cuda'",
        ) from None
    if getattr(_backend, "_C", None) is None:
        raise DeviceError(
            "gsplat found no CUDA toolkit to build its kernels with",
            remedy="install nvcc, or a wheel with kernels, or use backend 'cuda'",
        )
    return rasterization


def memory_peak(*, reset: bool = False) -> int:
    """Most bytes that torch has held on the GPU since the last reset."""
    torch = open_torch()
    peak = int(torch.cuda.max_memory_allocated())
    if reset:
        torch.cuda.reset_peak_memory_stats()
    return peak


def release_memory() -> None:
    """Give the GPU memory that torch keeps for later back to the driver."""
    open_torch().cuda.empty_cache()
