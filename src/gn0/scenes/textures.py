"""Textured and plain surfaces of imported meshes: what colour a point has before light.

Textures are looked up at the level of detail that matches the splats' spacing, so a splat takes
the mean colour of what it covers and not one texel of it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gn0.gaussians.film import decode_srgb
from gn0.geometry import F32
from gn0.jit import njit, prange
from gn0.scenes.mesh import SceneMesh

_PIXELS_MAX = 64_000_000
_SIDE = 1024  # textures are reduced to at most this many pixels a side
_LEVELS = 8
_LINEAR = decode_srgb(np.arange(256, dtype=np.float32) / 255)


@dataclass(frozen=True, eq=False)
class Paint:
    """A material: linear colour [3], times a linear picture [H, W, 3] (row 0 on top) if any."""

    colour: tuple[float, float, float]
    picture: F32 | None = None


def load_texture(path: Path) -> F32 | None:
    """A texture as linear light [H, W, 3], at most 1024 pixels a side; None when unreadable."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of profiles and large pictures
            with Image.open(path) as picture:
                if picture.width * picture.height > _PIXELS_MAX:
                    return None
                rgb = picture.convert("RGB")
    except Exception:  # Pillow raises whatever its decoders raise
        return None
    factor = -(-max(rgb.size) // _SIDE)
    if factor > 1:
        rgb = rgb.reduce(factor)
    return _LINEAR[np.asarray(rgb, np.uint8)]


class TextureAlbedo:
    """Albedo of a mesh's surface points.

    Args:
        mesh: `uv` in texture units, v up; `material` indexes `paints`.
        paints: the materials.
        footprint: size [m] of the patch over which one look-up averages.
    """

    def __init__(self, mesh: SceneMesh, paints: list[Paint], footprint: float = 0.01) -> None:
        self._uv = np.ascontiguousarray(mesh.uv, np.float32)
        self._material = np.ascontiguousarray(mesh.material, np.int32)
        self._colour = np.array([paint.colour for paint in paints], np.float32).reshape(-1, 3)
        texels: list[F32] = []
        table = np.full((len(paints), _LEVELS, 3), -1, np.int64)  # offset, height, width
        start = 0
        for index, paint in enumerate(paints):
            level = paint.picture
            for step in range(_LEVELS):
                if level is None or 0 in level.shape:
                    break
                table[index, step] = (start, level.shape[0], level.shape[1])
                texels.append(np.ascontiguousarray(level, np.float32).reshape(-1, 3))
                start += level.shape[0] * level.shape[1]
                level = _halved(level)
        self._texels = np.concatenate(texels) if texels else np.zeros((1, 3), np.float32)
        self._table = table
        self._level = self._face_levels(mesh, footprint)

    def _face_levels(self, mesh: SceneMesh, footprint: float) -> NDArray[np.int32]:
        """Per face the level whose texels are about as large as the footprint."""
        edge1 = self._uv[:, 1] - self._uv[:, 0]
        edge2 = self._uv[:, 2] - self._uv[:, 0]
        in_uv = np.abs(edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0]) / 2
        size = self._table[self._material, 0, 1:].clip(1).prod(axis=1)
        texels = in_uv * size / np.maximum(mesh.areas(), 1e-12) * footprint**2
        level = np.floor(0.5 * np.log2(np.maximum(texels, 1.0)) + 0.5)
        have = (self._table[:, :, 0] >= 0).sum(axis=1)[self._material]
        return np.clip(level, 0, np.maximum(have - 1, 0)).astype(np.int32)

    def albedo(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> F32:
        """Linear base colour [M, 3] at face index [M] and barycentric coordinates [M, 3]."""
        face = np.ascontiguousarray(face, np.int64)
        out = np.empty((len(face), 3), np.float32)
        _sample(
            face,
            np.ascontiguousarray(bary, np.float32),
            self._uv,
            self._material,
            self._colour,
            self._texels,
            self._table,
            self._level,
            out,
        )
        return out


def _halved(picture: F32) -> F32 | None:
    """The next level: means of 2 x 2 texels; None below two texels a side."""
    h, w = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
    if min(h, w) < 2:
        return None
    p = picture[:h, :w]
    mean = (p[0::2, 0::2] + p[1::2, 0::2] + p[0::2, 1::2] + p[1::2, 1::2]) * np.float32(0.25)
    return np.asarray(mean, np.float32)


@njit(parallel=True)
def _sample(
    face: NDArray[np.int64],
    bary: F32,
    uv: F32,
    material: NDArray[np.int32],
    colour: F32,
    texels: F32,
    table: NDArray[np.int64],
    level: NDArray[np.int32],
    out: F32,
) -> None:
    for i in prange(len(face)):
        f = face[i]
        m = material[f]
        start = table[m, level[f], 0]
        if start < 0:
            out[i, :] = colour[m]
            continue
        h, w = table[m, level[f], 1], table[m, level[f], 2]
        u, v = np.float64(0.0), np.float64(0.0)
        for k in range(3):
            u += bary[i, k] * uv[f, k, 0]
            v += bary[i, k] * uv[f, k, 1]
        x = (u - np.floor(u)) * w - 0.5
        y = (1.0 - (v - np.floor(v))) * h - 0.5
        x0, y0 = np.floor(x), np.floor(y)
        a, b = x - x0, y - y0
        c0, r0 = int(x0) % w, int(y0) % h
        c1, r1 = (c0 + 1) % w, (r0 + 1) % h
        for k in range(3):
            top = (1 - a) * texels[start + r0 * w + c0, k] + a * texels[start + r0 * w + c1, k]
            low = (1 - a) * texels[start + r1 * w + c0, k] + a * texels[start + r1 * w + c1, k]
            out[i, k] = ((1 - b) * top + b * low) * colour[m, k]
