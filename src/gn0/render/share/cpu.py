"""The interface of the batch renderer over the CPU renderer: for machines without a GPU."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.renderer import Output, RenderOptions, RenderResult

KEPT = 4  # scenes


@dataclass(frozen=True, eq=False)
class PicturesHost:
    """Pictures that are in host memory already."""

    result: RenderResult

    def numpy(self) -> RenderResult:
        """The pictures."""
        return self.result


class RendererBatchCpu:
    """Many scenes, views of any of them in a call; the pictures of `RendererCpu`, byte for byte.

    Args:
        options: image formation.
    """

    name = "cpu"

    def __init__(self, options: RenderOptions | None = None) -> None:
        self.options = options or RenderOptions()
        self._loaders: dict[str, Callable[[], GaussianCloud]] = {}
        self._renderers: OrderedDict[str, RendererCpu] = OrderedDict()

    def add(self, key: str, load: Callable[[], GaussianCloud]) -> None:
        """Name a scene; it is loaded when it is first drawn."""
        self._loaders[key] = load

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        keys: Sequence[str] | str,
        *,
        outputs: tuple[Output, ...] = ("rgb", "depth", "alpha"),
        background: tuple[float, float, float] | None = None,
    ) -> PicturesHost:
        """Draw `views` [V, 4, 4], each of the scene that `keys` names.

        Raises:
            RenderError: a key is unknown, or a view is none.
        """
        names = [keys] * len(views) if isinstance(keys, str) else list(keys)
        parts: dict[str, list[NDArray[np.generic]]] = {name: [] for name in outputs}
        begin = 0
        while begin < len(names):
            end = begin
            while end < len(names) and names[end] == names[begin]:
                end += 1
            found = self._open(names[begin]).render(
                camera, views[begin:end], outputs=outputs, background=background
            )
            for name in outputs:
                parts[name].append(getattr(found, name))
            begin = end
        whole = {name: np.concatenate(arrays) for name, arrays in parts.items() if arrays}
        return PicturesHost(RenderResult(*(whole.get(n) for n in ("rgb", "depth", "alpha"))))

    def _open(self, key: str) -> RendererCpu:
        if key not in self._loaders:
            raise RenderError(f"no scene {key!r} was added", remedy="call add(key, load) first")
        if key not in self._renderers:
            while len(self._renderers) >= KEPT:
                self._renderers.popitem(last=False)
            self._renderers[key] = RendererCpu(self._loaders[key](), self.options)
        self._renderers.move_to_end(key)
        return self._renderers[key]
