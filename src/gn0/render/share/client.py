"""Ask the drawing process for pictures: a `Renderer` that holds no splats."""

from __future__ import annotations

from collections import ChainMap, OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.encoding import DrawnViews, Encode, MapPicture
from gn0.render.instance import Instance, Parts, check_named, check_parts, digest_part
from gn0.render.open import name_drawing, visible_backend
from gn0.render.renderer import (
    ALL_OUTPUTS,
    ALONE,
    LABELS,
    OUTPUTS,
    VISIBLE_OF,
    Colour,
    DrawnScene,
    Output,
    RenderResult,
    Traits,
    VisibleScene,
    check_outputs,
    check_views,
)
from gn0.render.share.connection import DrawConnection
from gn0.render.share.messages import Floor
from gn0.render.share.parts import PartRows, Posed
from gn0.render.who import SeenInstance, WhoPictures

VIEWS = 32  # of a request at most: one area holds their pictures
POSES = 4096  # names of posed people that are known at a time


class RendererShared:
    """A `Renderer` whose pictures are drawn by another process; it holds no splats itself.

    Args:
        connection: to that process; of one thread.
        name: name of the backend that draws.

    Attributes:
        traits: what the other process can do.

    Raises:
        DeviceError: the drawing process is gone.
    """

    def __init__(self, connection: DrawConnection, name: str) -> None:
        self.name = name
        self._connection = connection
        self._sources: dict[str, dict[str, Any]] = {}
        self._floors: dict[str, Floor] = {}
        self._parts: dict[str, tuple[GaussianCloud, str]] = {}
        self._posed: OrderedDict[str, Posed] = OrderedDict()

    @property
    def poses(self) -> bool:
        """Whether the drawing process poses people itself.

        Raises:
            DeviceError: it is gone.
        """
        return self._connection.drawn_by.poses

    @property
    def _known(self) -> Mapping[str, object]:
        """By the names of clouds that instances may have."""
        return ChainMap[str, object](self._posed, self._parts)  # type: ignore[arg-type]

    @cached_property
    def traits(self) -> Traits:
        """What the drawing process is and can do.

        Raises:
            DeviceError: it is gone.
        """
        encodes = name_drawing(self.name) != "cpu"
        drawn_by = self._connection.drawn_by
        return Traits(
            drawn_by.name,
            visible_sets=name_drawing(self.name) in VISIBLE_OF,
            encoder=partial(SceneEncoder, self) if encodes else None,
            labels=drawn_by.labels,
        )

    def add_source(self, key: str, source: Mapping[str, Any]) -> DrawnScene:
        """Name a scene by how the other process loads its splats; equal keys mean equal splats."""
        if self._sources.get(key) != source:
            self._sources[key] = dict(source)
            self._floors.pop(key, None)
        return DrawnScene(self, key)

    def name_cloud(self, name: str, cloud: GaussianCloud) -> None:
        """Make a cloud known by a name; see `Renderer.name_cloud`. It is sent when first drawn.

        Raises:
            RenderError: the name or the cloud cannot be a part's.
        """
        known = self._parts.get(name)
        if known is None or known[0] is not cloud:
            check_named(name, cloud)
            self._parts[name] = (cloud, digest_part(cloud))

    def name_posed(self, source: Mapping[str, Any], how: tuple[str | int | float, ...]) -> str:
        """A name for instances of somebody in a pose, of whom no splats are sent.

        The latest `POSES` names are known.

        Args:
            source: who, and where the drawing process finds it, as its poser takes it.
            how: the pose, likewise.

        Raises:
            DeviceError: the drawing process is gone.
        """
        posed = Posed(self._connection.tell_player(source), how)
        name = f"posed {posed.player} {' '.join(map(str, how))}"
        self._posed[name] = posed
        self._posed.move_to_end(name)
        while len(self._posed) > POSES:
            self._posed.popitem(last=False)
        return name

    def add(self, key: str, load: Callable[[], Any], digest: str = "") -> None:
        """Name a scene by its splats.

        Raises:
            ConfigError: always: splats do not travel, see `add_source`.
        """
        raise ConfigError(
            "splats are not sent to the drawing process",
            remedy="say how it loads them: add_source(key, source)",
        )

    def keep(self, key: str, cloud: GaussianCloud, digest: str = "") -> None:
        """As `add`.

        Raises:
            ConfigError: always, see `add`.
        """
        self.add(key, lambda: cloud, digest)

    def remove(self, key: str) -> None:
        """Forget a scene here; the other process lets go of it as others need the room."""
        self._sources.pop(key, None)
        self._floors.pop(key, None)

    def holds(self, key: str) -> bool:
        """Whether a scene can be asked for."""
        return key in self._sources

    def prepare(self, cloud: GaussianCloud, like: Any = None) -> GaussianCloud:
        """Nothing can be done beforehand here."""
        return cloud

    def limit_to_visible(
        self, key: str, cloud_hash: str, floor: OccupancyGrid, eye_height: float
    ) -> None:
        """Let `visible=True` draw a scene from visible sets; see `Renderer.limit_to_visible`.

        Raises:
            ConfigError: the backend has no visible sets.
        """
        visible_backend(self.name)
        self._floors[key] = Floor.of_grid(cloud_hash, floor, eye_height)

    def open_sets(self, key: str) -> VisibleScene:
        """The visible sets of a scene.

        Raises:
            RenderError: always: the other process has them.
        """
        raise RenderError("visible sets are kept by the drawing process", where=repr(key))

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
        """Draw views [V, 4, 4], `VIEWS` of a scene a request; see `Renderer.draw`.

        Raises:
            RenderError: a view is invalid, a scene is unknown, or `extra` splats are given: they do
                not travel.
            DeviceError: the device or the drawing process is lost.
        """
        if extra is not None and len(extra):
            raise RenderError("moving splats are not sent to another process")
        matrices = check_views(views)
        check_outputs(outputs)
        if not isinstance(keys, str) and len(keys) != len(matrices):
            raise RenderError(f"{len(keys)} keys for {len(matrices)} views", where="keys")
        moving = check_parts(parts, len(matrices), self._known) if parts else []
        some = [
            self.ask(
                key, camera, matrices[rows], outputs, background,
                visible=visible, millimetres=millimetres, parts=moving[rows],
            ).pictures
            for key, rows in _find_requests(keys, len(matrices) if outputs else 0)
        ]  # fmt: skip
        found: dict[str, Any] = {}
        for name in outputs:
            arrays = [pictures[name] for pictures in some]
            found[name] = (
                arrays[0] if len(arrays) == 1
                else np.concatenate(arrays) if arrays
                else _empty(name, camera, millimetres)
            )  # fmt: skip
        return RenderResult(*(found.get(name) for name in ALL_OUTPUTS))

    render = draw

    def ask(
        self,
        key: str,
        camera: Camera,
        views: NDArray[np.floating],
        outputs: tuple[Output, ...],
        background: Colour | None = None,
        *,
        visible: bool = False,
        millimetres: bool = False,
        encode: Encode | None = None,
        shown: MapPicture | None = None,
        parts: Parts = (),
    ) -> DrawnViews:
        """One request: at most `VIEWS` views [V, 4, 4] of a scene, and files of them.

        Raises:
            RenderError: a view is invalid, there are too many, the scene is unknown, or `parts`
                have no meaning.
            DeviceError: the device or the drawing process is lost.
        """
        matrices = check_views(views)
        if not 0 < len(matrices) <= VIEWS:
            raise RenderError(f"{len(matrices)} views in a request", remedy=f"give 1 to {VIEWS}")
        source = self._source(key)
        moving = check_parts(parts, len(matrices), self._known) if parts else []
        return self._connection.draw(
            key, source, camera, matrices, outputs, background, encode,
            self._floors.get(key) if visible else None, millimetres=millimetres, shown=shown,
            parts=self._send_parts(moving),
        )  # fmt: skip

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
            RenderError: as `draw`, or what draws over there cannot tell.
            DeviceError: the device or the drawing process is lost.
        """
        matrices = check_views(views)
        if not isinstance(keys, str) and len(keys) != len(matrices):
            raise RenderError(f"{len(keys)} keys for {len(matrices)} views", where="keys")
        moving = check_parts(parts, len(matrices), self._known)
        numbers = np.zeros((len(matrices), camera.height, camera.width), np.uint32)
        seen: list[list[SeenInstance]] = []
        for key, rows in _find_requests(keys, len(matrices)):
            found = self._connection.tell_who(
                key, self._source(key), camera, matrices[rows], self._send_parts(moving[rows]),
                self._floors.get(key) if visible else None,
            )  # fmt: skip
            numbers[rows] = found.numbers
            seen += found.seen
        return WhoPictures(numbers, seen)

    def _source(self, key: str) -> dict[str, Any]:
        if key not in self._sources:
            raise RenderError(f"no scene {key!r} was added", remedy="call add_source first")
        return self._sources[key]

    def _send_parts(self, moving: Sequence[Sequence[Instance]]) -> PartRows | None:
        """Instances for the way, after clouds of theirs that were not sent yet; None of none."""
        if not any(moving):
            return None
        used = {one.cloud for instances in moving for one in instances}
        sent = sorted(used - self._posed.keys())
        for name in sent:
            self._connection.send_cloud(*self._parts[name], name)
        return PartRows.of_parts(moving, {name: name for name in sent}, self._posed)


@dataclass(frozen=True, eq=False)
class SceneEncoder:
    """Asks the drawing process a scene for files of its pictures.

    Attributes:
        renderer: asks.
        key: key of the scene.
        visible: draw from visible sets.
    """

    renderer: RendererShared
    key: str
    visible: bool = False

    def render_files(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        encode: Encode,
        background: Colour | None = None,
        outputs: tuple[Output, ...] = ("rgb",),
        shown: MapPicture | None = None,
        parts: Parts = (),
    ) -> DrawnViews:
        """Pictures of at most `VIEWS` views [V, 4, 4], and files of the colour ones.

        `shown` is the map that the dots of `encode` are on. Depth, where `outputs` name it, comes
        as uint16 millimetres, see `gn0.render.depth`.

        Raises:
            RenderError: a view is invalid, or there are too many.
            DeviceError: the device or the drawing process is lost.
        """
        return self.renderer.ask(
            self.key, camera, views, outputs, background, visible=self.visible,
            millimetres="depth" in outputs, encode=encode, shown=shown, parts=parts,
        )  # fmt: skip


def _find_requests(keys: Sequence[str] | str, count: int) -> Iterator[tuple[str, slice]]:
    """Neighbours of one scene, at most `VIEWS` at a time."""
    begin = 0
    while begin < count:
        key = keys if isinstance(keys, str) else keys[begin]
        end = begin + 1
        while end < count and end - begin < VIEWS and (isinstance(keys, str) or keys[end] == key):
            end += 1
        yield key, slice(begin, end)
        begin = end


def _empty(name: str, camera: Camera, millimetres: bool) -> NDArray[Any]:
    """Pictures of no views."""
    shape = (0, camera.height, camera.width)
    if name == "rgb":
        return np.zeros((*shape, 3), np.uint8)
    if name in LABELS:
        return np.zeros(shape, np.uint32)
    return np.zeros(shape, np.uint16 if name == "depth" and millimetres else np.float32)
