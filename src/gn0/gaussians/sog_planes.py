"""The picture planes of SOG: lossless WebP, four bytes per Gaussian, sizes checked before decoding.

A few bytes of WebP can claim 268 million pixels; so the size is read from the header by hand and
held against the number of Gaussians before any decoder sees the file.
"""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np

from gn0.errors import FormatError
from gn0.gaussians.cloud_source import REEXPORT, little
from gn0.geometry import U8

_SLACK_PIXELS = 1 << 20
_MOST_PIXELS = 1 << 28


def webp_size(data: bytes) -> tuple[int, int]:
    """(width, height) [pixels] of a lossless still WebP.

    Raises:
        ValueError: not WebP, lossy, animated or cut off; the text says which.
    """
    if data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        raise ValueError("is not a WebP picture")
    at, canvas = 12, None
    while at + 8 <= len(data):
        kind, length = data[at : at + 4], little(data, at + 4, 4)
        body = at + 8
        if kind == b"VP8L":
            if body + 5 > len(data) or data[body] != 0x2F:
                raise ValueError("is a damaged WebP picture")
            bits = little(data, body + 1, 4)
            size = ((bits & 0x3FFF) + 1, ((bits >> 14) & 0x3FFF) + 1)
            if canvas not in (None, size):
                raise ValueError("is a WebP picture of two sizes")
            return size
        if kind == b"VP8 ":
            raise ValueError("is lossy WebP, which destroys the values: SOG planes are lossless")
        if kind in (b"ANIM", b"ANMF"):
            raise ValueError("is an animated WebP")
        if kind == b"VP8X" and body + 10 <= len(data):
            canvas = (little(data, body + 4, 3) + 1, little(data, body + 7, 3) + 1)
        at = body + length + (length & 1)
    raise ValueError("is a WebP picture without pixels, or cut off")


def most_pixels(need: int) -> int:
    """More pixels than this no plane has that needs so many."""
    return min(4 * need + _SLACK_PIXELS, _MOST_PIXELS)


def decode_plane(data: bytes, need: int, file: Path, name: str) -> U8:
    """Pixels [P, 4] of a plane, row by row, P ≥ `need`.

    Args:
        data: the WebP file.
        need: pixels that must be there.
        file: file at fault, for messages.
        name: name of the plane, for messages.

    Raises:
        FormatError: no lossless WebP, damaged, fewer pixels than needed, or absurdly more.
    """
    return decode_picture(data, need, file, name).reshape(-1, 4)


def decode_picture(data: bytes, need: int, file: Path, name: str, width: int = 0) -> U8:
    """As `decode_plane`, as a picture [H, W, 4]; `width` is demanded unless 0."""

    def refuse(what: str) -> FormatError:
        return FormatError(f"SOG plane {what}", file=file, offset=0, field=name, remedy=REEXPORT)

    try:
        w, h = webp_size(data)
    except ValueError as error:
        raise refuse(str(error)) from error
    if width and w != width:
        raise refuse(f"is {w} pixels wide, not {width}")
    if w * h < need:
        raise refuse(f"has {w} x {h} pixels, fewer than the {need} needed")
    if w * h > most_pixels(need):
        raise refuse(f"has {w} x {h} pixels, far more than the {need} needed")
    from PIL import Image  # here, so that reading a PLY does not load it

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=("WEBP",)) as picture:
                pixels = np.asarray(picture.convert("RGBA"))
    except Exception as error:  # whatever a decoder of hostile bytes may say
        raise refuse(f"cannot be decoded: {error}") from error
    if pixels.shape != (h, w, 4):
        raise refuse("decodes to another size than its header says")
    return pixels
