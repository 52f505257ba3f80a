"""Picture files of exports: JPEG, 16-bit depth PNG, and stacks of frames as .npy."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gn0.errors import FormatError
from gn0.geometry import F32, U8
from gn0.storage import read_bytes, write_atomic

PICTURE_LIMIT = 64 * 2**20  # bytes of one picture file
_PIXELS = 64 * 2**20  # of one picture


def encode_jpeg(rgb: U8, quality: int) -> bytes:
    """A picture [H, W, 3] as JPEG; the same pixels give the same bytes."""
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(rgb)).save(stream, "JPEG", quality=quality)
    return stream.getvalue()


def encode_depth(depth: F32, unit: float) -> bytes:
    """Depth [H, W] m as a 16-bit grey PNG in steps of `unit` m, cut off at 65535 steps."""
    steps = np.rint(np.asarray(depth, np.float64) / unit)
    stream = io.BytesIO()
    Image.fromarray(np.clip(steps, 0, 65535).astype(np.uint16)).save(
        stream, "PNG", compress_level=3
    )
    return stream.getvalue()


def load_picture(path: Path) -> U8:
    """The pixels [H, W, 3] of a picture file.

    Raises:
        StorageError, FormatError: missing, or no whole picture.
    """
    return np.asarray(_open(path).convert("RGB"), np.uint8)


def load_depth(path: Path, unit: float) -> F32:
    """Depth [H, W] m of a 16-bit PNG.

    Raises:
        StorageError, FormatError: missing, damaged, or not 16-bit grey.
    """
    picture = _open(path)
    if not picture.mode.startswith("I"):
        raise FormatError(
            f"a picture of mode {picture.mode!r}", file=path, remedy="depth is a 16-bit grey PNG"
        )
    return (np.asarray(picture, np.float64) * unit).astype(np.float32)


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) [px] of a picture file, after decoding all of it.

    Raises:
        StorageError, FormatError: missing, or no whole picture.
    """
    return _open(path).size


def _open(path: Path) -> Image.Image:
    data = read_bytes(path, PICTURE_LIMIT)
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as picture:
            if picture.width * picture.height > _PIXELS:
                raise ValueError(f"{picture.width}x{picture.height} pixels")
            picture.load()
            return picture.copy()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FormatError(
            f"not a whole picture: {error}", file=path, remedy="export it again"
        ) from None


def save_stack(path: Path, frames: Iterable[NDArray[Any]], count: int) -> None:
    """Write `count` arrays of one shape as one .npy file [count, …], one frame in memory at a time.

    Raises:
        StorageError: the file cannot be written.
        FormatError: more or fewer frames came, or of another shape.
    """

    def write(stream: IO[bytes]) -> None:
        first: NDArray[Any] | None = None
        done = 0
        for frame in frames:
            array = np.ascontiguousarray(frame)
            if first is None:
                first = array
                head = {
                    "descr": np.lib.format.dtype_to_descr(array.dtype),
                    "fortran_order": False,
                    "shape": (count, *array.shape),
                }
                np.lib.format.write_array_header_1_0(stream, head)
            if array.shape != first.shape or array.dtype != first.dtype:
                raise FormatError(f"frame {done} is {array.dtype}{array.shape}", file=path)
            stream.write(array.tobytes())
            done += 1
        if done != count:
            raise FormatError(f"{done} frames came, {count} were expected", file=path)

    write_atomic(path, write)


def load_stack(path: Path) -> NDArray[Any]:
    """A stack of frames, mapped from the file and not read at once.

    Raises:
        FormatError: missing or no .npy file of plain numbers.
    """
    try:
        stack = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise FormatError(
            f"not a stack of frames: {error}", file=path, remedy="export it again"
        ) from None
    if not isinstance(stack, np.ndarray) or stack.ndim < 3:
        raise FormatError("not a stack of frames", file=path, remedy="export it again")
    return stack
