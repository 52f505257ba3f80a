"""Grey pictures of maps: PNG and PGM, checked before anything is decoded."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from gn0.errors import FormatError
from gn0.geometry import U8
from gn0.storage import read_bytes

LARGEST = 1 << 26  # pixels; at 0.05 m a square of 400 m


def load_grey(path: Path) -> tuple[U8, U8]:
    """Grey and alpha [H, W] of a PNG or PGM file, top row first.

    Colours are averaged as map servers do; 16-bit pictures are scaled to 8; no alpha means 255.

    Raises:
        StorageError: the file cannot be read.
        FormatError: it is no PNG or PGM, damaged, or larger than `LARGEST` pixels.
    """
    data = read_bytes(path, limit=8 * LARGEST)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            picture = Image.open(io.BytesIO(data), formats=("PNG", "PPM"))
    except Exception as error:
        raise FormatError(
            "not a PNG or PGM picture", file=path, offset=0, remedy="check that it is a map picture"
        ) from error
    width, height = picture.size
    if width * height > LARGEST:
        raise FormatError(
            f"picture of {width} × {height} pixels is larger than {LARGEST} pixels",
            file=path,
            remedy="crop the map or lower its resolution",
        )
    raw = data[:2] == b"P5"
    if raw and len(data) < width * height:
        raise FormatError(
            f"picture of {width} × {height} pixels ends after {len(data)} bytes",
            file=path,
            offset=len(data),
            remedy="copy the file again",
        )
    try:
        return _channels(picture)
    except Exception as error:
        raise FormatError(
            f"picture cannot be decoded: {error}", file=path, remedy="copy the file again"
        ) from error


def _channels(picture: Image.Image) -> tuple[U8, U8]:
    if picture.mode in ("I", "I;16", "I;16B", "I;16L"):
        wide = np.asarray(picture).astype(np.int64)
        # Pillow keeps 16-bit greys as they are, whatever the mode is called
        grey = (np.clip(wide, 0, 65535) + 128) // 257
        return grey.astype(np.uint8), np.full(grey.shape, 255, np.uint8)
    alpha_too = picture.mode in ("LA", "PA", "RGBA") or "transparency" in picture.info
    if picture.mode in ("1", "L") and not alpha_too:
        grey8 = np.array(picture.convert("L"))
        return grey8, np.full(grey8.shape, 255, np.uint8)
    rgba = np.asarray(picture.convert("RGBA"))
    mean = (rgba[..., :3].astype(np.uint16).sum(axis=2) + 1) // 3
    return mean.astype(np.uint8), rgba[..., 3].copy()
