"""What a splat file holds once decoded, and the careful assembly of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.sh import coefficient_count
from gn0.geometry import F32

BYTES_A_GAUSSIAN = 4 * (3 + 4 + 3 + 1)  # without SH


@dataclass(frozen=True, eq=False)
class CloudFile:
    """A decoded splat file.

    Attributes:
        cloud: the Gaussians, in file order, the non-finite ones left out.
        path: the file.
        format: name of the format, e.g. "ply" or "ply-packed".
        stored: number of Gaussians in the file.
        dropped: how many were left out as non-finite (a zero quaternion counts).
        sh_degree: SH degree in the file; the cloud holds at most degree 3.
        encoding: "ascii", "binary_little_endian", …; empty where there is no choice.
        comments: the file's comments.
        extra_properties: per-Gaussian properties that were not used.
        extra_elements: other tables in the file, as (name, rows).
        notes: what a careful user should know, in plain words.
        frame: which axes the cloud is in, in plain words; empty where the file fixes none.
        size: bytes of all files read; 0 stands for the one file.
        levels: how many levels of detail the file has; 1 where the format knows none.
        level: the one that was read, 0 the finest.
    """

    cloud: GaussianCloud
    path: Path
    format: str
    stored: int
    dropped: int
    sh_degree: int
    encoding: str = ""
    comments: tuple[str, ...] = ()
    extra_properties: tuple[str, ...] = ()
    extra_elements: tuple[tuple[str, int], ...] = ()
    notes: tuple[str, ...] = ()
    frame: str = ""
    size: int = 0
    levels: int = 1
    level: int = 0


class CloudBuilder:
    """Arrays of a cloud being read, filled block by block.

    Args:
        file: the file, for messages.
        count: number of Gaussians.
        degree: SH degree to hold, 0..3.
        limit_bytes: the largest decoded size allowed, if any.
        offset: byte at which the file states the count, for messages.

    Raises:
        FormatError: there are no Gaussians, or the decoded cloud would exceed the limit or memory.
    """

    def __init__(
        self, file: Path, count: int, degree: int, limit_bytes: int | None, offset: int
    ) -> None:
        self.file = file
        self.offset = offset
        k = coefficient_count(degree)
        if count == 0:
            raise FormatError(
                "the file holds no Gaussians",
                file=file,
                offset=offset,
                remedy="export the splats again",
            )
        need = count * (BYTES_A_GAUSSIAN + 12 * k)
        if limit_bytes is not None and need > limit_bytes:
            raise FormatError(
                f"{count} Gaussians take {need} bytes decoded, more than the {limit_bytes} "
                "allowed here",
                file=file,
                offset=offset,
                remedy="raise the limit, or reduce the cloud first",
            )
        try:
            self.means = np.empty((count, 3), np.float32)
            self.quats = np.empty((count, 4), np.float32)
            self.scales = np.empty((count, 3), np.float32)
            self.opacities = np.empty(count, np.float32)
            self.sh = np.empty((count, k, 3), np.float32)
            self.bad = np.zeros(count, np.bool_)  # zeros cost no memory until they are written
        except MemoryError:
            raise FormatError(
                f"{count} Gaussians take {need} bytes decoded, more than this machine has",
                file=file,
                offset=offset,
                remedy="use a machine with more memory, or reduce the cloud first",
            ) from None

    def put(self, start: int, means: F32, quats: F32, scales: F32, opacities: F32, sh: F32) -> None:
        """Store a block of activated Gaussians; quaternions are normalised here.

        Args:
            start: index of the first.
            means: [R, 3] m.
            quats: (w, x, y, z) of any length [R, 4].
            scales: linear [R, 3] m.
            opacities: [R] in 0..1.
            sh: the first coefficients [R, 3] or more, flattened as in `cloud.sh`.
        """
        span = slice(start, start + len(means))
        self.means[span] = means
        self.scales[span] = scales
        self.opacities[span] = opacities
        flat = self.sh.reshape(len(self.sh), -1)
        flat[span, : sh.shape[1]] = sh
        with np.errstate(all="ignore"):
            wide = quats.astype(np.float64)  # so that no finite length overflows
            norm = np.sqrt(np.einsum("ij,ij->i", wide, wide))
            np.divide(wide, norm[:, None], out=self.quats[span], casting="unsafe")
        self.bad[span] |= ~(norm > 0)
        self._drop_non_finite(start, self.means[span], self.scales[span])
        self._drop_non_finite(start, self.opacities[span], norm, sh)

    def put_rest(self, start: int, rest: F32) -> None:
        """Store finite SH beyond DC, [R, K − 1, 3]."""
        self.sh[start : start + len(rest), 1:] = rest

    def _drop_non_finite(self, start: int, *blocks: NDArray[Any]) -> None:
        """Mark rows that hold NaN or inf; the common case, none, is one quick pass."""
        for block in blocks:
            finite = np.isfinite(block)
            if not finite.all():
                rows = finite if finite.ndim == 1 else finite.all(axis=1)
                self.bad[start : start + len(rows)] |= ~rows

    def build(self) -> tuple[GaussianCloud, int]:
        """The cloud of all finite Gaussians, and how many were dropped.

        Raises:
            FormatError: none is left.
        """
        count = len(self.bad)
        kept = count - int(np.count_nonzero(self.bad))
        if kept == 0:
            raise FormatError(
                f"all {count} Gaussians hold NaN, infinite values or zero quaternions",
                file=self.file,
                offset=self.offset,
                remedy="export the splats again",
            )
        if kept < count:  # one array at a time, so that memory stays near one cloud
            keep = ~self.bad
            for name in ("means", "quats", "scales", "opacities", "sh"):
                setattr(self, name, getattr(self, name)[keep])
        cloud = GaussianCloud(self.means, self.quats, self.scales, self.opacities, self.sh)
        return cloud, count - kept


def sigmoid(logits: NDArray[Any]) -> F32:
    """1 / (1 + e^−x), float32; ±inf give exactly 1 and 0."""
    with np.errstate(over="ignore"):
        return (1.0 / (1.0 + np.exp(-np.asarray(logits, np.float32)))).astype(np.float32)


LOGIT_LIMIT = (-104.0, 20.0)  # sigmoid of these is exactly 0 and 1 in float32


def logit(opacities: NDArray[Any]) -> F32:
    """Inverse of `sigmoid`, finite: 0 and 1 become −104 and 20, which decode to 0 and 1 again."""
    p = np.asarray(opacities, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.log(p) - np.log1p(-p)
    return np.clip(value, *LOGIT_LIMIT).astype(np.float32)
