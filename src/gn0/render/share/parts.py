"""Moving parts on their way to the drawing process: clouds once, then where they stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.cloud import GaussianCloud
from gn0.render.instance import PART_SPLATS_MAX, Instance


class Cloud(msgspec.Struct, frozen=True, tag="cloud"):
    """Splats of moving parts, in shared memory whose file descriptor comes along.

    Attributes:
        name: of that connection; what is sent last under it counts.
        count: N.
        coefficients: K, of spherical harmonics.
        normals: whether there are any.
        labels: whether splats know which object they belong to.
        categories: category of each object, int32 [K] as bytes; None if unknown.
    """

    name: str
    count: int
    coefficients: int
    normals: bool
    labels: bool = False
    categories: bytes | None = None

    @property
    def size(self) -> int:
        """Bytes: means, quaternions, scales, opacities, harmonics, normals, float32; labels."""
        words = 3 + 4 + 3 + 1 + 3 * self.coefficients + 3 * self.normals + self.labels
        return self.count * words * 4

    def lay(self, cloud: GaussianCloud, area: NDArray[np.uint8]) -> None:
        """Put a cloud's splats into an area."""
        arrays = [cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.sh, cloud.normal]
        held = [np.ravel(array) for array in arrays if array is not None]
        words = area[: self.size].view(np.float32)
        floats = self.count * (len(words) // max(self.count, 1) - self.labels)
        words[:floats] = np.concatenate(held, dtype=np.float32)
        if cloud.label is not None:
            words[floats:].view(np.int32)[:] = cloud.label

    def read(self, area: NDArray[np.uint8]) -> GaussianCloud:
        """The cloud in an area: a copy.

        Raises:
            FormatError: it is smaller than said.
        """
        if not 0 <= self.count <= PART_SPLATS_MAX or self.coefficients not in (1, 4, 9, 16):
            raise FormatError("an unknown kind of cloud", field="count")
        if len(area) < self.size:
            raise FormatError("an area smaller than its cloud", field="count")
        words, at = area[: self.size].view(np.float32), 0
        widths = [(3,), (4,), (3,), (), (self.coefficients, 3), *([(3,)] * self.normals)]
        arrays = []
        for width in widths:
            size = self.count * int(np.prod(width, dtype=int))
            arrays.append(words[at : at + size].reshape(self.count, *width).copy())
            at += size
        means, quats, scales, opacities, sh, *normal = arrays
        if self.categories is not None and len(self.categories) % 4:
            raise FormatError("categories of another size than numbers", field="categories")
        return GaussianCloud(
            means, quats, scales, opacities, sh,
            label=words[at : at + self.count].view(np.int32).copy() if self.labels else None,
            normal=normal[0] if normal else None,
            categories=(
                None if self.categories is None else np.frombuffer(self.categories, np.int32)
            ),
        )  # fmt: skip


class Player(msgspec.Struct, frozen=True, tag="player"):
    """Somebody whom the drawing process is to pose itself, from where it finds it.

    Attributes:
        number: what the `Posed` of that connection call it.
        source: who, and where it is found: what the server's poser takes.
    """

    number: int
    source: dict[str, Any]


class Posed(msgspec.Struct, frozen=True, array_like=True):
    """A player in a pose: a cloud of which only the key is sent.

    Attributes:
        player: number of it.
        how: the pose, as the server's poser takes it.
    """

    player: int
    how: tuple[str | int | float, ...]


class PartRows(msgspec.Struct, frozen=True):
    """Instances of the views of a draw.

    Attributes:
        clouds: names of those in use.
        cloud_of: int32 [P] which of them an instance is of; numbers after the last are `posed`.
        poses: float64 [P, 4, 4] part to world.
        gains: float32 [P, 4, 3]; NaN where there is none.
        ends: int32 [V] where the instances of each view end.
        posed: clouds that are posed over there.
        nearer: float64 [P] m; empty where all are 0.
    """

    clouds: tuple[str, ...]
    cloud_of: bytes
    poses: bytes
    gains: bytes
    ends: bytes
    posed: tuple[Posed, ...] = ()
    nearer: bytes = b""

    @classmethod
    def of_parts(
        cls,
        parts: Sequence[Sequence[Instance]],
        names: Mapping[str, str],
        posed: Mapping[str, Posed] | None = None,
    ) -> PartRows:
        """Of the instances of each view.

        Args:
            parts: they.
            names: what the other side calls their clouds.
            posed: clouds that it poses itself, by the names that instances have for them.
        """
        rows = [one for instances in parts for one in instances]
        posed = posed or {}
        used = list(dict.fromkeys(row.cloud for row in rows))
        clouds = list(dict.fromkeys(names[name] for name in used if name not in posed))
        number = {name: clouds.index(names[name]) for name in used if name not in posed}
        keys = [name for name in used if name in posed]
        number |= {name: n for n, name in enumerate(keys, len(clouds))}
        gains = np.full((len(rows), 4, 3), np.nan, np.float32)
        for gain, row in zip(gains, rows, strict=True):
            if row.gain is not None:
                gain[:] = row.whole_gain
        nearer = np.array([row.nearer for row in rows], np.float64)
        return cls(
            tuple(clouds),
            np.array([number[row.cloud] for row in rows], np.int32).tobytes(),
            np.array([row.pose for row in rows], np.float64).tobytes(),
            gains.tobytes(),
            np.cumsum([len(instances) for instances in parts], dtype=np.int32).tobytes(),
            tuple(posed[name] for name in keys),
            nearer.tobytes() if nearer.any() else b"",
        )

    def read(
        self, count: int, prefix: str = "", posed: Sequence[str] = ()
    ) -> list[tuple[Instance, ...]]:
        """The instances of each of `count` views.

        Args:
            count: views.
            prefix: comes before the names of clouds that were sent.
            posed: names of those that were posed here.

        Raises:
            FormatError: they are none.
        """
        if len(self.cloud_of) % 4 or len(self.ends) % 4:
            raise FormatError(
                "instances whose shape differs from what was announced", field="parts"
            )
        cloud_of = np.frombuffer(self.cloud_of, np.int32)
        ends = np.frombuffer(self.ends, np.int32)
        total = len(cloud_of)
        good = len(self.poses) == total * 128 and len(self.gains) == total * 48
        good = good and len(self.nearer) in (0, total * 8)
        good = good and len(ends) == count and bool((np.diff(ends, prepend=0) >= 0).all())
        good = good and (int(ends[-1]) if count else 0) == total
        clouds = [*(f"{prefix}{name}" for name in self.clouds), *posed]
        if not good or ((cloud_of < 0) | (cloud_of >= len(clouds))).any():
            raise FormatError(
                "instances whose shape differs from what was announced", field="parts"
            )
        poses = np.frombuffer(self.poses, np.float64).reshape(-1, 4, 4)
        gains = np.frombuffer(self.gains, np.float32).reshape(-1, 4, 3)
        nearer = np.frombuffer(self.nearer, np.float64) if self.nearer else np.zeros(total)
        each = zip(cloud_of.tolist(), poses, gains, nearer.tolist(), strict=True)
        rows = [
            Instance(clouds[cloud], pose, None if np.isnan(gain).any() else gain, near)
            for cloud, pose, gain, near in each
        ]
        starts = [0, *ends.tolist()]
        return [tuple(rows[a:b]) for a, b in pairwise(starts)]
