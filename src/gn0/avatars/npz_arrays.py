"""Arrays of .npy and .npz files, ours or a stranger's: no pickle, no eval, no bomb.

NumPy's own reader believes the header; here each size is checked against the bytes that are there,
the header is a strict grammar (NEP 1), and arrays of Python objects are refused by name.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.file_source import REWRITE, FileSource, open_source
from gn0.errors import FormatError
from gn0.gaussians.sog_zip import load_zip_directory, read_zip_entry
from gn0.storage import plain_path, storage_error

MAGIC = b"\x93NUMPY"
MEMBER_MOST = 512 << 20  # bytes of one array, unpacked
PLAIN, SWELL = 24 << 20, 4  # bytes that any file may unpack to; and so often its own size more
_HEADER_LIMIT = 4096
_HEADER = re.compile(
    r"\{'descr': '([^']{1,20})', 'fortran_order': (False|True), 'shape': \(([\d, ]*)\),? *\}\s*"
)
_KINDS = re.compile(r"[<>|=]?([fiu][1248]|f2|b1|[SU]\d{1,6})")


class ArrayFile:
    """An `.npz` file whose arrays are read one by one, when they are asked for.

    Args:
        path: the file.
        data: its bytes, where they have been read; the file is not opened then.

    Raises:
        StorageError: it cannot be read.
        FormatError: it is no zip archive, cut off or damaged.
    """

    def __init__(self, path: Path | str, data: bytes | None = None) -> None:
        self.path, self._data = plain_path(path), data
        with self._open() as source:
            if source.size < 2 or source.read(0, 2, "an .npz file") != b"PK":
                raise source.refuse(
                    "this is not an .npz file",
                    remedy="a pickled file (.pkl) is never opened: take its .npz",
                )
            entries = load_zip_directory(source)
        self._entries = {name.removesuffix(".npy"): entry for name, entry in entries.items()}

    @contextmanager
    def _open(self) -> Iterator[FileSource]:
        if self._data is not None:
            yield open_source(self._data, self.path)
            return
        try:
            with open(self.path, "rb", buffering=0) as stream:
                size = stream.seek(0, io.SEEK_END)
                yield FileSource(stream, self.path, size)
        except OSError as error:
            raise storage_error(error, self.path, "read") from error

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all members, arrays or not."""
        return tuple(self._entries)

    def refuse(self, what: str, *, field: str = "", remedy: str = REWRITE) -> FormatError:
        """An error about this file, to be raised."""
        return FormatError(what, file=self.path, field=field, remedy=remedy)

    def require(self, names: Iterable[str], kind: str, remedy: str) -> None:
        """Raises FormatError if the file lacks one of these arrays."""
        missing = [name for name in names if name not in self]
        if missing:
            raise self.refuse(
                f"this is not {kind}: {', '.join(missing)} missing, it has "
                f"{', '.join(name[:40] for name in self.names[:12]) or 'nothing'}",
                field=missing[0],
                remedy=remedy,
            )

    def read(self, name: str, most: int = MEMBER_MOST) -> NDArray[Any]:
        """One array.

        Args:
            name: its name, without `.npy`.
            most: bytes that it may have at most.

        Raises:
            StorageError: the file cannot be read.
            FormatError: there is no such array, it is cut short, larger than it or any array of
                such a file may be, damaged, or holds Python objects.
        """
        if name not in self._entries:
            raise self.refuse(f"there is no array {name!r}", field=name)
        with self._open() as source:
            limit = min(most, PLAIN + SWELL * source.size)
            data = read_zip_entry(source, self._entries[name], limit)
        return read_npy(data, self.path, name).copy("K")

    def read_numbers(self, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
        """One array of numbers as float64, of a shape with None where any size will do.

        Raises:
            StorageError, FormatError: as `read`; another shape, or no numbers.
        """
        found = self.read(name)
        fits = found.ndim == len(shape) and all(
            want in (None, have) for want, have in zip(shape, found.shape, strict=True)
        )
        if not fits or found.dtype.kind not in "fiub":
            wanted = ", ".join("any" if size is None else str(size) for size in shape)
            raise self.refuse(
                f"array is {found.dtype} {list(found.shape)}, expected numbers [{wanted}]",
                field=name,
            )
        with np.errstate(invalid="ignore"):  # NaNs that would signal
            return found.astype(np.float64)

    def read_floats(self, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
        """The same where all must be finite.

        Raises:
            StorageError, FormatError: as `read_numbers`; or not finite.
        """
        values = self.read_numbers(name, shape)
        if not np.isfinite(values).all():
            first = tuple(int(k[0]) for k in np.nonzero(~np.isfinite(values)))
            raise self.refuse(f"value at {first} is not finite", field=name)
        return values

    def text(self, name: str) -> str:
        """A member that is one text; "" where it is not there."""
        if name not in self:
            return ""
        value = self.read(name)
        if value.size != 1 or value.dtype.kind not in "US":
            return ""
        try:
            item = value.reshape(-1)[0]
            return item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item)
        except (ValueError, UnicodeError):  # numbers that are no characters
            return ""


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


def write_arrays(stream: IO[bytes], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as a packed `.npz`: the same arrays give the same bytes."""
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(array), allow_pickle=False)
            archive.writestr(
                zipfile.ZipInfo(f"{name}.npy"), buffer.getvalue(), zipfile.ZIP_DEFLATED, 9
            )
