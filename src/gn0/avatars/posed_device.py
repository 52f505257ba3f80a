"""Posed people on a graphics card: a bank of clouds there, filled by one launch a call.

The same keys as `PosedBank` has. A cloud is a slot of the renderer's table of parts: an instance
names the slot (`PartsDevice` without names), or the slot's name. Clouds are packed to 16 bytes a
splat; what no pose changes lies beside them once a person and level of detail, as long as one of
its clouds does, and a little longer.
"""

from __future__ import annotations

import warnings
import weakref
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.avatar import SHADOWS, Avatar, shadow_places
from gn0.avatars.code_map import U64, CodeMap
from gn0.avatars.coded_poses import (
    AvatarPose,
    CodedPoses,
    PosesOneByOne,
    check_all,
    place_avatars,
)
from gn0.avatars.kept_rows import KeptRows
from gn0.avatars.posed_bank import BUDGET
from gn0.device.device import Device, DeviceArray
from gn0.errors import ConfigError
from gn0.geometry import F32, F64
from gn0.render.cuda.posed import (
    Posing,
    ReadyPoses,
    RestCloud,
    RestDevice,
    posed_bytes,
    row_width,
)
from gn0.render.cuda.slot_finder import LackingCodes, SlotFinder

POSTURES = 128 * 2**20  # bytes on the host
_LINGERS = 64  # calls for which those at rest outlast their clouds: bringing one takes ms
_FADES = 256  # calls in which an asking comes to count half
_AT_ONCE = 8  # a part of the budget of which more makes room than must: it is not asked each call
FRAMES = 2**18  # boxes of postures at levels of detail, kept likewise
_NAMES = 2**63  # from there on are codes of keys that are none
_NAMES_MOST = 2**18  # keys whose codes are known, while others have no clouds
_FRAME = np.dtype([("box", "<f4", 7), ("step", "<f4"), ("kind", "<i4")])


@runtime_checkable
class HoldsParts(Protocol):
    """A renderer whose table of parts lies on a device: `RendererBatch`."""

    device: Device

    def bring_rest(self, cloud: RestCloud) -> RestDevice:
        """Bring a person at rest there."""
        ...

    def pose_parts(
        self, rests: Sequence[RestDevice], which: NDArray[np.integer], ready: ReadyPoses
    ) -> list[int]:
        """Slots of clouds in poses, `which` of those at rest in each."""
        ...

    def drop_parts(self, slots: Sequence[int]) -> None:
        """Free such slots."""

    def name_part(self, slot: int) -> str:
        """Its name, for `Instance`."""
        ...


def rest_of(avatar: Avatar) -> RestCloud:
    """An avatar at rest with its contact shadow, as a device poses it."""
    scales, sh, label, _ = avatar.kept
    more = ((0, SHADOWS), (0, 0))
    return RestCloud(
        points=np.pad(avatar.points, more),
        normals=np.pad(avatar.normals, more),
        quats=np.pad(avatar.quats, more),
        scales=scales,
        opacities=np.pad(avatar.opacities, more[0], constant_values=1.0),
        colours=sh[:, 0],
        joint=np.pad(avatar.weights.joint, more),
        weight=np.pad(avatar.weights.weight.astype(np.float32), more),
        joints=avatar.joints,
        lying=SHADOWS,
        label=label,
    )


def posing_of(avatar: Avatar, rest: RestDevice, pose: F64, shift: F64 | None = None) -> Posing:
    """A pose of an avatar that was brought to a device; its arguments are those of `Avatar.pose`.

    Raises:
        DataError: the pose has another number of joints, or is not finite.
    """
    return posings_of([(avatar, rest, pose, np.zeros(3) if shift is None else shift)])[0]


def posings_of(wanted: Sequence[tuple[Avatar, RestDevice, F64, F64]]) -> list[Posing]:
    """The same of many at once, to the bit: avatar, itself at rest, pose and shift of each.

    Raises:
        DataError: a pose has another number of joints, or is not finite.
    """
    if not wanted:
        return []
    avatars, _, poses, shifts = zip(*wanted, strict=True)
    placed = place_avatars(avatars, check_all(poses), np.stack(shifts))
    floors = shadow_places(placed.joints)
    return [
        Posing(rest, *what)
        for (_, rest, _, _), *what in zip(
            wanted, placed.transforms, placed.turns, floors, strict=True
        )
    ]


