"""RendererHost: many scenes over a renderer of one cloud, with pictures in host memory.

The renderers that draw one cloud (the CPU's, gsplat's, a plug-in's) need to know nothing else;
scenes, their keys and their visible sets are kept here.
"""

from __future__ import annotations

from collections import ChainMap, OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError, RenderError
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.instance import Instance, Parts, check_name, check_named, check_parts, move_instance
from gn0.render.labels import refuse_labels
from gn0.render.renderer import (
    ALL_OUTPUTS,
    ALONE,
    LABELS,
    OUTPUTS,
    VISIBLE_BACKENDS,
    Colour,
    Load,
    Output,
    RenderOptions,
    RenderResult,
    SceneRenderer,
    Traits,
    VisibleScene,
    check_outputs,
    check_views,
)
from gn0.render.who import WhoPictures

if TYPE_CHECKING:
    from gn0.render.cpu_posed import PosedPacked

KEPT = 4  # scenes that are loaded at a time
Build = Callable[[GaussianCloud, RenderOptions], SceneRenderer]
Limit = Callable[[Any, str, OccupancyGrid, float], Any]


@dataclass(frozen=True, eq=False)
class _Named:
    """Where a scene's cloud comes from; `kept` ones are never dropped to make room."""

    load: Load
    digest: str
    kept: bool = False


