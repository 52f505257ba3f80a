"""The interface of the batch renderer over the CPU renderer: for machines without a GPU."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.renderer import Output, RenderOptions, RenderResult
from gn0.render.visible import RendererVisible

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
        self._floors: dict[str, tuple[str, OccupancyGrid, float]] = {}
        self._visible: dict[str, RendererVisible] = {}

    def holds(self, key: str) -> bool:
        """Whether a scene is loaded; any thread may ask."""
        return key in self._renderers

    def prepare(self, cloud: GaussianCloud) -> GaussianCloud:
        """What `load` may return instead: nothing else, here."""
        return cloud

    def limit_to_visible(
        self, key: str, cloud_hash: str, floor: OccupancyGrid, eye_height: float
    ) -> None:
        """Let `render(…, visible=True)` draw a scene from visible sets; see `RendererBatch`."""
        self._floors[key] = (cloud_hash, floor, eye_height)
        self._visible.pop(key, None)

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
        visible: bool = False,
    ) -> PicturesHost:
        """Draw `views` [V, 4, 4], each of the scene that `keys` names.

        `visible`: from visible sets, for scenes that have them.

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
            found = self._open(names[begin], visible).render(
                camera, views[begin:end], outputs=outputs, background=background
            )
            for name in outputs:
                parts[name].append(getattr(found, name))
            begin = end
        whole = {name: np.concatenate(arrays) for name, arrays in parts.items() if arrays}
        return PicturesHost(RenderResult(*(whole.get(n) for n in ("rgb", "depth", "alpha"))))

    def _open(self, key: str, visible: bool) -> RendererCpu | RendererVisible:
        if key not in self._loaders:
            raise RenderError(f"no scene {key!r} was added", remedy="call add(key, load) first")
        if key not in self._renderers:
            while len(self._renderers) >= KEPT:
                self._visible.pop(self._renderers.popitem(last=False)[0], None)
            self._renderers[key] = RendererCpu(self._loaders[key](), self.options)
        self._renderers.move_to_end(key)
        if not visible or key not in self._floors:
            return self._renderers[key]
        if key not in self._visible:
            self._visible[key] = RendererVisible(self._renderers[key], *self._floors[key])
        return self._visible[key]
