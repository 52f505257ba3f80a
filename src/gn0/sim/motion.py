"""What moves in a scene, and what is seen of it at a moment.

A `Motion` says where its parts stand at a time; a `Moment` is that, with a key that tells pictures
apart which differ in nothing else. Where nothing moves the key is empty: no picture is drawn anew,
and no byte is added to what it is kept under.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from gn0.errors import SimError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64, quaternion_from_rotation, rotation_from_quaternion
from gn0.render.instance import Instance, check_named, check_parts
from gn0.storage import content_hash


class Motion(Protocol):
    """What moves in a scene: a function of the time since an episode began."""

    @property
    def clouds(self) -> Mapping[str, GaussianCloud]:
        """The parts' splats by name, each in its own frame."""
        ...

    def at(self, time: float) -> Sequence[Instance]:
        """Where parts stand at a time [s]: equal times, equal poses."""
        ...


@dataclass(frozen=True, eq=False)
class Moment:
    """What is seen besides the scene itself: a time, and where parts are then.

    Attributes:
        time: since the episode began [s].
        parts: where they stand then.
        about: what else pictures of it depend on, where names of clouds do not say it all.
    """

    time: float = 0.0
    parts: tuple[Instance, ...] = ()
    about: bytes = b""

    @cached_property
    def key(self) -> bytes:
        """Equal where the pictures of equal poses are; empty where nothing moves."""
        if not self.parts:
            return b""
        described: list[str | bytes] = [self.about] if self.about else []
        for part in self.parts:
            gain = b"" if part.gain is None else part.gain.tobytes()
            described += [part.cloud, part.pose.tobytes(), gain]
            if part.nearer:
                described.append(np.float64(part.nearer).tobytes())
        return bytes.fromhex(content_hash(*described))


STILL = Moment()


def take_moment(motion: Motion | None, time: float) -> Moment:
    """Where everything stands at a time [s].

    Raises:
        RenderError: more parts than a picture may have, or one that has no meaning.
    """
    if motion is None:
        return STILL
    parts = tuple(motion.at(time))
    return Moment(time, check_parts(parts, 1, motion.clouds)[0])


@dataclass(frozen=True, eq=False)
class PartPath:
    """A cloud that follows a path: straight and evenly turning between its poses.

    Attributes:
        cloud: its name.
        times: [K] s, rising.
        poses: part-to-world [K, 4, 4] m.
        gain: see `Instance`.
        repeats: begin again at the end; else it stays there.
        nearer: see `Instance` [m].
    """

    cloud: str
    times: F64
    poses: F64
    gain: F32 | None = None
    repeats: bool = False
    nearer: float = 0.0

    def at(self, time: float) -> Instance:
        """Where it stands at a time [s]."""
        first, last = float(self.times[0]), float(self.times[-1])
        if self.repeats and last > first:
            time = first + (time - first) % (last - first)
        after = int(np.searchsorted(self.times, time, side="right"))
        if after == 0 or after == len(self.times):
            pose = self.poses[min(after, len(self.times) - 1)]
            return Instance(self.cloud, pose, self.gain, self.nearer)
        span = float(self.times[after] - self.times[after - 1])
        share = (time - float(self.times[after - 1])) / span
        pose = np.eye(4)
        one, other = self.poses[after - 1], self.poses[after]
        pose[:3, 3] = (1.0 - share) * one[:3, 3] + share * other[:3, 3]
        pose[:3, :3] = _turn(one[:3, :3], other[:3, :3], share)
        return Instance(self.cloud, pose, self.gain, self.nearer)


class PathMotion:
    """Parts that follow paths laid down beforehand: a ball that rolls, a door that opens.

    Args:
        clouds: by name.
        paths: paths of the parts; several may be of one cloud.

    Raises:
        RenderError: a name or a cloud cannot be a part's, or a pose has no meaning.
        SimError: a path of no known cloud, or times that do not rise.
    """

    def __init__(self, clouds: Mapping[str, GaussianCloud], paths: Sequence[PartPath]) -> None:
        self.clouds = dict(clouds)
        self.paths = tuple(paths)
        for name, cloud in self.clouds.items():
            check_named(name, cloud)
        for number, path in enumerate(self.paths):
            where = f"path {number}"
            if path.cloud not in self.clouds:
                raise SimError(f"no cloud is named {path.cloud!r}", where=where)
            count = len(path.times)
            if not count or path.poses.shape != (count, 4, 4):
                raise SimError(
                    f"{path.poses.shape} poses at {count} times",
                    where=where,
                    remedy="give a pose [4, 4] per time, and at least one",
                )
            times = np.asarray(path.times, np.float64)
            if not np.isfinite(times).all() or not (np.diff(times) > 0).all():
                raise SimError("times do not increase", where=where, remedy="in seconds, each once")
            each = [[Instance(path.cloud, pose, path.gain, path.nearer)] for pose in path.poses]
            check_parts(each, count)

    def at(self, time: float) -> tuple[Instance, ...]:
        """Where its parts stand at a time [s]."""
        return tuple(path.at(time) for path in self.paths)


def _turn(one: F64, other: F64, share: float) -> F64:
    """The rotation that is `share` of the shorter way from one to another."""
    a, b = quaternion_from_rotation(np.stack([one, other]))
    cosine = float(a @ b)
    if cosine < 0.0:
        b, cosine = -b, -cosine
    angle = math.acos(min(cosine, 1.0))
    if angle < 1e-9:
        return one
    weights = math.sin((1.0 - share) * angle), math.sin(share * angle)
    mixed = weights[0] * a + weights[1] * b
    turned: F64 = rotation_from_quaternion((mixed / np.linalg.norm(mixed))[None])[0]
    return turned