@dataclass(eq=False)
class _Kind:
    """Clouds of one avatar at one level of detail.

    Attributes:
        key: `AvatarPose.rest_key`.
        size: bytes of a cloud.
        rest: itself at rest on the device, as long as a cloud is, and some calls more.
        clouds: how many there are.
        last: call that left any.
    """

    key: Hashable
    size: int
    rest: RestDevice | None = None
    clouds: int = 0
    last: int = 0


class PosedBankDevice:
    """Posed clouds on a device by key, under a budget. For one thread.

    What is seldom asked for by its bytes makes room, in powers of two, of those the newest first; a
    call's askings count half 256 calls on. So a cycle that does not fit keeps a part of itself, and
    what a thousand agents ask for again and again outlasts what one of them asked for once.
    Postures that were worked out are kept on the host, so that a cloud that made room comes back
    for little.

    Args:
        renderer: in whose table they are.
        budget: bytes of all of them together, boxes included; what people are at rest is not
            counted (`rest_bytes`), nor what is free between them. A call whose own people need
            more gets it, with a warning the first time; who lacks after `expect` may be above it
            until `pose_expected`.
        postures: bytes of the host for postures at most, taken as they are needed.

    Attributes:
        hits, misses: how many clouds were there when they were asked for, and how many not.
        ahead: how many were made before anybody asked for them, see `expect`.
        evicted: how many have made room for others.
        launches: that have filled it.
        late_views: how many views lacked somebody when they were asked for last, if that was asked.

    Raises:
        ConfigError: the budget is not above 0.
    """

    def __init__(
        self, renderer: HoldsParts, budget: int = BUDGET, *, postures: int = POSTURES
    ) -> None:
        if budget <= 0:
            raise ConfigError(
                f"{budget} bytes for posed people",
                where="PosedBankDevice",
                remedy="give more than 0",
            )
        self.renderer, self.budget = renderer, budget
        self.hits = self.misses = self.ahead = self.evicted = self.launches = self.late_views = 0
        self._held = CodeMap()  # slots
        self._named: dict[Hashable, int] = {}  # codes of keys that are none
        self._next_name = _NAMES
        self._kinds: list[_Kind] = []
        self._numbers: dict[Hashable, int] = {}  # of kinds, by their keys
        width = row_width(SHADOWS)
        self._postures = KeptRows((np.float32, (width,)), max(postures // (4 * width), 1))
        self._frames = KeptRows(_FRAME, FRAMES)
        self._rows = np.empty((0, width), np.float32)
        self._bytes = self._call = 0
        self._warned = False
        # of each slot: kind (-1: free), code, call that asked for it last, and how often it was
        # asked for, older askings less
        self._kind_of = np.zeros(0, np.int64)
        self._codes = np.zeros(0, np.uint64)
        self._used = np.zeros(0, np.int64)
        self._asked = np.zeros(0)
        self._faded = 0  # the call to which those have faded
        self._taken = 0  # this call, if it has learnt of uses there to make room
        self._finder = SlotFinder(renderer.device)
        self._stale = True  # whether the finder does not know what is held
        self._asking: tuple[DeviceArray, DeviceArray, LackingCodes] | None = None
        self._expected: LackingCodes | None = None
        self._unread: DeviceArray | None = None  # slots of who is expected, which nobody reads
        weakref.finalize(self, _let_go, renderer, self._held).atexit = False

    def __len__(self) -> int:
        return len(self._held)

    def __contains__(self, key: object) -> bool:
        code = _code_of(key) or self._named.get(cast(Hashable, key), 0)
        return bool((self._held.find(np.array([code], np.uint64)) >= 0)[0])

    @property
    def bytes(self) -> int:
        """Bytes of all clouds on the device, above the budget only where one call needs more."""
        return self._bytes

    @property
    def rest_bytes(self) -> int:
        """Bytes on the device of those at rest whose clouds are held, or were of late."""
        return sum(kind.rest.nbytes for kind in self._kinds if kind.rest is not None)

    @property
    def hit_rate(self) -> float:
        """Share of clouds that were there when they were asked for; 0 before any was."""
        return self.hits / max(self.hits + self.misses, 1)

    def fetch(self, wanted: Sequence[tuple[Hashable, AvatarPose]]) -> list[int]:
        """The slots of clouds of one call, made by one launch where they are not here.

        They stay until the next call; what was asked for least makes room for them.

        Args:
            wanted: a key and what poses it, for each; keys may repeat.

        Raises:
            RenderError: somebody cannot be packed.
            DeviceMemoryError: the device has no room for them.
        """
        self._begin_call()
        codes = np.array([self._name_code(key) for key, _ in wanted], np.uint64)
        slots = self._held.find(codes)
        used = np.unique(slots[slots >= 0])
        self._used[used] = self._call
        self._asked[used] += 1.0
        lacking: dict[int, AvatarPose] = {}
        for n in np.flatnonzero(slots < 0).tolist():
            lacking.setdefault(int(codes[n]), wanted[n][1])
        self.misses += len(lacking)
        self.hits += len(wanted) - len(lacking)
        self._fill(np.array([*lacking], np.uint64), PosesOneByOne(lacking.__getitem__))
        return self._held.find(codes).tolist()

    def _begin_call(self) -> None:
        self._call, self._taken = self._call + 1, 0

    def _name_code(self, key: Hashable) -> int:
        """The code of a key: itself, or one above those of kernels."""
        code = _code_of(key) or self._named.get(key, 0)
        if not code:
            if len(self._named) >= _NAMES_MOST:  # those whose clouds went
                here = self._held.find(np.array([*self._named.values()], np.uint64)) >= 0
                self._named = dict(compress(self._named.items(), here.tolist()))
            code = self._named[key] = self._next_name
            self._next_name += 1
        return code

    def name(self, slot: int) -> str:
        """The name by which the renderer knows a slot, for `Instance`."""
        return self.renderer.name_part(slot)

    def find(self, codes: DeviceArray, chosen: DeviceArray, poses: CodedPoses) -> int:
        """Write the slots of clouds that a kernel asks for, by codes as keys.

        One small kernel and a copy that comes back where all are here; else those that lack are
        posed, all by one launch, and it looks again.

        Args:
            codes: uint64 [I] on the device, below 2⁶³; 0 is nobody.
            chosen: int32 [I] there, which gets slots, -1 for nobody.
            poses: what codes stand for.

        Returns:
            How many clouds were not here.

        Raises:
            RenderError, DeviceMemoryError: see `fetch`.
        """
        self.ask(codes, chosen)
        return self.answer(poses)

    def ask(self, codes: DeviceArray, chosen: DeviceArray, each: int = 0) -> DeviceArray | None:
        """Begin what `find` does; `answer` does the rest, and needs to wait the less the later.

        With `each` codes a view: which views are late, as of `PartsDevice`, until the next asking.
        """
        self._begin_call()
        self._expected = None  # that was of this call
        if self._finder.sends:  # what was used by the call before: not who is by this one
            self._take_uses()
        looked = self._look(codes, chosen, self._call, each=each)
        self._asking = codes, chosen, looked
        return looked.late

    def answer(self, poses: CodedPoses) -> int:
        """End what `ask` began; see `find`. After `expect` nobody makes room for those that lack.

        What failed may be tried again; what was done is not done twice.

        Raises:
            RenderError, DeviceMemoryError: see `fetch`.
        """
        if self._asking is None:
            return 0
        codes, chosen, looked = self._asking
        lacking, self.late_views = looked.numpy(), looked.late_views
        if len(lacking):
            self._fill(lacking, poses, hurried=self._expected is not None)
            self._look(codes, chosen, self._call)
        self._asking = None
        self.misses += len(lacking)
        self.hits += len(codes) - len(lacking)
        return len(lacking)

    def expect(self, codes: DeviceArray) -> None:
        """Say by whom the next `find` may ask; `pose_expected` makes those that lack.

        Args:
            codes: as of `find`.
        """
        if self._unread is None or len(self._unread) != len(codes):
            self._unread = self.renderer.device.empty(len(codes), np.int32)
        self._expected = self._look(codes, self._unread, self._call + 1, lane=1)
        self._finder.send_uses()

    def pose_expected(self, poses: CodedPoses, *, shown: bool = False) -> int:
        """Make clouds that `expect` named and that are not here; how many.

        To be called when all that shows clouds of the last `find` was handed to the device. What it
        has to do meanwhile hides all of this.

        Args:
            poses: what codes stand for.
            shown: whether those clouds may be shown once more; else they make room, too. If these
                have no room without, none is made, and a later call may try again.

        Raises:
            RenderError, DeviceMemoryError: see `fetch`.
        """
        if self._expected is None:
            return 0
        expected, self._expected = self._expected, None
        looked = expected.numpy()
        slots = self._held.find(looked)
        lacking = looked[slots < 0]
        self._call += 1
        self._used[slots[slots >= 0]] = self._call  # posed since it looked
        since = self._call - shown
        try:
            done = self._fill(lacking, poses, since) if len(lacking) else self._make_room(0, since)
        finally:
            self._call -= 1
        if not done:
            self._expected = expected
            return 0
        self.ahead += len(lacking)
        return len(lacking)

    def _look(
        self, codes: DeviceArray, chosen: DeviceArray, stamp: int, lane: int = 0, each: int = 0
    ) -> LackingCodes:
        if self._stale:
            self._take_uses()
            slots = np.flatnonzero(self._codes)
            self._finder.set(self._codes[slots], slots.astype(np.int32), max(len(self._used), 1))
            self._stale = False
        return self._finder.find(codes, chosen, stamp, lane=lane, each=each)

    def _take_uses(self) -> None:
        """Learn from the device what was used when, and how often since this was learnt last."""
        stamps, asked = self._finder.take_uses()
        count = min(len(stamps), len(self._used))
        np.maximum(self._used[:count], stamps[:count], out=self._used[:count])
        self._asked[:count] += asked[:count]

    def _tell(self, codes: U64, slots: NDArray[np.int64]) -> None:
        """Have the finder know of codes what has changed."""
        if not self._stale:
            self._stale = not self._finder.hold(codes, slots.astype(np.int32))

    def _fade(self) -> None:
        """Let what was asked for before count less; all askings since count as of now."""
        self._asked *= 0.5 ** ((self._call - self._faded) / _FADES)
        self._faded = self._call

    def _fill(
        self, codes: U64, poses: CodedPoses, since: int | None = None, *, hurried: bool = False
    ) -> bool:
        """Make the clouds of codes that are not held, each once, by one launch.

        Where somebody waits, in a hurry, nobody makes room and no posture is kept. Whether it was
        done: see `_make_room`.
        """
        if not len(codes):
            return True
        postures = poses.postures(codes)
        framed, turned = self._frames.find(codes), self._postures.find(postures)
        known = (framed >= 0) & (turned >= 0)
        old, new = np.flatnonzero(known), np.flatnonzero(~known)
        frames = np.zeros(len(codes), _FRAME)
        frames[old] = self._frames.read(framed[old])
        if len(new):
            frames["kind"][new] = self._find_kinds(codes[new], poses)
        kinds, first, which, counts = np.unique(
            frames["kind"], return_index=True, return_inverse=True, return_counts=True
        )
        if not hurried:
            sizes = np.array([kind.size for kind in self._kinds])
            if not self._make_room(int(sizes[kinds] @ counts), since):
                return False
        for number, code in zip(kinds.tolist(), codes[first].tolist(), strict=True):
            kind = self._kinds[number]
            if kind.rest is None:
                kind.rest = self.renderer.bring_rest(rest_of(poses.avatar(code)))
        rests = [self._rest(number) for number in kinds.tolist()]
        rows = self._take_rows(len(codes))
        self._postures.copy(turned[old], rows, old)
        if len(new):
            made = poses.ready(codes[new], rests, which[new], rows, new)
            frames["box"][new], frames["step"][new] = made
            if not hurried:
                self._postures.keep(postures[new], rows, new)
                self._frames.keep(codes[new], frames[new])
        ready = ReadyPoses(rows, frames["box"].copy(), frames["step"].copy())
        slots = np.array(self.renderer.pose_parts(rests, which, ready), np.int64)
        self.launches += 1
        self._hold(codes, slots, frames["kind"])
        for kind in self._kinds:
            if kind.clouds:
                kind.last = self._call
            elif self._call - kind.last > _LINGERS:
                kind.rest = None
        return True

    def _take_rows(self, count: int) -> F32:
        """Rows of postures, until the next call: memory that is new costs more than to write it."""
        if len(self._rows) < count:
            self._rows = np.empty((2 * count, row_width(SHADOWS)), np.float32)
        return self._rows[:count]

    def _find_kinds(self, codes: U64, poses: CodedPoses) -> NDArray[np.int64]:
        """Numbers of kinds of codes."""
        keys, which = poses.rests(codes)
        _, first = np.unique(which, return_index=True)
        numbers = []
        for key, code in zip(keys, codes[first].tolist(), strict=True):
            number = self._numbers.setdefault(key, len(self._kinds))
            if number == len(self._kinds):
                self._kinds.append(_Kind(key, _size_of(poses.avatar(code))))
            numbers.append(number)
        return np.array(numbers, np.int64)[which]

    def _rest(self, number: int) -> RestDevice:
        rest = self._kinds[number].rest
        assert rest is not None
        return rest

    def _hold(self, codes: U64, slots: NDArray[np.int64], kinds: NDArray[np.int32]) -> None:
        """Note which codes new slots have."""
        more = int(slots.max()) + 1 - len(self._codes)
        if more > 0:
            more += len(self._codes)  # twice as many
            self._kind_of = np.append(self._kind_of, np.full(more, -1))
            self._codes = np.append(self._codes, np.zeros(more, np.uint64))
            self._used = np.append(self._used, np.zeros(more, np.int64))
            self._asked = np.append(self._asked, np.zeros(more))
        self._held.put(codes, slots)
        self._codes[slots] = codes
        self._kind_of[slots], self._used[slots], self._asked[slots] = kinds, self._call, 1.0
        self._count(kinds, 1)
        self._tell(codes, slots)

    def _count(self, kinds: NDArray[np.integer], more: int) -> None:
        """So many clouds of kinds are more, or less."""
        for number, count in zip(*np.unique(kinds, return_counts=True), strict=True):
            kind = self._kinds[number]
            kind.clouds += more * int(count)
            self._bytes += more * int(count) * kind.size

    def _make_room(self, wanted: int, since: int | None = None) -> bool:
        """Drop what was asked for least by its bytes, the newest first; nothing of this call.

        Nothing either that was asked for `since` another, nor anything at all if that is too
        little: whether there is room. This call itself gets it in any case.
        """
        over = self._bytes + wanted - self.budget
        if over <= 0:
            return True
        since = self._call if since is None else since
        self._fade()
        if self._taken != self._call:
            self._take_uses()
            self._taken = self._call
        held = np.flatnonzero(self._kind_of >= 0)
        spare = held[self._used[held] < since]
        sizes = np.array([kind.size for kind in self._kinds])[self._kind_of[spare]]
        rate = np.rint(np.log2(self._asked[spare])) - np.rint(np.log2(sizes))
        order = np.lexsort((-self._used[spare], rate))
        spare, sizes = spare[order], sizes[order]
        room = np.cumsum(sizes)
        if since < self._call and (not len(room) or room[-1] < over):
            return False
        enough = int(np.searchsorted(room, over)) + 1
        ample = int(np.searchsorted(room, over + self.budget // _AT_ONCE, "right"))
        gone = spare[: max(enough, ample)]
        if not self._warned and over > sizes.sum():
            self._warned = True
            warnings.warn(
                f"the people of one call need {over - int(sizes.sum()):,} bytes more than the "
                f"{self.budget:,} of the bank of posed people, and get them; give a larger "
                "budget, or draw people at coarser levels of detail",
                RuntimeWarning,
                stacklevel=4,
            )
        slots = gone.tolist()
        self._held.drop(self._codes[gone])
        self._tell(self._codes[gone], np.full(len(gone), -1))
        self._count(self._kind_of[gone], -1)
        self._kind_of[gone], self._codes[gone] = -1, 0
        self.renderer.drop_parts(slots)
        self.evicted += len(slots)
        return True


def _let_go(renderer: HoldsParts, held: CodeMap) -> None:
    """Nobody will ask for them again."""
    renderer.drop_parts(held.numbers.tolist())


def _code_of(key: object) -> int:
    """A key that a kernel could ask for; 0: it is none."""
    return key if isinstance(key, int) and 0 < key < _NAMES else 0


def _size_of(avatar: Avatar) -> int:
    """Bytes of a posed cloud of it, at most."""
    return posed_bytes(-(-(len(avatar) + SHADOWS) // 256) * 256)
