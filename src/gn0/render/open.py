"""Renderers by the name of their backend: which would run, why, and opening one."""

from __future__ import annotations

from functools import partial

from gn0.device.device import Device
from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.plugins import get_plugin
from gn0.render.renderer import (
    ALONE,
    VISIBLE,
    VISIBLE_BACKENDS,
    VISIBLE_CUDA,
    Renderer,
    RenderOptions,
)


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


def open_renderer(
    backend: str = "auto", options: RenderOptions | None = None, device: Device | None = None
) -> Renderer:
    """A renderer without scenes.

    Args:
        backend: "auto", "cpu", "cuda", or the name of a plug-in.
        options: image formation.
        device: draws, where the backend is "cuda"; what `open_device()` gives when None.

    Raises:
        ConfigError: no such backend, or one of visible sets, which need a floor.
        DeviceError: no usable card is here; says why and what to do.
    """
    name, _ = choose_backend(backend)
    if name in VISIBLE_BACKENDS:
        drawn = VISIBLE_BACKENDS[name]
        raise ConfigError(
            "visible sets need to know where eyes can be",
            remedy=f"use open_simulator, or open backend {drawn!r} and call limit_to_visible",
        )
    if name == "cuda":  # kernels are not needed to know the protocol
        from gn0.device.open import open_device
        from gn0.render.cuda.batch import RendererBatch

        return RendererBatch(device or open_device(), options)
    from gn0.render.host import RendererHost

    if name == "cpu":
        from gn0.render.cpu import RendererCpu
        from gn0.render.cpu_parts import NamedClouds
        from gn0.render.visible import RendererVisible

        build = partial(RendererCpu, named=NamedClouds())  # packed once for all scenes
        return RendererHost(
            *(name, build, options, RendererVisible),
            takes_parts=True,
            labels=True,
            takes_packed=True,
        )
    return RendererHost(name, get_plugin("renderer", name), options)


def build_renderer(
    cloud: GaussianCloud, backend: str = "auto", options: RenderOptions | None = None
) -> Renderer:
    """A renderer of one cloud: the scene that is drawn where no key is given.

    Raises:
        ConfigError: no such backend.
        RenderError: the cloud holds values that are not finite.
    """
    renderer = open_renderer(backend, options)
    renderer.keep(ALONE, cloud)
    return renderer
