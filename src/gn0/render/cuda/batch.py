"""RendererBatch: many views of many scenes, each with a moving tail, in one call on a device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary, ref

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.errors import DeviceMemoryError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cuda.calls import Call, Record, name_call
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.depth import scale_on_device
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.held import HeldScenes
from gn0.render.cuda.instances import Instances
from gn0.render.cuda.pack import CloudReady, prepare_cloud
from gn0.render.cuda.parts import (
    bring_tails,
    choose_parts,
    find_parts,
    views_of,
)
from gn0.render.cuda.posed import ReadyPoses, RestCloud, RestDevice, bring_rest
from gn0.render.cuda.replay import PicturesDevice, SetMissingError
from gn0.render.cuda.request import (
    check_chosen,
    check_picture,
    choose_keys,
    name_all,
    number_keys,
)
from gn0.render.cuda.store import Load
from gn0.render.cuda.visible import Cell, SceneSets, VisibleSets, lock_of
from gn0.render.cuda.who import WhoDevice, count_all, draw_alone, empty_who
from gn0.render.instance import Parts, PartsDevice, check_parts
from gn0.render.renderer import (
    ALONE,
    OUTPUTS,
    Colour,
    Output,
    RenderOptions,
    RenderResult,
    Traits,
    check_views,
)
from gn0.render.visible_places import VisibleOptions
from gn0.render.who import WhoPictures

_drawers: WeakKeyDictionary[Device, ref[Drawer]] = WeakKeyDictionary()


class RendererBatch:
    """Draws views of many scenes, each kept on the device while there is room.

    Args:
        device: draws.
        options: image formation, for all scenes; `threads` means nothing here.
        memory: bytes that clouds may take; 0.6 of what is free now when None.
        sets_memory: bytes that the visible sets of all scenes together may take; a tenth of what
            is free now when None.
    """

    name = "cuda"

    def __init__(
        self,
        device: Device,
        options: RenderOptions | None = None,
        memory: int | None = None,
        *,
        sets_memory: int | None = None,
    ) -> None:
        self.device = device
        self.options = options or RenderOptions()
        self.traits = Traits(
            # the emulation's last bits are not a card's: what is kept of it goes by another name
            self.name if device.kind == "cuda" else f"{self.name} on {device.kind}",
            self.options.antialiased,
            visible_sets=True,
            device=device,
            device_views=True,
            labels=True,
        )
        self._held = HeldScenes(device, self.options, memory, sets_memory)
        self.store, self._sets, self._named = self._held.store, self._held.sets, self._held.named
        self.drawer = share_drawer(device)
        self._skip = self._wait = 0  # calls until views on the device are tried with sets again

    @property
    def sets_memory(self) -> int:
        """Bytes that the visible sets of all scenes together may take."""
        return self._held.sets_memory

    @sets_memory.setter
    def sets_memory(self, limit: int) -> None:
        self._held.sets_memory = limit

    def __contains__(self, key: str) -> bool:
        return key in self.store

    def holds(self, key: str) -> bool:
        """Whether a scene's splats are on the device; any thread may ask."""
        return self.store.holds(key)

    def prepare(self, cloud: GaussianCloud, like: CloudReady | None = None) -> CloudReady:
        """The host's share of bringing a cloud here; any thread may do it, and `load` return it.

        `like`: what this gave for the same splats in other colours.

        Raises:
            RenderError: the cloud cannot be drawn.
        """
        return prepare_cloud(cloud, like=like)

    def add(self, key: str, load: Load, digest: str = "") -> None:
        """Name a scene; its cloud is loaded when it is first drawn, and again after it gave way.

        Args:
            key: of the scene, or of the scene in a light (`gn0.sim.open.name_look`).
            load: gives the cloud, or what `prepare` made of it; may run in a thread of its own.
            digest: content hash of that cloud (`gn0.sim.open.look_hash`). The same key with
                another hash drops the old splats and sets. Without hashes, another `load` does.
        """
        if self.store.add(key, load, digest):
            self._held.drop_sets(key)

    def keep(self, key: str, cloud: GaussianCloud, digest: str = "") -> CloudDevice:
        """Bring a scene here now, to stay until it is removed; see `Renderer.keep`.

        Raises:
            RenderError: the cloud holds values that are not finite.
            DeviceMemoryError: it is larger than the memory for clouds.
        """
        self._held.drop_sets(key)
        return self.store.keep(key, cloud, digest)

    def name_cloud(self, name: str, cloud: GaussianCloud) -> None:
        """Make a cloud known by a name, for instances of it; replaces what had the name before.

        It is brought to the device now, and stays: the same cloud under the same name again costs
        nothing.

        Raises:
            RenderError: no name, too many splats, or values that are not finite.
            DeviceMemoryError: the device has no room for it.
        """
        with lock_of(self.device):
            self._named.hold(name, cloud, self._held.with_room)

    def slot_of(self, name: str) -> int:
        """The slot of a named cloud in the table that `PartsDevice` without names refers to.

        Raises:
            RenderError: no cloud has this name.
        """
        return self._named.slot_of(name)

    def bring_rest(self, cloud: RestCloud) -> RestDevice:
        """Bring a person at rest here, to be posed.

        Raises:
            RenderError: it cannot be posed here.
            DeviceMemoryError: the device has no room for it.
        """
        with lock_of(self.device):
            return self._held.with_room(lambda: bring_rest(self.device, cloud))

    def pose_parts(
        self, rests: Sequence[RestDevice], which: NDArray[np.integer], ready: ReadyPoses
    ) -> list[int]:
        """Slots of clouds in poses, made by one launch; they stay until `drop_parts`.

        Args:
            rests: of whom, once each.
            which: of those, for each pose [n], one at least.
            ready: how.

        Raises:
            DeviceMemoryError: the device has no room for them.
        """
        with lock_of(self.device):
            return self._held.with_room(lambda: self._named.pose(rests, which, ready))

    def drop_parts(self, slots: Sequence[int]) -> None:
        """Free slots that `pose_parts` gave."""
        with lock_of(self.device):
            self._named.drop(slots)

    def name_part(self, slot: int) -> str:
        """The name of a slot that `pose_parts` gave, for `Instance`."""
        return self._named.name_of(slot)

    def remove(self, key: str) -> None:
        """Forget a scene."""
        self.store.remove(key)
        self._held.drop_sets(key)

    def limit_to_visible(
        self,
        key: str,
        cloud_hash: str,
        floor: OccupancyGrid,
        eye_height: float,
        options: VisibleOptions | None = None,
        *,
        cache: bool = True,
    ) -> VisibleSets:
        """Let `render(…, visible=True)` draw a scene from visible sets.

        Args:
            key: of a scene that was added.
            cloud_hash: content hash of its geometry (its light does not matter).
            floor: free cells where eyes can be, inflated for the agent.
            eye_height: of the cameras [m].
            options: how sets are found.
            cache: read and write the cache folder.

        Raises:
            RenderError: no such scene.
        """
        self.store.digest(key)
        sets = VisibleSets(
            self.drawer,
            cloud_hash,
            floor,
            eye_height,
            options or VisibleOptions(),
            antialiased=self.options.antialiased,
            cache=cache,
        )
        self._sets[key] = sets
        self._held.forget_calls()
        return sets

    def open_sets(self, key: str) -> SceneSets:
        """The visible sets of a scene; see `Renderer.open_sets`.

        Raises:
            RenderError: it was not limited to them.
        """
        if key not in self._sets:
            raise RenderError(
                f"scene {key!r} has no visible sets", remedy="call limit_to_visible first"
            )
        return SceneSets(self._sets[key], lambda: self.store.open(key))

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating] | DeviceArray,
        keys: Sequence[str | None] | str = ALONE,
        *,
        extra: GaussianCloud | None = None,
        parts: Parts | PartsDevice = (),
        outputs: tuple[Output, ...] = OUTPUTS,
        background: Colour | None = None,
        visible: bool = False,
        millimetres: bool = False,
    ) -> RenderResult:
        """As `draw`, with pictures in host memory.

        Raises:
            RenderError, DeviceError: see `draw`.
        """
        return self.draw(
            camera,
            views,
            keys,
            extra=extra,
            parts=parts,
            outputs=outputs,
            background=background,
            visible=visible,
            millimetres=millimetres,
        ).numpy()

    def draw(
        self,
        camera: Camera,
        views: NDArray[np.floating] | DeviceArray,
        keys: Sequence[str | None] | str = ALONE,
        *,
        chosen: DeviceArray | None = None,
        extra: GaussianCloud | None = None,
        tails: Sequence[GaussianCloud | None] | GaussianCloud | None = None,
        parts: Parts | PartsDevice = (),
        outputs: tuple[Output, ...] = OUTPUTS,
        background: Colour | None = None,
        visible: bool | VisibleSets | Sequence[Cell | None] | None = None,
        millimetres: bool = False,
    ) -> PicturesDevice:
        """Draw `views`, each of its own scene; the pictures stay on the device.

        Returns when it is certain that they will be drawn; they may still be under way, as
        everything on the device is that was launched.

        Views on the device are read there: nothing is waited for before all is queued. `tails`,
        scenes that do not fit together, and visible sets that are not on the device yet are
        arranged by the host, which then reads the views first.

        Args:
            camera: of all views.
            views: world-to-camera [4, 4] or [V, 4, 4]; on the device float64 [V, 4, 4].
            keys: scene of each view, in any order, or one for all.
            chosen: int32 [V] on the device, as `views` are: the scene of each view as a number
                into `keys`, of any length. All of `keys` are brought here; None is a number that
                no view may choose.
            extra: moving splats of all views, drawn after the scene's at equal depth.
            tails: the same of each view, or of all. Views may share one cloud: it is brought
                over once.
            parts: instances of clouds that have names here (`name_cloud`), drawn after all else at
                equal depth: of all views, or a sequence of each; or with poses on the device, for
                views there.
            outputs: what to draw.
            background: colour behind everything, 0..1; the option when None.
            visible: True takes the visible set where each eye is, for scenes that have sets
                (`limit_to_visible`); sets do so for this call alone; or name a cell (column, row)
                a view, None for all splats.
            millimetres: depth as uint16, see `gn0.render.depth`.

        Raises:
            RenderError: a view is not finite or not rigid, an output or a scene is unknown, keys,
                tails or sets are not one a view, a colour or a splat is not finite, or `parts` are
                wrong (see `check_parts`).
            DeviceMemoryError: a scene is larger than the memory, or one view has no room.
            DeviceError: the device is lost.
        """
        tail = tails if extra is None else extra
        drawn = self._draw(camera, views, keys, chosen, tail, parts, outputs, background, visible)
        if millimetres and drawn.depth is not None:
            return replace(drawn, depth=scale_on_device(self.device, drawn.depth))
        return drawn

    def _draw(
        self,
        camera: Camera,
        views: NDArray[np.floating] | DeviceArray,
        keys: Sequence[str | None] | str,
        chosen: DeviceArray | None,
        tails: Sequence[GaussianCloud | None] | GaussianCloud | None,
        parts: Parts | PartsDevice,
        outputs: tuple[Output, ...],
        background: Colour | None,
        visible: bool | VisibleSets | Sequence[Cell | None] | None,
    ) -> PicturesDevice:
        with lock_of(self.device):
            moving = self._place_parts(parts, views)
            asked: Call | None = None
            if tails is None and chosen is None and not isinstance(views, DeviceArray):
                views = np.asarray(views)
                asked = name_call(camera, views, keys, outputs, background, visible, moving)
                there = None
                if asked is not None:
                    there = self._held.calls.draw(asked, self.drawer, views, moving)
                if there is not None:
                    self.store.touch([keys] if isinstance(keys, str) else dict.fromkeys(keys))
                    return there
            poses: F64 | DeviceArray
            numbers: NDArray[np.int32] | DeviceArray | None
            if isinstance(views, DeviceArray):
                poses = views
                named, numbers = check_chosen(views, keys, chosen)
            elif chosen is not None:
                raise RenderError("`chosen` needs views on the device", where="chosen")
            else:
                poses = check_views(views)
                named, numbers = number_keys(name_all(keys), len(poses))
            simple = tails is None and len(poses) > 0
            if isinstance(visible, VisibleSets) and len(named) > 1:
                simple = False  # they are of one scene
            if simple and (visible is None or isinstance(visible, bool | VisibleSets)):
                there = self._render_there(
                    *(camera, poses, named, numbers, moving, outputs, background),
                    *(visible or False, asked),
                )
                if there is not None:
                    return there
            if isinstance(views, DeviceArray):
                poses, keys, moving = self._fetch(views, named, numbers, moving)
            assert isinstance(poses, np.ndarray)
            return self._render(
                camera, poses, name_all(keys), tails, moving, outputs, background, visible
            )

    def render_who(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        keys: Sequence[str] | str = ALONE,
        *,
        parts: Parts,
        visible: bool = False,
    ) -> WhoPictures:
        """As `draw_who`, in host memory.

        Raises:
            RenderError, DeviceError: see `draw`.
        """
        matrices = check_views(views)
        counts = [len(row) for row in check_parts(parts, len(matrices))]
        return self.draw_who(camera, matrices, keys, parts=parts, visible=visible).fetch(counts)

    def draw_who(
        self,
        camera: Camera,
        views: NDArray[np.floating] | DeviceArray,
        keys: Sequence[str | None] | str = ALONE,
        *,
        chosen: DeviceArray | None = None,
        parts: Parts | PartsDevice,
        visible: bool = False,
    ) -> WhoDevice:
        """Which instance each pixel shows, and how much of each is seen; arguments as for `draw`.

        Scenes need no labels. Each instance is also drawn alone: for measures and truth. The host
        arranges it, and waits for views and instances that are on the device.

        Raises:
            RenderError, DeviceError: see `draw`.
        """
        with lock_of(self.device):
            if isinstance(views, DeviceArray):
                moving = self._place_parts(parts, views)
                named, numbers = check_chosen(views, keys, chosen)
                matrices, keys, moving = self._fetch(views, named, numbers, moving)
            else:
                matrices = check_views(views)
                moving = self._place_parts(parts, matrices)
            count, size = len(matrices), (camera.height, camera.width)
            if moving is None:
                return empty_who(self.device, count, size, 0)
            found = self._render(
                *(camera, matrices, name_all(keys), None, moving, ("instance",), None, visible),
                who=True,
            )
            assert found.instance is not None
            nobody = empty_who(self.device, 0, size, len(moving))
            who = nobody._replace(numbers=found.instance)

            def draw_one(rows: NDArray[np.int64], one_each: Instances) -> DeviceArray:
                look, options = matrices[rows], self.options
                attempt = partial(draw_alone, self.drawer, camera, look, one_each)
                return self._held.with_room(partial(attempt, options.antialiased))

            count_all(self.device, who, moving, count, draw_one)
            return who

    def _fetch(
        self,
        views: DeviceArray,
        named: list[str | None],
        numbers: NDArray[np.int32] | DeviceArray | None,
        moving: Instances | None,
    ) -> tuple[F64, list[str | None], Instances | None]:
        """Views, the key of each and instances, for the host to arrange; waits for them."""
        poses = check_views(views.numpy())
        if isinstance(numbers, DeviceArray):
            numbers = numbers.numpy()
        keys = choose_keys(named, [0] * len(poses) if numbers is None else numbers.tolist())
        return poses, keys, None if moving is None else moving.fetch(len(poses))

    def _place_parts(
        self, parts: Parts | PartsDevice, views: NDArray[np.floating] | DeviceArray
    ) -> Instances | None:
        """Instances of views, whose poses are on the device only if those of the views are."""
        if isinstance(parts, Sequence) and not parts:
            return None
        shape = np.shape(views)
        count = shape[0] if len(shape) == 3 else 1  # what is no view is told of further on
        if isinstance(parts, PartsDevice) and not isinstance(views, DeviceArray):
            raise RenderError("`parts` on the device need views there", where="parts")
        return self._named.place(parts, count)

    def _render_there(
        self,
        camera: Camera,
        views: F64 | DeviceArray,
        keys: list[str | None],
        chosen: NDArray[np.int32] | DeviceArray | None,
        moving: Instances | None,
        outputs: tuple[Output, ...],
        background: Colour | None,
        visible: bool | VisibleSets,
        asked: Call | None,
    ) -> PicturesDevice | None:
        """Draw views with tables made on the device; None where only the host can arrange it."""
        colour = check_picture(
            outputs, self.options.background if background is None else background
        )
        wanted = [key for key in keys if key is not None]
        if camera.model != "pinhole" or (visible is True and self._sets.keys().isdisjoint(wanted)):
            visible = False
        known = isinstance(views, np.ndarray)
        if visible and self._skip and not known:
            self._skip -= 1
            return None

        record: Record = lambda: None  # noqa: E731

        def draw() -> PicturesDevice | None:
            nonlocal record
            found = self.store.together(wanted)
            if found is None:
                return None
            clouds = [None if key is None else found[key] for key in keys]
            floors = None
            if visible:
                arranged = self._held.arrange(keys, clouds, visible)
                clouds, floors = arranged.clouds, arranged.floors
                if isinstance(views, np.ndarray):
                    assert not isinstance(chosen, DeviceArray)
                    if not arranged.holds_all(views, chosen):
                        return None
            pictures = self.drawer.pictures(camera, len(views), outputs, self.options.rgb_float)
            self.drawer.draw(
                *(
                    camera,
                    self._place(views),
                    clouds,
                    None if chosen is None else self._place(chosen),
                ),
                floors=floors,
                instances=moving,
                pictures=pictures,
                background=colour,
                antialiased=self.options.antialiased,
            )
            if not isinstance(chosen, DeviceArray):
                record = partial(
                    self.drawer.record,
                    camera,
                    len(views),
                    clouds,
                    chosen,
                    floors=floors,
                    instances=moving,
                    antialiased=self.options.antialiased,
                )
            return pictures

        try:
            there = self._held.with_room(draw, wanted, pinned=wanted)
        except DeviceMemoryError:
            return None
        except SetMissingError:  # rarer with each one; where they never all fit, try seldom
            self._skip, self._wait = self._wait, min(2 * self._wait + 1, 15)
            return None
        self._wait = self._wait if known else 0
        self._held.trim_sets(wanted if visible else ())
        arranged = self._held.arranged
        if there is not None and asked is not None and not (visible and arranged is None):
            sets = arranged.sets if visible and arranged is not None else ()
            self._held.calls.note(asked, self.drawer, record, sets)
        return there

    def _place(self, array: NDArray[Any] | DeviceArray) -> DeviceArray:
        return self.device.upload(array) if isinstance(array, np.ndarray) else array

    def _render(
        self,
        camera: Camera,
        matrices: F64,
        keys: Sequence[str] | str,
        tails: Sequence[GaussianCloud | None] | GaussianCloud | None,
        instances: Instances | None,
        outputs: tuple[Output, ...],
        background: Colour | None,
        visible: bool | VisibleSets | Sequence[Cell | None] | None,
        *,
        who: bool = False,
    ) -> PicturesDevice:
        count = len(matrices)
        names = [keys] * count if isinstance(keys, str) else list(keys)
        colour = check_picture(
            outputs, self.options.background if background is None else background
        )
        for what, given in (("keys", names), ("tails", tails), ("visible", visible)):
            if isinstance(given, Sequence) and len(given) != count:
                raise RenderError(f"{len(given)} {what} for {count} views", where=what)
        parts = find_parts(camera, matrices, names, visible, self._sets)
        mine = views_of(names)
        moving, tail_of = self._held.with_room(
            lambda: bring_tails(self.device, tails, count), mine, parts
        )
        pictures = self._held.with_room(
            lambda: self.drawer.pictures(camera, count, outputs, self.options.rgb_float),
            *(mine, parts),
        )

        def draw(group: dict[str, CloudDevice]) -> None:
            rows = np.array(sorted(v for key in group for v in mine[key]), np.int64)
            clouds, cloud_of = choose_parts(group, names, parts, rows)
            self.drawer.draw(
                camera,
                matrices[rows],
                clouds,
                cloud_of,
                tails=moving,
                tail_of=None if tail_of is None else tail_of[rows],
                instances=None if instances is None else instances.select(rows, count),
                pictures=pictures,
                rows=rows,
                background=colour,
                antialiased=self.options.antialiased,
                who=who,
            )

        for group in self.store.groups(names):
            self._held.with_room(partial(draw, group), mine, parts, group)
        self._held.trim_sets(mine if visible else ())
        return pictures


def share_drawer(device: Device) -> Drawer:
    """The drawer of all renderers of a device: its buffers are as large as the largest call.

    Whoever draws holds `lock_of` its device.
    """
    known = _drawers.get(device)
    drawer = known() if known is not None else None
    if drawer is None:
        drawer = Drawer(device)
        _drawers[device] = ref(drawer)
    return drawer
