"""Arrays of .npy and .npz files that nobody vouches for: no pickle, no eval, no bomb.

NumPy's own reader believes the header; here each size is checked against the bytes that are there,
the header is a strict grammar (NEP 1), and arrays of Python objects are refused by name.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.turns import as_numbers
from gn0.errors import FormatError
from gn0.gaussians.cloud_source import CloudSource
from gn0.gaussians.sog_zip import ZipEntry, load_zip_directory, read_zip_entry

MAGIC = b"\x93NUMPY"
REWRITE = "write the motion again"
_HEADER_LIMIT = 4096
_PLAIN = 24 << 20  # bytes that may be unpacked of any file; larger files may give more
_HEADER = re.compile(
    r"\{'descr': '([^']{1,20})', 'fortran_order': (False|True), 'shape': \(([\d, ]*)\),? *\}\s*"
)
_KINDS = re.compile(r"[<>|=]?([fiu][1248]|f2|b1|[SU]\d{1,6})")


class MotionSource(CloudSource):
    """A file of motion in memory, on its way to a reader."""

    def refuse(
        self, what: str, offset: int | None = 0, *, field: str = "", remedy: str = REWRITE
    ) -> FormatError:
        """An error about this file, to be raised."""
        if "splat" in remedy:  # what readers of splats advise
            remedy = REWRITE
        return super().refuse(what, offset, field=field, remedy=remedy)


def open_source(data: bytes, file: Path | str) -> MotionSource:
    """The bytes of a file as the readers of the house take them."""
    return MotionSource(io.BytesIO(data), Path(file), len(data))


def read_npy(data: bytes, file: Path | str, field: str = "") -> NDArray[Any]:
    """The array of a .npy.

    Args:
        data: its bytes.
        file: its file, for messages.
        field: its name in an .npz, for messages.

    Raises:
        FormatError: no .npy, cut off, more numbers claimed than there are, or Python objects.
    """

    def refuse(what: str, offset: int = 0, remedy: str = REWRITE) -> FormatError:
        return FormatError(what, file=file, offset=offset, field=field, remedy=remedy)

    if data[:6] != MAGIC or len(data) < 10:
        raise refuse("is not an .npy array")
    wide = data[6] >= 2
    start = 12 if wide else 10
    length = int.from_bytes(data[8:start], "little")
    if data[6] not in (1, 2, 3) or length > min(_HEADER_LIMIT, len(data) - start):
        raise refuse(f".npy version {data[6]} with a header of {length} bytes is not read", 6)
    text = data[start : start + length].decode("latin-1")
    found = _HEADER.fullmatch(text)
    if found is None:
        structured = "'descr': [" in text
        what = "an array of records" if structured else "its header is damaged"
        raise refuse(f"{what}: {text[:80]!r}", start, "write a plain array of numbers")
    kind, fortran, sizes = found.groups()
    if "O" in kind:
        raise refuse(
            "holds Python objects, which are never unpickled",
            start,
            "write it as a plain array of numbers",
        )
    if _KINDS.fullmatch(kind) is None:
        raise refuse(f"type {kind!r} is not read", start)
    words = [word.strip() for word in sizes.split(",") if word.strip()]
    if len(words) > 8 or any(not word.isdigit() or len(word) > 15 for word in words):
        raise refuse(f"shape ({sizes[:60]}) is not read", start)
    try:
        dtype = np.dtype(kind)
    except TypeError:
        raise refuse(f"type {kind!r} is not read", start) from None
    shape = tuple(int(word) for word in words)
    count = 1
    for size in shape:
        count *= size
    held = len(data) - start - length
    if count * dtype.itemsize > held:
        raise refuse(
            f"shape {shape} of {kind} needs {count * dtype.itemsize} bytes, and {held} are there: "
            "truncated or forged",
            start,
        )
    if not count:
        return np.zeros(shape, dtype)
    array = np.frombuffer(data, dtype, count, start + length)
    return array.reshape(shape, order="F" if fortran == "True" else "C")


@dataclass(frozen=True)
class NpzArrays:
    """The members of an .npz, unpacked one by one where they are asked for."""

    source: MotionSource
    entries: dict[str, ZipEntry]

    @property
    def names(self) -> frozenset[str]:
        """Names of the members."""
        return frozenset(self.entries)

    def read(self, name: str) -> NDArray[Any]:
        """A member.

        Raises:
            FormatError: it is not there, too large, damaged, or holds Python objects.
        """
        if name not in self.entries:
            known = ", ".join(sorted(self.entries)[:20])
            raise self.source.refuse(
                f"has no member {name!r}; it has {known}", None, field=name, remedy=REWRITE
            )
        limit = _PLAIN + 4 * self.source.size
        data = read_zip_entry(self.source, self.entries[name], limit)
        return read_npy(data, self.source.file, name)

    def numbers(self, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """A member as float64; −1 in `shape` is any size.

        Raises:
            FormatError: as `read`, or it is of another shape, or no numbers.
        """
        values = self.read(name)
        fits = len(values.shape) == len(shape) and all(
            want in (-1, have) for want, have in zip(shape, values.shape, strict=True)
        )
        if not fits or values.dtype.kind not in "fiub":
            wanted = " × ".join("any" if size < 0 else str(size) for size in shape) or "one"
            raise self.source.refuse(
                f"has shape {values.shape} of {values.dtype.str}, not numbers {wanted}",
                None,
                field=name,
                remedy=REWRITE,
            )
        return as_numbers(values)

    def text(self, name: str) -> str:
        """A member that is one text; "" where it is not there."""
        if name not in self.entries:
            return ""
        value = self.read(name)
        if value.size != 1 or value.dtype.kind not in "US":
            return ""
        try:
            item = value.reshape(-1)[0]
            return item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item)
        except (ValueError, UnicodeError):  # numbers that are no characters
            return ""


def open_npz(data: bytes, file: Path | str) -> NpzArrays:
    """The members of an .npz by name, without ".npy".

    Raises:
        FormatError: no zip, or one that is cut off or damaged.
    """
    source = open_source(data, file)
    entries = load_zip_directory(source)
    return NpzArrays(source, {name.removesuffix(".npy"): entry for name, entry in entries.items()})
