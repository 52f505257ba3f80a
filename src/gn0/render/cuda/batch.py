"""RendererBatch: many views of many scenes, each with a moving tail, in one call on a device."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeVar
from weakref import WeakKeyDictionary, ref

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.errors import DeviceMemoryError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cuda.draw import CloudDevice, Drawer
from gn0.render.cuda.pack import CloudReady, prepare_cloud, upload_clouds
from gn0.render.cuda.replay import PicturesDevice, Replay, SetMissingError
from gn0.render.cuda.store import CloudStore, Load
from gn0.render.cuda.tables import FLOOR, NO_PLACE, NO_SET, find_eyes
from gn0.render.cuda.visible import VisibleSets, lock_of
from gn0.render.renderer import Output, RenderOptions, check_views
from gn0.render.visible_places import VisibleOptions

_CALLS = 8  # kinds of calls that are remembered
_SETS_SHARE = 0.1  # of the memory that is free at the start, for visible sets
OUTPUTS: tuple[Output, ...] = ("rgb", "depth", "alpha")
_drawers: WeakKeyDictionary[Device, ref[Drawer]] = WeakKeyDictionary()
Cell = tuple[int, int]
Part = tuple[VisibleSets, Cell]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class _Arranged:
    """Clouds of some keys, the visible sets behind them, and where these are drawn from.

    Attributes:
        stamp: of keys, clouds and sets.
        clouds: as kernels number them.
        floors: FLOOR rows as bytes [keys, 48].
        numbers: what they point to.
        rows, joined: the same on the host; rows point to bytes of `joined`, counted from 1.
        cells: whose set each of the clouds behind those of the keys is.
        sets: those of the keys.
    """

    stamp: tuple[object, ...]
    clouds: list[CloudDevice | None]
    floors: DeviceArray
    numbers: DeviceArray
    rows: NDArray[np.void]
    joined: NDArray[np.int32]
    cells: list[Part]
    sets: list[VisibleSets]

    def holds_all(self, matrices: F64, numbers: NDArray[np.int32] | None) -> bool:
        """Whether the sets of all views [V, 4, 4] are here; if so, they count as used now.

        Args:
            matrices: world-to-camera.
            numbers: of the keys that they show; None: the first.
        """
        rows = self.rows[np.zeros(len(matrices), np.int32) if numbers is None else numbers]
        x, y, z = find_eyes(matrices).T
        mine = (rows["numbers"] > 0) & (np.abs(z - rows["height"]) <= rows["tolerance"])
        x, y, rows = x[mine], y[mine], rows[mine]
        column = np.floor(x / rows["cell"]) - rows["column"]
        row = np.floor(y / rows["cell"]) - rows["row"]
        within = (column >= 0) & (column < rows["columns"]) & (row >= 0) & (row < rows["rows"])
        rows, column, row = rows[within], column[within], row[within]
        at = (rows["numbers"].astype(np.int64) - 1) // 4 + (row * rows["columns"] + column).astype(
            np.int64
        )
        found = set(self.joined[at].tolist())
        if NO_SET in found:
            return False
        for number in sorted(found - {NO_PLACE}):
            sets, cell = self.cells[number - len(self.rows)]
            sets.touch(cell)
        return True


class _Call(NamedTuple):
    """What makes two calls alike: all but the poses."""

    camera: Camera
    keys: tuple[str | None, ...] | str
    shape: tuple[int, ...]
    outputs: tuple[Output, ...]
    background: tuple[float, ...] | None
    visible: bool | VisibleSets | None


@dataclass(eq=False)
class _Again:
    """A kind of call that has come before, and how to draw the next without its preparations.

    Attributes:
        sets: the visible sets that it is drawn from, in the versions that they had.
        replay: None until it comes again.
    """

    sets: list[tuple[VisibleSets, int]]
    replay: Replay | None = None

    @property
    def alive(self) -> bool:
        """Whether it holds as it was recorded."""
        return (
            self.replay is not None
            and self.replay.alive
            and all(sets.version == version for sets, version in self.sets)
        )


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
    takes_device_views = True  # and numbers of keys there, see `render`

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
        # the emulation's last bits are not a card's: what is kept of it goes by another name
        self.drawn_by = self.name if device.kind == "cuda" else f"{self.name} on {device.kind}"
        self.store = CloudStore(device, memory)
        self.drawer = share_drawer(device)
        share = int(_SETS_SHARE * device.memory()[0])
        self.sets_memory = share if sets_memory is None else sets_memory
        self._sets: OrderedDict[str, VisibleSets] = OrderedDict()  # least recently used first
        self.store.on_drop = self._let_go
        self._arranged: _Arranged | None = None
        self._again: OrderedDict[_Call, _Again] = OrderedDict()  # last used last
        self._skip = self._wait = 0  # calls until views on the device are tried with sets again

    def __contains__(self, key: str) -> bool:
        return key in self.store

    def holds(self, key: str) -> bool:
        """Whether a scene's splats are on the device; any thread may ask."""
        return self.store.holds(key)

    def prepare(self, cloud: GaussianCloud) -> CloudReady:
        """The host's share of bringing a cloud here; any thread may do it, and `load` return it.

        Raises:
            RenderError: the cloud cannot be drawn.
        """
        return prepare_cloud(cloud)

    def add(self, key: str, load: Load, digest: str = "") -> None:
        """Name a scene; its cloud is loaded when it is first drawn, and again after it gave way.

        Args:
            key: of the scene, or of the scene in a light (`gn0.sim.open.name_look`).
            load: gives the cloud, or what `prepare` made of it; may run in a thread of its own.
            digest: content hash of that cloud (`gn0.sim.open.look_hash`). The same key with
                another hash drops the old splats and sets. Without hashes, another `load` does.
        """
        if self.store.add(key, load, digest):
            self._sets.pop(key, None)
            self._forget_calls()

    def remove(self, key: str) -> None:
        """Forget a scene."""
        self.store.remove(key)
        self._sets.pop(key, None)
        self._forget_calls()

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
        self._forget_calls()
        return sets

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating] | DeviceArray,
        keys: Sequence[str | None] | str,
        *,
        chosen: DeviceArray | None = None,
        tails: Sequence[GaussianCloud | None] | GaussianCloud | None = None,
        outputs: tuple[Output, ...] = OUTPUTS,
        background: tuple[float, float, float] | None = None,
        visible: bool | VisibleSets | Sequence[Cell | None] | None = None,
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
            tails: moving splats of each view, or of all, drawn after the scene's at equal depth.
                Views may share one cloud: it is brought over once.
            outputs: what to draw.
            background: colour behind everything, 0..1; the option when None.
            visible: True takes the visible set where each eye is, for scenes that have sets
                (`limit_to_visible`); sets do so for this call alone; or name a cell (column, row)
                a view, None for all splats.

        Raises:
            RenderError: a view is not finite or not rigid, an output or a scene is unknown, keys,
                tails or sets are not one a view, or a colour or a splat is not finite.
            DeviceMemoryError: a scene is larger than the memory, or one view has no room.
            DeviceError: the device is lost.
        """
        with lock_of(self.device):
            asked: _Call | None = None
            if tails is None and chosen is None and not isinstance(views, DeviceArray):
                views = np.asarray(views)
                asked = _name_call(camera, views, keys, outputs, background, visible)
                there = None if asked is None else self._draw_again(asked, camera, views)
                if there is not None:
                    return there
            poses: F64 | DeviceArray
            numbers: NDArray[np.int32] | DeviceArray | None
            if isinstance(views, DeviceArray):
                poses = views
                named, numbers = _check_there(views, keys, chosen)
            elif chosen is not None:
                raise RenderError("`chosen` needs views on the device", where="chosen")
            else:
                poses = check_views(views)
                named, numbers = _number_keys(_all_named(keys), len(poses))
            simple = visible is None or isinstance(visible, bool | VisibleSets)
            if isinstance(visible, VisibleSets) and len(named) > 1:
                simple = False  # they are of one scene
            if tails is None and simple and len(poses):
                there = self._render_there(
                    *(camera, poses, named, numbers, outputs, background, visible or False, asked)
                )
                if there is not None:
                    return there
            if isinstance(views, DeviceArray):
                poses = check_views(views.numpy())
                if isinstance(numbers, DeviceArray):
                    numbers = numbers.numpy()
                keys = _choose_keys(
                    named, [0] * len(poses) if numbers is None else numbers.tolist()
                )
            assert isinstance(poses, np.ndarray)
            return self._render(
                camera, poses, _all_named(keys), tails, outputs, background, visible
            )

    def _render_there(
        self,
        camera: Camera,
        views: F64 | DeviceArray,
        keys: list[str | None],
        chosen: NDArray[np.int32] | DeviceArray | None,
        outputs: tuple[Output, ...],
        background: tuple[float, float, float] | None,
        visible: bool | VisibleSets,
        asked: _Call | None,
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

        record: Callable[[], Replay | None] = lambda: None  # noqa: E731

        def draw() -> PicturesDevice | None:
            nonlocal record
            found = self.store.together(wanted)
            if found is None:
                return None
            clouds = [None if key is None else found[key] for key in keys]
            floors = None
            if visible:
                self._arranged = self._arrange(keys, clouds, visible)
                clouds, floors = self._arranged.clouds, self._arranged.floors
                if isinstance(views, np.ndarray):
                    assert not isinstance(chosen, DeviceArray)
                    if not self._arranged.holds_all(views, chosen):
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
                pictures=pictures,
                background=colour,
                antialiased=self.options.antialiased,
            )
            if not isinstance(chosen, DeviceArray):
                record = partial(
                    *(self.drawer.record, camera, len(views), clouds, chosen),
                    floors=floors,
                    antialiased=self.options.antialiased,
                )
            return pictures

        try:
            there = self._with_room(draw, wanted, [], wanted)
        except DeviceMemoryError:
            return None
        except SetMissingError:  # rarer with each one; where they never all fit, try seldom
            self._skip, self._wait = self._wait, min(2 * self._wait + 1, 15)
            return None
        self._wait = self._wait if known else 0
        self._trim_sets(wanted if visible else ())
        if there is not None and asked is not None and not (visible and self._arranged is None):
            self._remember(asked, record, bool(visible))
        return there

    def _draw_again(
        self, asked: _Call, camera: Camera, views: NDArray[np.floating]
    ) -> PicturesDevice | None:
        """Draw as a call like it was drawn; None where none was, or it cannot be done so."""
        again = self._again.get(asked)
        if again is None or not again.alive or self.drawer.on_stage is not None:
            return None
        assert again.replay is not None
        try:
            count = 1 if views.ndim == 2 else len(views)
            pictures = self.drawer.pictures(camera, count, asked.outputs, self.options.rgb_float)
            colour = self.options.background if asked.background is None else asked.background
            if again.replay.draw(views, pictures, np.array(colour, np.float32)) is not None:
                self._again.move_to_end(asked)
                return pictures
        except (DeviceMemoryError, SetMissingError):
            pass
        del self._again[asked]  # the long way makes room for it, or says what is wrong
        return None

    def _remember(self, asked: _Call, record: Callable[[], Replay | None], visible: bool) -> None:
        """Note that a call was drawn; one that came before is recorded."""
        arranged = self._arranged if visible else None
        sets = [] if arranged is None else [(one, one.version) for one in arranged.sets]
        again = self._again.get(asked)
        if again is None:
            self._again[asked] = _Again(sets)
            while len(self._again) > _CALLS:
                self._again.popitem(last=False)
        elif not again.alive and self.drawer.on_stage is None:
            with suppress(DeviceMemoryError):
                again.replay, again.sets = record(), sets
        self._again.move_to_end(asked)

    def _forget_calls(self) -> None:
        """Something that calls were prepared with has changed, or its memory is wanted."""
        self._arranged = None
        self._again.clear()

    def _place(self, array: NDArray[Any] | DeviceArray) -> DeviceArray:
        return self.device.upload(array) if isinstance(array, np.ndarray) else array

    def _arrange(
        self,
        keys: list[str | None],
        clouds: Sequence[CloudDevice | None],
        visible: bool | VisibleSets,
    ) -> _Arranged:
        """The clouds of `keys` with the visible sets that are here; kept while those are."""
        mine = [None if key is None else self._sets.get(key) for key in keys]
        if isinstance(visible, VisibleSets):
            mine = [None if key is None else visible for key in keys]
        stamp = (
            *(tuple(keys), tuple(map(id, clouds)), tuple(map(id, mine))),
            tuple(-1 if sets is None else sets.version for sets in mine),
        )
        if self._arranged is not None and self._arranged.stamp == stamp:
            return self._arranged
        every, floors = list(clouds), np.zeros(len(keys), FLOOR)
        tables: list[NDArray[np.int32]] = []
        cells: list[Part] = []
        for n, sets in enumerate(mine):
            cloud = clouds[n]
            if sets is None or cloud is None:
                continue
            numbers, (column, row), parts = sets.arrange(cloud)
            tables.append(np.where(numbers < 0, numbers, numbers + len(every)).astype(np.int32))
            every += parts
            cells += [(sets, cell) for cell in sets.held]
            at = sum(table.nbytes for table in tables[:-1]) + 1  # 0 is none
            options = sets.options
            floors[n] = (at, options.cell, sets.eye_height, options.height_tolerance,
                         column, row, *numbers.shape[::-1])  # fmt: skip
        joined = np.concatenate([table.ravel() for table in tables])
        there, placed = self.device.upload(joined), floors.copy()
        placed["numbers"][floors["numbers"] > 0] += np.uint64(there.pointer - 1)
        table = self.device.upload(placed.view(np.uint8).reshape(len(keys), -1))
        sets_now = tuple(-1 if sets is None else sets.version for sets in mine)
        return _Arranged(
            *((*stamp[:3], sets_now), every, table, there, floors, joined, cells),
            [sets for sets in mine if sets is not None],
        )

    def _render(
        self,
        camera: Camera,
        matrices: F64,
        keys: Sequence[str] | str,
        tails: Sequence[GaussianCloud | None] | GaussianCloud | None,
        outputs: tuple[Output, ...],
        background: tuple[float, float, float] | None,
        visible: bool | VisibleSets | Sequence[Cell | None] | None,
    ) -> PicturesDevice:
        count = len(matrices)
        names = [keys] * count if isinstance(keys, str) else list(keys)
        colour = check_picture(
            outputs, self.options.background if background is None else background
        )
        for what, given in (("keys", names), ("tails", tails), ("visible", visible)):
            if isinstance(given, Sequence) and len(given) != count:
                raise RenderError(f"{len(given)} {what} for {count} views", where=what)
        parts = self._parts(camera, matrices, names, visible)
        views_of = _views_of(names)
        moving, tail_of = self._with_room(lambda: self._bring_tails(tails, count), views_of, parts)
        pictures = self._with_room(
            lambda: self.drawer.pictures(camera, count, outputs, self.options.rgb_float),
            *(views_of, parts),
        )

        def draw(group: dict[str, CloudDevice]) -> None:
            rows = np.array(sorted(v for key in group for v in views_of[key]), np.int64)
            clouds, cloud_of = _choose(group, names, parts, rows)
            self.drawer.draw(
                camera,
                matrices[rows],
                clouds,
                cloud_of,
                tails=moving,
                tail_of=None if tail_of is None else tail_of[rows],
                pictures=pictures,
                rows=rows,
                background=colour,
                antialiased=self.options.antialiased,
            )

        for group in self.store.groups(names):
            self._with_room(partial(draw, group), views_of, parts, group)
        self._trim_sets(views_of if visible else ())
        return pictures

    def _trim_sets(self, used: Collection[str]) -> None:
        """Keep the sets of all scenes within their memory; those just `used` go last."""
        for key in used:
            if key in self._sets:
                self._sets.move_to_end(key)
        total = sum(sets.used for sets in self._sets.values())
        for sets in self._sets.values():
            if total <= self.sets_memory:
                break
            total -= sets.used
            sets.clear()
            self._forget_calls()

    def _with_room(
        self,
        attempt: Callable[[], T],
        wanted: Collection[str],
        parts: list[Part | None],
        pinned: Collection[str] = (),
    ) -> T:
        """What `attempt` gives. Where memory is short, scenes give way, then sets.

        Those that this call has `wanted` go after all others, and those `pinned` never.
        """
        cleared = False
        while True:
            try:
                return attempt()
            except DeviceMemoryError:
                self._forget_calls()  # they hold sets and clouds
                if self.store.give_way(wanted) or self.store.give_way(pinned):
                    continue
                if cleared or not _clear_sets([*self._sets.values(), *_sets_of(parts)]):
                    raise
                cleared = True  # once: the next attempt brings back those that it needs

    def _let_go(self, key: str) -> None:
        """A cloud is about to give way: its sets must not keep its memory."""
        self._forget_calls()
        if key in self._sets:
            self._sets[key].let_go()

    def _bring_tails(
        self, tails: Sequence[GaussianCloud | None] | GaussianCloud | None, count: int
    ) -> tuple[list[CloudDevice], NDArray[np.int32] | None]:
        """Different tails once each, and which is whose (-1: none)."""
        if isinstance(tails, GaussianCloud):
            if not len(tails):
                return [], None
            return upload_clouds(self.device, [tails], sort=False), np.zeros(count, np.int32)
        number: dict[int, int] = {}
        different: list[GaussianCloud] = []
        tail_of = np.full(count, -1, np.int32)
        for v, tail in enumerate(tails or ()):
            if tail is None or not len(tail):
                continue
            if id(tail) not in number:
                number[id(tail)] = len(different)
                different.append(tail)
            tail_of[v] = number[id(tail)]
        if not different:
            return [], None
        return upload_clouds(self.device, different, sort=False), tail_of

    def _parts(
        self,
        camera: Camera,
        matrices: F64,
        names: list[str],
        visible: bool | VisibleSets | Sequence[Cell | None] | None,
    ) -> list[Part | None]:
        """The set that each view is drawn from; None for all splats."""
        found: list[Part | None] = [None] * len(names)
        if visible is None or visible is False:
            return found
        if isinstance(visible, Sequence):
            for v, cell in enumerate(visible):
                if cell is None:
                    continue
                if names[v] not in self._sets:
                    raise RenderError(
                        f"scene {names[v]!r} has no visible sets",
                        remedy="call limit_to_visible first",
                    )
                found[v] = (self._sets[names[v]], cell)
            return found
        for key, mine in _views_of(names).items():
            sets = self._sets.get(key) if isinstance(visible, bool) else visible
            if sets is None:
                continue
            for v, cell in zip(mine, sets.locate(camera, matrices[mine]), strict=True):
                found[v] = None if cell is None else (sets, cell)
        return found


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


def _check_there(
    views: DeviceArray, keys: Sequence[str | None] | str, chosen: DeviceArray | None
) -> tuple[list[str | None], NDArray[np.int32] | DeviceArray | None]:
    """Keys, and which of them each view on the device shows; None: all show the first.

    Raises:
        RenderError: arrays of another shape or type, or keys that are not one a view.
    """
    count = len(views)
    if views.shape != (count, 4, 4) or views.dtype != np.float64:
        raise RenderError(
            f"views on the device are {views.dtype} {views.shape}",
            remedy="give float64 [V, 4, 4], world-to-camera",
        )
    if chosen is not None:
        if isinstance(keys, str) or chosen.shape != (count,) or chosen.dtype != np.int32:
            raise RenderError(
                f"`chosen` is {chosen.dtype} {chosen.shape} for {count} views",
                where="chosen",
                remedy="give int32 [V], numbers into a list of keys",
            )
        return list(keys), chosen
    return _number_keys(keys, count)


def _name_call(
    camera: Camera,
    views: NDArray[np.floating],
    keys: Sequence[str | None] | str,
    outputs: tuple[Output, ...],
    background: Sequence[float] | None,
    visible: bool | VisibleSets | Sequence[Cell | None] | None,
) -> _Call | None:
    """What a call is remembered by; None if it is not of a kind that is."""
    if not (visible is None or isinstance(visible, bool | VisibleSets)):
        return None
    if views.dtype.kind not in "fiu" or views.shape[-2:] != (4, 4) or not 2 <= views.ndim <= 3:
        return None
    if not views.size:
        return None
    named = keys if isinstance(keys, str) else tuple(keys)
    behind = None if background is None else tuple(background)
    return _Call(camera, named, views.shape, tuple(outputs), behind, visible)


def _number_keys(
    keys: Sequence[str | None] | str, count: int
) -> tuple[list[str | None], NDArray[np.int32] | None]:
    """Different keys, and which of them each view shows; None: all show the first."""
    if isinstance(keys, str):
        return [keys], None
    if len(keys) != count:
        raise RenderError(f"{len(keys)} keys for {count} views", where="keys")
    number = {key: n for n, key in enumerate(dict.fromkeys(keys))}
    if len(number) <= 1:
        return list(number), None
    return list(number), np.array([number[key] for key in keys], np.int32)


def _choose_keys(keys: list[str | None], numbers: list[int]) -> list[str | None]:
    for v, number in enumerate(numbers):
        if not 0 <= number < len(keys):
            raise RenderError(f"{number} is the number of no key", where=f"view {v}")
    return [keys[number] for number in numbers]


def _all_named(keys: Sequence[str | None] | str) -> Sequence[str] | str:
    if isinstance(keys, str):
        return keys
    for v, key in enumerate(keys):
        if key is None:
            raise RenderError("a view is of no scene that is here", where=f"view {v}")
    return [key for key in keys if key is not None]


def _views_of(names: list[str]) -> dict[str, list[int]]:
    """Which views each scene has."""
    found: dict[str, list[int]] = {}
    for v, name in enumerate(names):
        found.setdefault(name, []).append(v)
    return found


def _sets_of(parts: list[Part | None]) -> list[VisibleSets]:
    return list({id(part[0]): part[0] for part in parts if part is not None}.values())


def _clear_sets(sets: list[VisibleSets]) -> bool:
    """Let go of all sets on the device; whether there were any."""
    return sum(some.clear() for some in sets) > 0


def _choose(
    group: dict[str, CloudDevice],
    names: list[str],
    parts: list[Part | None],
    rows: NDArray[np.int64],
) -> tuple[list[CloudDevice], NDArray[np.int32]]:
    """The clouds of views `rows`, whole or in part, once each; and which of them is whose."""
    wanted = [(names[v], parts[v]) for v in rows.tolist()]
    number = {which: n for n, which in enumerate(dict.fromkeys(wanted))}
    clouds = [group[key] for key, _ in number]
    asked: dict[tuple[str, VisibleSets], list[Cell]] = {}
    for key, part in number:
        if part is not None:
            asked.setdefault((key, part[0]), []).append(part[1])
    for (key, sets), cells in asked.items():
        for cell, cloud in sets.open(cells, group[key]).items():
            clouds[number[key, (sets, cell)]] = cloud
    return clouds, np.array([number[which] for which in wanted], np.int32)


def check_picture(outputs: tuple[str, ...], background: Sequence[float]) -> F32:
    """The background as float32 [3].

    Raises:
        RenderError: an output is unknown, or a colour is not finite.
    """
    unknown = [name for name in outputs if name not in OUTPUTS]
    if unknown:
        raise RenderError(f"unknown output {unknown[0]!r}", remedy="rgb, depth or alpha")
    colour = np.array(background, np.float32)
    if colour.shape != (3,) or not np.isfinite(colour).all():
        raise RenderError("background is not three finite numbers", where="background")
    return colour
