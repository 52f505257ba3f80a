"""Pieces of clothing and hair in one file of the package."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from gn0.avatars.body_file import DATA
from gn0.avatars.makehuman.hm08 import VERTEX_COUNT
from gn0.avatars.makehuman.mhclo import Binding, Cloth
from gn0.avatars.npz_arrays import ArrayFile, write_arrays
from gn0.errors import FormatError
from gn0.storage import write_atomic

WARDROBE_FILE = DATA / "wardrobe.npz"
_STEP = 4e-5  # of stored offsets [m]
_UV_STEPS = 2047.0  # of texture coordinates
_SHARE_STEPS = 2048.0  # of weights


def save_cloths(path: Path | str, cloths: Mapping[str, Cloth]) -> None:
    """Write pieces under their names.

    Raises:
        StorageError: the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, cloth in cloths.items():
        b = cloth.binding
        arrays |= {
            f"{name}/refs": b.refs.astype(np.uint16).T,
            f"{name}/shares": np.round(b.shares[:, :2] * _SHARE_STEPS).astype(np.int16).T,
            f"{name}/offsets": np.round(b.offsets / _STEP).astype(np.int16).T,
            f"{name}/lengths": b.lengths.astype(np.uint16),
            f"{name}/units": b.units,
            f"{name}/faces": cloth.faces.astype(np.uint16).T,
            f"{name}/uv": _pack_uv(cloth),
            f"{name}/covers": np.packbits(np.isin(np.arange(VERTEX_COUNT), cloth.covers)),
            f"{name}/depth": np.array(cloth.depth, np.int32),
        }
    write_atomic(path, lambda stream: write_arrays(stream, arrays))


def _pack_uv(cloth: Cloth) -> np.ndarray:
    first = cloth.uv[:, 0, 0]
    if np.array_equal(cloth.uv, np.broadcast_to(first[:, None, None], cloth.uv.shape)):
        return first.astype(np.uint8)  # islands
    return np.round(np.clip(cloth.uv, 0.0, 1.0) * _UV_STEPS).astype(np.uint16)


@lru_cache(maxsize=64)
def load_cloth(name: str) -> Cloth:
    """A piece of the package by its name, as `top/sweater`.

    Raises:
        FormatError: there is none of that name, or the package is damaged.
    """
    arrays = ArrayFile(WARDROBE_FILE)
    if f"{name}/refs" not in arrays:
        raise FormatError(
            f"no piece is named {name!r}",
            file=WARDROBE_FILE,
            field=name,
            remedy=f"choose one of {', '.join(cloth_names())}",
        )
    two = arrays.read(f"{name}/shares").T / _SHARE_STEPS
    uv = arrays.read(f"{name}/uv").astype(np.float64)
    faces = np.ascontiguousarray(arrays.read(f"{name}/faces").T, np.int32)
    if uv.ndim == 1:
        uv = np.broadcast_to(uv[:, None, None], (len(faces), 4, 2))
    else:
        uv = uv / _UV_STEPS
    return Cloth(
        name=name,
        binding=Binding(
            refs=np.ascontiguousarray(arrays.read(f"{name}/refs").T, np.int32),
            shares=np.concatenate([two, 1.0 - two.sum(axis=1, keepdims=True)], axis=1),
            offsets=arrays.read(f"{name}/offsets").T * _STEP,
            lengths=arrays.read(f"{name}/lengths").astype(np.int32),
            units=arrays.read(f"{name}/units"),
        ),
        faces=faces,
        uv=uv,
        covers=np.flatnonzero(np.unpackbits(arrays.read(f"{name}/covers"))).astype(np.int32),
        depth=int(arrays.read(f"{name}/depth").item()),
    )


@lru_cache(maxsize=1)
def cloth_names() -> tuple[str, ...]:
    """Names of all pieces in the package."""
    found = (name.removesuffix("/refs") for name in ArrayFile(WARDROBE_FILE).names)
    return tuple(name for name in found if "/refs" not in name and name.count("/") == 1)
