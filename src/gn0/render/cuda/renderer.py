"""RendererCuda: one scene on an NVIDIA card, behind the protocol of all renderers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device
from gn0.gaussians.cloud import GaussianCloud
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.pack import cloud_bytes
from gn0.render.cuda.replay import PicturesDevice
from gn0.render.cuda.visible import SceneSets, VisibleSets
from gn0.render.renderer import OUTPUTS, VISIBLE_CUDA, Output, RenderOptions, RenderResult
from gn0.render.visible_places import VisibleOptions

_KEY = "scene"


class RendererCuda:
    """Draws one cloud on a device; the cloud stays there. One thread at a time.

    Args:
        cloud: what to draw.
        options: image formation; `threads` means nothing here.
        device: draws; what `open_device()` gives when None.
    """

    name = "cuda"

    def __init__(
        self,
        cloud: GaussianCloud,
        options: RenderOptions | None = None,
        device: Device | None = None,
    ) -> None:
        """Bring the cloud to the device.

        Raises:
            RenderError: the cloud holds values that are not finite.
            DeviceError: no usable card is here; says why and what to do.
            DeviceMemoryError: the cloud is larger than the card's free memory.
        """
        if device is None:
            from gn0.device.open import open_device  # looks for a driver: not at import

            device = open_device()
        self.device = device
        self.options = options or RenderOptions()
        self.size = len(cloud)
        memory = cloud_bytes(self.size, cloud.sh_degree)
        self.batch = RendererBatch(device, self.options, memory)
        self.traits = self.batch.traits
        self.cloud = self.batch.store.keep(_KEY, cloud)

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
            DeviceError: the device has no memory for one view, or is lost.
        """
        return self.render_device(
            camera, views, extra=extra, outputs=outputs, background=background
        ).numpy()

    def render_device(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = OUTPUTS,
        background: tuple[float, float, float] | None = None,
        visible: VisibleSets | None = None,
    ) -> PicturesDevice:
        """The same, with pictures that stay on the device: for torch, CuPy, or more kernels.

        `visible`: sets to draw from where they apply, see `RendererVisibleCuda`.

        Raises:
            RenderError, DeviceError: see `render`.
        """
        return self.batch.draw(
            camera,
            views,
            _KEY,
            extra=extra,
            outputs=outputs,
            background=background,
            visible=visible,
        )


class RendererVisibleCuda(SceneSets):
    """A `RendererCuda` that draws from visible sets where it can.

    Views of a pinhole camera whose eye is at `eye_height` over a cell of `floor` use that cell's
    set; it is read from the cache or found the first time. All other views, and orthographic
    ones, use the full set. `extra` splats are always drawn.

    Args:
        renderer: draws; holds all splats.
        cloud_hash: content hash of its cloud.
        floor: where eyes can be: free cells, inflated for the agent.
        eye_height: of the cameras [m].
        options: how sets are found.
        cache: read and write the cache folder.
    """

    name = VISIBLE_CUDA

    def __init__(
        self,
        renderer: RendererCuda,
        cloud_hash: str,
        floor: OccupancyGrid,
        eye_height: float,
        options: VisibleOptions | None = None,
        *,
        cache: bool = True,
    ) -> None:
        sets = VisibleSets(
            renderer.batch.drawer,
            cloud_hash,
            floor,
            eye_height,
            options or VisibleOptions(),
            antialiased=renderer.options.antialiased,
            cache=cache,
        )
        super().__init__(sets, lambda: renderer.cloud)
        self.full = renderer

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = ("rgb", "depth", "alpha"),
        background: tuple[float, float, float] | None = None,
    ) -> RenderResult:
        """Render `views` (world-to-camera [4, 4] or [V, 4, 4]); see `Renderer.render`.

        Raises:
            RenderError, DeviceError: see `RendererCuda.render`.
        """
        return self.render_device(
            camera, views, extra=extra, outputs=outputs, background=background
        ).numpy()

    def render_device(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = ("rgb", "depth", "alpha"),
        background: tuple[float, float, float] | None = None,
    ) -> PicturesDevice:
        """The same, with pictures that stay on the device.

        Raises:
            RenderError, DeviceError: see `RendererCuda.render`.
        """
        return self.full.render_device(
            camera,
            views,
            extra=extra,
            outputs=outputs,
            background=background,
            visible=self.sets,
        )
