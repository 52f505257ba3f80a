"""Posed people on a graphics card: a bank of clouds there, filled by one launch a call.

The same keys as `PosedBank` has. A cloud is a slot of the renderer's table of parts: an instance
names the slot (`PartsDevice` without names), or the slot's name. Clouds are packed to 16 bytes a
splat; what no pose changes lies beside them once a person and level of detail, as long as one of
its clouds does.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from gn0.avatars.avatar import SHADOWS, Avatar, contact_shadow
from gn0.avatars.posed_bank import BUDGET
from gn0.device.device import Device, DeviceArray
from gn0.errors import ConfigError
from gn0.geometry import F64
from gn0.render.cuda.posed import Posing, RestCloud, RestDevice, SlotFinder, posed_bytes


class AvatarPose(Protocol):
    """A pose of an avatar that is to be drawn."""

    @property
    def avatar(self) -> Avatar:
        """Of whom, at a level of detail."""
        ...

    @property
    def rest_key(self) -> Hashable:
        """Equal for poses of the same avatar at the same level."""
        ...

    def turn(self) -> tuple[F64, F64]:
        """Pose [55, 3] rad and shift [3] m."""
        ...


@runtime_checkable
class HoldsParts(Protocol):
    """A renderer whose table of parts lies on a device: `RendererBatch`."""

    device: Device

    def bring_rest(self, cloud: RestCloud) -> RestDevice:
        """Bring a person at rest there."""
        ...

    def pose_parts(self, wanted: Sequence[Posing]) -> list[int]:
        """Slots of clouds in poses."""
        ...

    def drop_part(self, slot: int) -> None:
        """Free such a slot."""

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
    world, turns, joints = avatar.place_joints(pose, shift)
    below = contact_shadow(joints)
    floor = np.column_stack([below.means, below.opacities]).astype(np.float32)
    return Posing(rest, world, turns, floor)


@dataclass(eq=False)
class _Held:
    slot: int
    size: int
    rest: Hashable
    used: int  # number of the call that asked for it last


class PosedBankDevice:
    """Posed clouds on a device by key, under a budget. For one thread.

    Args:
        renderer: in whose table they are.
        budget: bytes of all of them together, boxes included; what people are at rest is not
            counted (`rest_bytes`).

    Attributes:
        hits, misses: how many clouds were there when they were asked for, and how many not.
        evicted: how many have made room for others.
        launches: that have filled it.

    Raises:
        ConfigError: the budget is not above 0.
    """

    def __init__(self, renderer: HoldsParts, budget: int = BUDGET) -> None:
        if budget <= 0:
            raise ConfigError(
                f"{budget} bytes for posed people",
                where="PosedBankDevice",
                remedy="give more than 0",
            )
        self.renderer, self.budget = renderer, budget
        self.hits = self.misses = self.evicted = self.launches = 0
        self._held: dict[Hashable, _Held] = {}
        self._rests: dict[Hashable, tuple[RestDevice, int]] = {}  # and how many clouds it has
        self._bytes = self._call = 0
        self._finder = SlotFinder(renderer.device)
        self._stale = True  # whether the finder does not know what is held
        weakref.finalize(self, _let_go, renderer, self._held).atexit = False

    def __len__(self) -> int:
        return len(self._held)

    def __contains__(self, key: object) -> bool:
        return key in self._held

    @property
    def bytes(self) -> int:
        """Bytes of all clouds on the device, never above the budget."""
        return self._bytes

    @property
    def rest_bytes(self) -> int:
        """Bytes on the device of those at rest whose clouds are held."""
        return sum(rest.nbytes for rest, _ in self._rests.values())

    @property
    def hit_rate(self) -> float:
        """Share of clouds that were there when they were asked for; 0 before any was."""
        return self.hits / max(self.hits + self.misses, 1)

    def fetch(self, wanted: Sequence[tuple[Hashable, AvatarPose]]) -> list[int]:
        """The slots of clouds of one call, made by one launch where they are not here.

        They stay until the next call; what was asked for least recently makes room for them.

        Args:
            wanted: a key and what poses it, for each; keys may repeat.

        Raises:
            ConfigError: together they are larger than the budget; nothing has changed then.
            RenderError: somebody cannot be packed.
            DeviceMemoryError: the device has no room for them.
        """
        self._call += 1
        lacking: dict[Hashable, AvatarPose] = {}
        for key, pose in wanted:
            held = self._held.get(key)
            if held is not None or key in lacking:
                self.hits += 1
            else:
                self.misses += 1
                lacking[key] = pose
            if held is not None:
                held.used = self._call
        self._fill(lacking)
        return [self._held[key].slot for key, _ in wanted]

    def name(self, slot: int) -> str:
        """The name by which the renderer knows a slot, for `Instance`."""
        return self.renderer.name_part(slot)

    def find(
        self, codes: DeviceArray, chosen: DeviceArray, pose: Callable[[int], AvatarPose]
    ) -> int:
        """Write the slots of clouds that a kernel asks for, by codes as keys.

        One small kernel and one word that comes back where all are here; else those that lack are
        posed, all by one launch, and it looks again.

        Args:
            codes: uint64 [I] on the device, below 2⁶³; 0 is nobody.
            chosen: int32 [I] there, which gets slots, -1 for nobody.
            pose: what poses a code.

        Returns:
            How many clouds were not here.

        Raises:
            ConfigError, RenderError, DeviceMemoryError: see `fetch`.
        """
        self._call += 1
        lacking = self._look(codes, chosen)
        self.misses += len(lacking)
        self.hits += len(codes) - len(lacking)
        if lacking:
            self._fill({code: pose(code) for code in lacking})
            self._look(codes, chosen)
        return len(lacking)

    def _look(self, codes: DeviceArray, chosen: DeviceArray) -> list[int]:
        if self._stale:
            slots = {k: held.slot for k, held in self._held.items() if isinstance(k, int)}
            most = max((held.slot for held in self._held.values()), default=0) + 1
            self._take_stamps()
            self._finder.set(slots, most)
            self._stale = False
        return self._finder.find(codes, chosen, self._call)

    def _take_stamps(self) -> None:
        """Learn from the device what was used when."""
        stamps = self._finder.stamps()
        for held in self._held.values():
            if held.slot < len(stamps):
                held.used = max(held.used, int(stamps[held.slot]))

    def _fill(self, lacking: dict[Hashable, AvatarPose]) -> None:
        if not lacking:
            return
        self._take_stamps()
        sizes = {key: _size_of(pose.avatar) for key, pose in lacking.items()}
        staying = sum(held.size for held in self._held.values() if held.used == self._call)
        if staying + sum(sizes.values()) > self.budget:
            raise ConfigError(
                f"the people of one call need more than {self.budget:,} bytes",
                where="PosedBankDevice",
                remedy="give a larger budget, or draw people at coarser levels of detail",
            )
        oldest = sorted(
            (key for key, held in self._held.items() if held.used != self._call),
            key=lambda key: self._held[key].used,
            reverse=True,
        )
        while self._bytes + sum(sizes.values()) > self.budget:
            self._drop(oldest.pop())
            self.evicted += 1
        postures = []
        for pose in lacking.values():
            rest = self._rests.get(pose.rest_key)
            if rest is None:
                rest = (self.renderer.bring_rest(rest_of(pose.avatar)), 0)
                self._rests[pose.rest_key] = rest
            postures.append(posing_of(pose.avatar, rest[0], *pose.turn()))
        slots = self.renderer.pose_parts(postures)
        self.launches += 1
        self._stale = True
        for (key, pose), slot in zip(lacking.items(), slots, strict=True):
            self._held[key] = _Held(slot, sizes[key], pose.rest_key, self._call)
            self._bytes += sizes[key]
            rest = self._rests[pose.rest_key]
            self._rests[pose.rest_key] = (rest[0], rest[1] + 1)

    def _drop(self, key: Hashable) -> None:
        gone = self._held.pop(key)
        self.renderer.drop_part(gone.slot)
        self._bytes -= gone.size
        rest, clouds = self._rests.pop(gone.rest)
        if clouds > 1:
            self._rests[gone.rest] = (rest, clouds - 1)


def _let_go(renderer: HoldsParts, held: dict[Hashable, _Held]) -> None:
    """Nobody will ask for them again."""
    for one in held.values():
        renderer.drop_part(one.slot)


def _size_of(avatar: Avatar) -> int:
    """Bytes of a posed cloud of it, at most."""
    return posed_bytes(-(-(len(avatar) + SHADOWS) // 256) * 256)
