"""Renderers by the name of their backend: which would run, why, and opening one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.maps.grid import OccupancyGrid
from gn0.plugins import get_plugin
from gn0.render.renderer import VISIBLE, VISIBLE_BACKENDS, VISIBLE_CUDA, Renderer, RenderOptions

if TYPE_CHECKING:
    from gn0.render.cuda.visible import RendererVisibleCuda
    from gn0.render.visible import RendererVisible


def choose_backend(backend: str = "auto") -> tuple[str, str]:
    """The backend that would run, and why, in one sentence.

    Raises:
        ConfigError: no such backend.
    """
    if backend == "auto":
        from gn0.device.open import find_device  # costs nothing until someone asks

        device, reason = find_device()
        if device is not None:
            return "cuda", f"the CUDA renderer on {reason}"
        return "cpu", f"the Numba renderer runs everywhere; {reason}"
    if backend in VISIBLE_BACKENDS:
        drawn = {VISIBLE: "Numba", VISIBLE_CUDA: "CUDA"}[backend]
        return backend, f"the {drawn} renderer, drawing from visible sets as asked for"
    get_plugin("renderer", backend)
    return backend, "asked for by name"


def name_drawing(backend: str) -> str:
    """The backend that draws for one with visible sets; any other draws for itself."""
    return VISIBLE_BACKENDS.get(backend, backend)


def visible_backend(backend: str = "auto") -> str:
    """The name of a backend with visible sets: "cpu-visible" or "cuda-visible".

    Raises:
        ConfigError: no such backend, or it has no visible sets.
    """
    name, _ = choose_backend(backend)
    for visible, drawn in VISIBLE_BACKENDS.items():
        if name in (visible, drawn):
            return visible
    raise ConfigError(
        f"renderer {name!r} has no visible sets",
        remedy=f"use backend {' or '.join(map(repr, VISIBLE_BACKENDS.values()))}",
    )


def build_renderer(
    cloud: GaussianCloud, backend: str = "auto", options: RenderOptions | None = None
) -> Renderer:
    """A renderer for a cloud.

    Raises:
        ConfigError: no such backend.
    """
    name, _ = choose_backend(backend)
    if name in VISIBLE_BACKENDS:
        drawn = VISIBLE_BACKENDS[name]
        raise ConfigError(
            "visible sets need to know where eyes can be",
            remedy=f"use open_simulator, or build_renderer(cloud, {drawn!r}) and limit_to_visible",
        )
    renderer: Renderer = get_plugin("renderer", name)(cloud, options or RenderOptions())
    return renderer


def limit_to_visible(
    renderer: Renderer, cloud_hash: str, floor: OccupancyGrid, eye_height: float
) -> RendererVisible | RendererVisibleCuda:
    """A renderer that draws from visible sets; see `gn0.render.visible.RendererVisible`.

    Args:
        renderer: draws; holds all splats.
        cloud_hash: content hash of its cloud.
        floor: free cells where eyes can be, inflated for the agent.
        eye_height: of the cameras [m].

    Raises:
        ConfigError: the backend has no visible sets.
    """
    if renderer.name == "cuda":  # kernels are not needed to know the protocol
        from gn0.render.cuda.renderer import RendererCuda
        from gn0.render.cuda.visible import RendererVisibleCuda

        if isinstance(renderer, RendererCuda):
            return RendererVisibleCuda(renderer, cloud_hash, floor, eye_height)
    from gn0.render.cpu import RendererCpu
    from gn0.render.visible import RendererVisible

    if isinstance(renderer, RendererCpu):
        return RendererVisible(renderer, cloud_hash, floor, eye_height)
    raise ConfigError(
        f"renderer {renderer.name!r} has no visible sets",
        remedy=f"use backend {' or '.join(map(repr, VISIBLE_BACKENDS.values()))}",
    )
