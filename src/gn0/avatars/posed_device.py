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
from typing import Any, Protocol, runtime_checkable

import numpy as np

from gn0.avatars.avatar import SHADOWS, TO_WORLD, Avatar, shadow_places
from gn0.avatars.body import check_pose
from gn0.avatars.posed_bank import BUDGET
from gn0.avatars.skinning import compose_joints, rotations_of
from gn0.device.device import Device, DeviceArray
from gn0.errors import ConfigError
from gn0.geometry import F64, quaternion_from_rotation
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
class PosesTogether(Protocol):
    """A pose whose like are quicker found together."""

    @staticmethod
    def turn_all(poses: Sequence[Any]) -> list[tuple[F64, F64]]:
        """What `turn` gives for each of the same type."""
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
    return posings_of([(avatar, rest, pose, np.zeros(3) if shift is None else shift)])[0]


def posings_of(wanted: Sequence[tuple[Avatar, RestDevice, F64, F64]]) -> list[Posing]:
    """The same of many at once, to the bit: avatar, itself at rest, pose and shift of each.

    Raises:
        DataError: a pose has another number of joints, or is not finite.
    """
    if not wanted:
        return []
    joints = np.stack([avatar.joints for avatar, *_ in wanted], axis=1)
    local = rotations_of(np.stack([check_pose(pose) for _, _, pose, _ in wanted], axis=1))
    transforms, placed = compose_joints(joints, local, np.stack([shift for *_, shift in wanted]))
    world = np.einsum("ab,jnbc->njac", TO_WORLD, transforms)
    turns = quaternion_from_rotation(world[..., :3]).reshape(len(wanted), -1, 4)
    floors = shadow_places(np.swapaxes(placed, 0, 1))
    return [
        Posing(rest, *what)
        for (_, rest, _, _), *what in zip(wanted, world, turns, floors, strict=True)
    ]


@dataclass(eq=False)
class _Held:
    slot: int
    size: int
    rest: Hashable


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
        self._used = np.zeros(0, np.int64)  # number of the call that asked for each slot last
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
                self._used[held.slot] = self._call
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
            self._take_stamps()
            self._finder.set(slots, max(len(self._used), 1))
            self._stale = False
        return self._finder.find(codes, chosen, self._call)

    def _take_stamps(self) -> None:
        """Learn from the device what was used when."""
        stamps = self._finder.stamps()
        used = self._used[: len(stamps)]
        np.maximum(used, stamps[: len(used)], out=used)

    def _fill(self, lacking: dict[Hashable, AvatarPose]) -> None:
        if not lacking:
            return
        self._take_stamps()
        sizes = {key: _size_of(pose.avatar) for key, pose in lacking.items()}
        wanted = sum(sizes.values())
        if self._bytes + wanted > self.budget:
            self._make_room(wanted)
        for pose in lacking.values():
            if pose.rest_key not in self._rests:
                self._rests[pose.rest_key] = (self.renderer.bring_rest(rest_of(pose.avatar)), 0)
        poses = list(lacking.values())
        slots = self.renderer.pose_parts(
            posings_of(
                [
                    (pose.avatar, self._rests[pose.rest_key][0], *turn)
                    for pose, turn in zip(poses, _turn_all(poses), strict=True)
                ]
            )
        )
        self.launches += 1
        self._stale = True
        for (key, pose), slot in zip(lacking.items(), slots, strict=True):
            self._held[key] = _Held(slot, sizes[key], pose.rest_key)
            if slot >= len(self._used):
                self._used = np.concatenate([self._used, np.zeros(slot + 1, np.int64)])
            self._used[slot] = self._call
            self._bytes += sizes[key]
            rest = self._rests[pose.rest_key]
            self._rests[pose.rest_key] = (rest[0], rest[1] + 1)

    def _make_room(self, wanted: int) -> None:
        """Drop what was asked for least recently, but nothing of this call."""
        spare = [key for key, held in self._held.items() if self._used[held.slot] != self._call]
        staying = self._bytes - sum(self._held[key].size for key in spare)
        if staying + wanted > self.budget:
            raise ConfigError(
                f"the people of one call need more than {self.budget:,} bytes",
                where="PosedBankDevice",
                remedy="give a larger budget, or draw people at coarser levels of detail",
            )
        spare.sort(key=lambda key: self._used[self._held[key].slot], reverse=True)
        while self._bytes + wanted > self.budget:
            self._drop(spare.pop())
            self.evicted += 1

    def _drop(self, key: Hashable) -> None:
        gone = self._held.pop(key)
        self.renderer.drop_part(gone.slot)
        self._bytes -= gone.size
        rest, clouds = self._rests.pop(gone.rest)
        if clouds > 1:
            self._rests[gone.rest] = (rest, clouds - 1)


def _turn_all(poses: Sequence[AvatarPose]) -> list[tuple[F64, F64]]:
    """Pose and shift of each."""
    first = poses[0]
    if isinstance(first, PosesTogether) and all(type(pose) is type(first) for pose in poses):
        return first.turn_all(poses)
    return [pose.turn() for pose in poses]


def _let_go(renderer: HoldsParts, held: dict[Hashable, _Held]) -> None:
    """Nobody will ask for them again."""
    for one in held.values():
        renderer.drop_part(one.slot)


def _size_of(avatar: Avatar) -> int:
    """Bytes of a posed cloud of it, at most."""
    return posed_bytes(-(-(len(avatar) + SHADOWS) // 256) * 256)
