"""What depends on shapes alone: patches' order, positions of patches, and rotary angles.

Source: `modeling_qwen3_vl.py` and `vision_utils.py` of transformers 5.23.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import U8
from gn0.policies.qwen.architecture import TextShape, VisionShape
from gn0.policies.qwen.layout import I64

F32 = NDArray[np.float32]


def cut_patches(pictures: U8, vision: VisionShape) -> F32:
    """Pixels -1..1 by patch: float32 [n, patches, 3 · patch²] of uint8 [n, H, W, 3].

    Patches come in the order in which they are merged: block by block, and row by row within one.
    A patch of several frames is that of one, repeated; it is left to the weights (see `Tower`).
    """
    count, height, width, _ = pictures.shape
    side, merge = vision.patch, vision.merge
    rows, columns = height // (side * merge), width // (side * merge)
    parts = pictures.reshape(count, rows, merge, side, columns, merge, side, 3)
    ordered = parts.transpose(0, 1, 4, 2, 5, 7, 3, 6)  # block, place in it, colour, pixel
    flat = ordered.reshape(count, rows * columns * merge * merge, 3 * side * side)
    return (flat.astype(np.float32) / np.float32(255) - np.float32(0.5)) / np.float32(0.5)


def place_patches(height: int, width: int, vision: VisionShape) -> tuple[I64, I64]:
    """Row and column int64 [patches] of a picture's [px] patches, in the order of `cut_patches`."""
    merge = vision.merge
    rows, columns = height // vision.patch, width // vision.patch
    row, column = np.mgrid[:rows, :columns]

    def order(of: I64) -> I64:
        blocks = of.reshape(rows // merge, merge, columns // merge, merge)
        return blocks.transpose(0, 2, 1, 3).reshape(-1).astype(np.int64)

    return order(row), order(column)


def resample_positions(
    rows: I64, columns: I64, height: int, width: int, vision: VisionShape
) -> tuple[I64, F32]:
    """Entries int64 [patches, 4] of the square table of positions, and their weights.

    Bilinear, corners on corners (`get_vision_interpolation_indices_and_weights`).
    """
    side = round(vision.positions**0.5)

    def taps(index: I64, size: int) -> tuple[I64, F32]:
        at = index.astype(np.float32) * np.float32(side - 1) / np.float32(max(size - 1, 1))
        low = np.floor(at)
        both = low.astype(np.int64)[:, None] + np.arange(2)
        far = np.abs((at - low)[:, None] - np.arange(2, dtype=np.float32))
        weight = np.maximum(np.float32(1) - far, np.float32(0))
        return np.clip(both, 0, side - 1), weight.astype(np.float32)

    down, down_weight = taps(rows, height // vision.patch)
    across, across_weight = taps(columns, width // vision.patch)
    index = (down[:, :, None] * side + across[:, None, :]).reshape(rows.size, 4)
    weight = (down_weight[:, :, None] * across_weight[:, None, :]).reshape(rows.size, 4)
    return index, weight


def rotate_patches(rows: I64, columns: I64, vision: VisionShape) -> tuple[F32, F32]:
    """Cosines and sines float32 [patches, head] of patches' rows and columns."""
    half = vision.hidden // vision.heads // 2
    power = np.arange(0, half, 2, dtype=np.float32) / np.float32(half)
    frequency = np.float32(1) / np.power(np.float32(vision.theta), power)
    angles = [part.astype(np.float32)[:, None] * frequency for part in (rows, columns)]
    angle = np.concatenate([*angles, *angles], 1)
    return np.cos(angle), np.sin(angle)


def rotate_tokens(positions: I64, text: TextShape) -> tuple[F32, F32]:
    """Cosines and sines float32 [P, head_dim] of tokens at positions [3, P], axes interleaved."""
    power = np.arange(0, text.head_dim, 2, dtype=np.float32) / np.float32(text.head_dim)
    frequency = np.float32(1) / np.power(np.float32(text.theta), power)
    axis = np.zeros(text.head_dim // 2, np.int64)  # time, unless height or width takes it
    for one in (1, 2):
        axis[one : 3 * text.sections[one] : 3] = one
    angle = positions[axis].T.astype(np.float32) * frequency
    return np.tile(np.cos(angle), 2), np.tile(np.sin(angle), 2)
