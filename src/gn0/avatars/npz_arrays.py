"""Arrays of an `.npz` file: bounded, named, and never unpickled."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.storage import storage_error

MEMBER_MOST = 512 * 2**20  # bytes of one array, unpacked


class ArrayFile:
    """An `.npz` file whose arrays are read one by one, when they are asked for.

    Args:
        path: the file.

    Raises:
        StorageError: it cannot be read.
        FormatError: it is not a zip archive.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        try:
            with open(self.path, "rb") as stream:
                self._sizes = _directory(stream, self.path)
        except OSError as error:
            raise storage_error(error, self.path, "read") from error

    def __contains__(self, name: str) -> bool:
        return f"{name}.npy" in self._sizes

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all members, arrays or not."""
        return tuple(name.removesuffix(".npy") for name in self._sizes)

    def require(self, names: Iterable[str], kind: str, remedy: str) -> None:
        """Raises FormatError if the file lacks one of these arrays."""
        missing = [name for name in names if name not in self]
        if missing:
            raise FormatError(
                f"this is not {kind}: {', '.join(missing)} missing, it has "
                f"{', '.join(self.names[:12]) or 'nothing'}",
                file=self.path,
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
            FormatError: there is no such array, it is cut short, larger than it may be, or holds
                Python objects.
        """
        if name not in self:
            raise FormatError(f"there is no array {name!r}", file=self.path, field=name)
        if self._sizes[f"{name}.npy"] > most:
            raise FormatError(
                f"{self._sizes[f'{name}.npy']:,} bytes, at most {most:,} are expected",
                file=self.path,
                field=name,
            )
        try:
            with zipfile.ZipFile(self.path) as archive, archive.open(f"{name}.npy") as stream:
                data = stream.read(most + 1)
            return _parse(data, self.path, name)
        except OSError as error:
            raise storage_error(error, self.path, "read") from error
        except (
            zipfile.BadZipFile,
            zlib.error,
            NotImplementedError,
            RuntimeError,
            EOFError,
            ValueError,
        ) as error:
            raise FormatError(f"array is damaged: {error}", file=self.path, field=name) from None

    def read_floats(self, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
        """One array of finite numbers as float64, of a shape with None where any size will do.

        Raises:
            StorageError, FormatError: as `read`; another shape, no numbers, or not finite.
        """
        found = self.read(name)
        fits = found.ndim == len(shape) and all(
            want in (None, have) for want, have in zip(shape, found.shape, strict=True)
        )
        if not fits or found.dtype.kind not in "fiu":
            wanted = ", ".join("any" if size is None else str(size) for size in shape)
            raise FormatError(
                f"array is {found.dtype} {list(found.shape)}, expected numbers [{wanted}]",
                file=self.path,
                field=name,
            )
        values = found.astype(np.float64)
        if not np.isfinite(values).all():
            first = tuple(int(k[0]) for k in np.nonzero(~np.isfinite(values)))
            raise FormatError(f"value at {first} is not finite", file=self.path, field=name)
        return values


def _directory(stream: IO[bytes], path: Path) -> dict[str, int]:
    try:
        with zipfile.ZipFile(stream) as archive:
            return {entry.filename: entry.file_size for entry in archive.infolist()}
    except (zipfile.BadZipFile, NotImplementedError, ValueError, EOFError, UnicodeError) as error:
        raise FormatError(
            f"this is not an .npz file: {error}",
            file=path,
            remedy="a pickled body (.pkl) is never opened: take the .npz that comes with it",
        ) from None


def _parse(data: bytes, path: Path, name: str) -> NDArray[Any]:
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    if dtype.hasobject:
        raise FormatError(
            "array holds Python objects, which would have to be unpickled",
            file=path,
            field=name,
            remedy="save it again as plain numbers",
        )
    if math.prod(shape) * dtype.itemsize != len(data) - stream.tell():
        raise FormatError(
            f"array of shape {list(shape)} has {len(data) - stream.tell():,} bytes",
            file=path,
            field=name,
        )
    stream.seek(0)
    found: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
    return found


def write_arrays(stream: IO[bytes], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as a packed `.npz`: the same arrays give the same bytes."""
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(array), allow_pickle=False)
            archive.writestr(
                zipfile.ZipInfo(f"{name}.npy"), buffer.getvalue(), zipfile.ZIP_DEFLATED, 9
            )