class RendererHost:
    """Draws views of many scenes, each by a renderer of its own.

    Args:
        name: name of the backend.
        build: a renderer of one cloud.
        options: image formation, for all scenes.
        limit: makes of such a renderer one that draws from visible sets; None: it has none.
        takes_parts: whether such a renderer draws instances; else their splats are moved for it.
        labels: whether such a renderer draws "semantic" and "instance".
        takes_packed: whether it draws instances of posed clouds as `name_packed` takes them.
    """

    def __init__(
        self,
        name: str,
        build: Build,
        options: RenderOptions | None = None,
        limit: Limit | None = None,
        *,
        takes_parts: bool = False,
        labels: bool = False,
        takes_packed: bool = False,
    ) -> None:
        self.name, self.takes_packed = name, takes_packed
        self.options = options or RenderOptions()
        self.traits = Traits(
            name, self.options.antialiased, visible_sets=limit is not None, labels=labels
        )
        self._build, self._limit = build, limit
        self._named: dict[str, _Named] = {}
        self._renderers: OrderedDict[str, SceneRenderer] = OrderedDict()  # least recent first
        self._floors: dict[str, tuple[str, OccupancyGrid, float]] = {}
        self._visible: dict[str, Any] = {}
        self._takes_parts = takes_parts
        self._parts: dict[str, GaussianCloud] = {}  # clouds by name
        self._packed: WeakValueDictionary[str, PosedPacked] = WeakValueDictionary()

    def add(self, key: str, load: Load, digest: str = "") -> None:
        """Name a scene; see `Renderer.add`."""
        self._name(key, _Named(load, digest))

    def keep(self, key: str, cloud: GaussianCloud, digest: str = "") -> None:
        """Name a scene that stays; see `Renderer.keep`.

        Raises:
            RenderError: the cloud holds values that are not finite.
        """
        self.remove(key)
        self._renderers[key] = self._build(cloud, self.options)
        self._named[key] = _Named(_no_load, digest, kept=True)

    def _name(self, key: str, named: _Named) -> None:
        known = self._named.get(key)
        same = known is not None and (
            known.digest == named.digest
            if named.digest or known.digest
            else known.load == named.load
        )
        if not same:
            self.remove(key)
            self._named[key] = named
        elif known is not None and not known.kept:
            self._named[key] = named

    def remove(self, key: str) -> None:
        """Forget a scene, and its floor."""
        for kept in (self._named, self._renderers, self._floors, self._visible):
            kept.pop(key, None)

    def name_cloud(self, name: str, cloud: GaussianCloud) -> None:
        """Make a cloud known by a name; see `Renderer.name_cloud`.

        Raises:
            RenderError: the name or the cloud cannot be a part's.
        """
        if self._parts.get(name) is not cloud:
            check_named(name, cloud)
            self._packed.pop(name, None)
            self._parts[name] = cloud

    def name_packed(self, name: str, posed: PosedPacked) -> None:
        """Make a posed cloud known by a name, as long as somebody holds it.

        Raises:
            RenderError: no name.
        """
        check_name(name)
        self._parts.pop(name, None)
        self._packed[name] = posed

    def holds(self, key: str) -> bool:
        """Whether a scene is loaded; any thread may ask."""
        return key in self._renderers

    def prepare(self, cloud: GaussianCloud, like: Any = None) -> GaussianCloud:
        """What `load` may return instead: nothing else, here."""
        return cloud

    def limit_to_visible(
        self, key: str, cloud_hash: str, floor: OccupancyGrid, eye_height: float
    ) -> None:
        """Let `visible=True` draw a scene from visible sets; see `Renderer.limit_to_visible`.

        Raises:
            ConfigError: the backend has none.
        """
        if self._limit is None:
            raise ConfigError(
                f"renderer {self.name!r} has no visible sets",
                remedy=f"use backend {' or '.join(map(repr, VISIBLE_BACKENDS.values()))}",
            )
        self._floors[key] = (cloud_hash, floor, eye_height)
        self._visible.pop(key, None)

    def open_sets(self, key: str) -> VisibleScene:
        """The visible sets of a scene.

        Raises:
            RenderError: it was not limited to them.
        """
        if key not in self._floors:
            raise RenderError(
                f"scene {key!r} has no visible sets", remedy="call limit_to_visible first"
            )
        sets: VisibleScene = self._open(key, True)  # type: ignore[assignment]
        return sets

    def draw(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        keys: Sequence[str] | str = ALONE,
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = OUTPUTS,
        background: Colour | None = None,
        visible: bool = False,
        millimetres: bool = False,
        parts: Parts = (),
    ) -> RenderResult:
        """Draw views; see `Renderer.draw`. Neighbours of one scene are one call of its renderer.

        Raises:
            RenderError: a key is unknown, `parts` have no meaning, labels are wanted and it draws
                none, or see `SceneRenderer.render`.
        """
        if not self.traits.labels:
            refuse_labels(outputs, self.name)
        if isinstance(keys, str) and not parts:
            runs = [(keys, views, slice(None))]
        else:
            views = check_views(views)
            names = [keys] * len(views) if isinstance(keys, str) else keys
            if len(names) != len(views):
                raise RenderError(f"{len(names)} keys for {len(views)} views", where="keys")
            runs = [(names[rows.start], views[rows], rows) for rows in _find_runs(names)]
        moving = self._check_parts(parts, len(views)) if parts else []
        named: dict[str, Any] = {"extra": extra, "outputs": outputs, "background": background}
        found = []
        for key, some, rows in runs:
            renderer = self._open(key, visible)
            if not any(moving[rows]):
                found.append(renderer.render(camera, some, **named))
            elif self._takes_parts:
                self._tell(renderer, moving[rows])
                found.append(renderer.render(camera, some, **named, parts=moving[rows]))  # type: ignore[call-arg]
            else:
                for view, instances in zip(some, moving[rows], strict=True):
                    named["extra"] = self._move(extra, instances)
                    found.append(renderer.render(camera, view, **named))
                named["extra"] = extra
        whole = found[0] if len(found) == 1 else _join(found, camera, outputs, self.options)
        return whole.in_millimetres() if millimetres else whole

    render = draw

    def render_who(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        keys: Sequence[str] | str = ALONE,
        *,
        parts: Parts,
        visible: bool = False,
    ) -> WhoPictures:
        """Which instance each pixel shows, and how much of each is seen; arguments as for `draw`.

        Raises:
            RenderError: as `draw`, or the backend cannot tell.
        """
        views = check_views(views)
        names = [keys] * len(views) if isinstance(keys, str) else list(keys)
        if len(names) != len(views):
            raise RenderError(f"{len(names)} keys for {len(views)} views", where="keys")
        moving = self._check_parts(parts, len(views))
        numbers = np.zeros((len(views), camera.height, camera.width), np.uint32)
        seen = []
        for rows in _find_runs(names):
            renderer: Any = self._open(names[rows.start], visible)
            if not hasattr(renderer, "render_who"):
                raise RenderError(
                    f"renderer {self.name!r} cannot tell who is who", remedy="use backend 'cpu'"
                )
            self._tell(renderer, moving[rows])
            found = renderer.render_who(camera, views[rows], parts=moving[rows])
            numbers[rows] = found.numbers
            seen += found.seen
        return WhoPictures(numbers, seen)

    def _tell(self, renderer: Any, moving: Sequence[Sequence[Instance]]) -> None:
        """Make the clouds of some instances known to a renderer of one scene."""
        for name in dict.fromkeys(one.cloud for instances in moving for one in instances):
            posed = self._packed.get(name)
            if posed is not None:
                renderer.name_packed(name, posed)
            else:
                renderer.name_cloud(name, self._parts[name])

    def _check_parts(self, parts: Parts, views: int) -> list[tuple[Instance, ...]]:
        known: ChainMap[str, Any] = ChainMap(self._parts, self._packed)
        return check_parts(parts, views, known)

    def _move(
        self, extra: GaussianCloud | None, instances: Sequence[Instance]
    ) -> GaussianCloud | None:
        """The splats of instances where they stand, behind those of `extra`."""
        moved = [move_instance(self._parts[one.cloud], one) for one in instances]
        clouds = [cloud for cloud in (extra, *moved) if cloud is not None and len(cloud)]
        return join_clouds(clouds) if clouds else None

    def _open(self, key: str, visible: bool) -> SceneRenderer:
        if key not in self._named:
            raise RenderError(f"no scene {key!r} was added", remedy="call add(key, load) first")
        if key not in self._renderers:
            idle = [name for name in self._renderers if not self._named[name].kept]
            while len(idle) >= KEPT:  # let go before loading, not after
                self._visible.pop(idle[0], None)
                self._renderers.pop(idle.pop(0))
            self._renderers[key] = self._build(self._named[key].load(), self.options)
        self._renderers.move_to_end(key)
        if not visible or key not in self._floors or self._limit is None:
            return self._renderers[key]
        if key not in self._visible:
            self._visible[key] = self._limit(self._renderers[key], *self._floors[key])
        drawn: SceneRenderer = self._visible[key]
        return drawn


def _find_runs(keys: Sequence[str]) -> list[slice]:
    """Where neighbours have the same key."""
    starts = [v for v in range(len(keys)) if not v or keys[v] != keys[v - 1]]
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(keys)], strict=True)]


def _join(
    parts: Sequence[RenderResult], camera: Camera, outputs: tuple[Output, ...],
    options: RenderOptions,
) -> RenderResult:  # fmt: skip
    """Pictures of several calls, one after the other; those of no view where there is none."""
    check_outputs(outputs)
    found: dict[str, Any] = {}
    for name in outputs:
        if parts:
            found[name] = np.concatenate([getattr(part, name) for part in parts])
        else:
            kind: type = np.float32 if name != "rgb" or options.rgb_float else np.uint8
            kind = np.uint32 if name in LABELS else kind
            shape = (0, camera.height, camera.width, *((3,) if name == "rgb" else ()))
            found[name] = np.zeros(shape, kind)
    return RenderResult(*(found.get(name) for name in ALL_OUTPUTS))


def _no_load() -> GaussianCloud:
    raise RenderError("a cloud that was to stay has been dropped", where="RendererHost")
