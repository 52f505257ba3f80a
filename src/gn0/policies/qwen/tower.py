"""The vision tower in NumPy: pictures to features of tokens (`Qwen3VLVisionModel`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from gn0.geometry import U8
from gn0.policies.qwen.architecture import VisionShape
from gn0.policies.qwen.tables import (
    F32,
    cut_patches,
    place_patches,
    resample_positions,
    rotate_patches,
)
from gn0.policies.qwen.weights import Weights

_EPS = 1e-6  # of all layer norms of the tower
_MANY = 1 << 22  # numbers of attention at a time, so that they stay in the caches


@dataclass(frozen=True)
class Features:
    """What the language model is given of pictures.

    Attributes:
        merged: float32 [n, tokens, hidden].
        levels: the same of each deepstack level.
    """

    merged: F32
    levels: tuple[F32, ...]

    def pick(self, which: slice) -> Features:
        """Those of some pictures."""
        return Features(self.merged[which], tuple(level[which] for level in self.levels))


class Tower:
    """Weights of a vision tower, and its forward.

    Args:
        shape: its sizes.
        weights: by name, as transformers saves them.
        prefix: before the names.
    """

    def __init__(self, shape: VisionShape, weights: Weights, prefix: str = "model.visual.") -> None:
        self.shape = shape

        def linear(name: str) -> tuple[F32, F32]:
            matrix = np.ascontiguousarray(weights[f"{prefix}{name}.weight"].T)
            return matrix, weights[f"{prefix}{name}.bias"]

        def norm(name: str) -> tuple[F32, F32]:
            return weights[f"{prefix}{name}.weight"], weights[f"{prefix}{name}.bias"]

        kernel = weights[f"{prefix}patch_embed.proj.weight"]
        # all frames of a patch are one picture
        self._patch = np.ascontiguousarray(kernel.sum(2).reshape(len(kernel), -1).T)
        self._patch_bias = weights[f"{prefix}patch_embed.proj.bias"]
        self._table = weights[f"{prefix}pos_embed.weight"]
        self._blocks = [
            (
                norm(f"blocks.{k}.norm1"),
                linear(f"blocks.{k}.attn.qkv"),
                linear(f"blocks.{k}.attn.proj"),
                norm(f"blocks.{k}.norm2"),
                linear(f"blocks.{k}.mlp.linear_fc1"),
                linear(f"blocks.{k}.mlp.linear_fc2"),
            )
            for k in range(shape.layers)
        ]
        names = ["merger", *(f"deepstack_merger_list.{k}" for k in range(len(shape.deepstack)))]
        self._mergers = [
            (norm(f"{name}.norm"), linear(f"{name}.linear_fc1"), linear(f"{name}.linear_fc2"))
            for name in names
        ]
        self._places: dict[tuple[int, int], tuple[F32, F32, F32]] = {}

    def encode(self, pictures: U8) -> Features:
        """Features of pictures uint8 [n, H, W, 3] of one size."""
        _, height, width, _ = pictures.shape
        learned, cos, sin = self._placed(height, width)
        x = cut_patches(pictures, self.shape) @ self._patch + self._patch_bias + learned
        levels = {}
        for k, (before, qkv, proj, between, up, down) in enumerate(self._blocks):
            seen = self._attend(_affine(_normal(x, *before), qkv), cos, sin)
            x = x + _affine(seen, proj)
            x = x + _affine(_gelu_tanh(_affine(_normal(x, *between), up)), down)
            if k in self.shape.deepstack:
                level = self.shape.deepstack.index(k)
                levels[level] = self._merge(x, 1 + level)
        return Features(self._merge(x, 0), tuple(levels[k] for k in sorted(levels)))

    def _placed(self, height: int, width: int) -> tuple[F32, F32, F32]:
        if (height, width) not in self._places:
            rows, columns = place_patches(height, width, self.shape)
            index, weight = resample_positions(rows, columns, height, width, self.shape)
            learned = np.einsum("ptc,pt->pc", self._table[index], weight, dtype=np.float32)
            self._places[height, width] = learned, *rotate_patches(rows, columns, self.shape)
        return self._places[height, width]

    def _attend(self, qkv: F32, cos: F32, sin: F32) -> F32:
        count, patches, _ = qkv.shape
        heads = self.shape.heads
        parts = qkv.reshape(count, patches, 3, heads, -1).transpose(2, 0, 3, 1, 4)
        q, k, v = rotate(parts[0], cos, sin), rotate(parts[1], cos, sin), parts[2]
        q *= np.float32(q.shape[-1] ** -0.5)
        out = np.empty_like(q)
        step = max(1, _MANY // (heads * patches * patches))
        for at in range(0, count, step):
            some = slice(at, at + step)
            out[some] = softmax(q[some] @ k[some].swapaxes(-1, -2)) @ v[some]
        return out.transpose(0, 2, 1, 3).reshape(count, patches, -1)

    def _merge(self, x: F32, which: int) -> F32:
        norm, up, down = self._mergers[which]
        block = x.reshape(len(x), -1, self.shape.merge**2 * x.shape[-1])
        # the last merger normalises patches, those of deepstack what is merged
        x = _normal(block, *norm) if which else _normal(x, *norm).reshape(block.shape)
        return _affine(_gelu(_affine(x, up)), down)


def rotate(x: F32, cos: F32, sin: F32) -> F32:
    """Rotary positions: halves [..., head] turned against each other."""
    half = x.shape[-1] // 2
    turned = np.concatenate((-x[..., half:], x[..., :half]), -1)
    return x * cos + turned * sin


def softmax(x: F32) -> F32:
    """Softmax of the last axis, in place."""
    x -= x.max(-1, keepdims=True)
    np.exp(x, out=x)
    x /= x.sum(-1, keepdims=True)
    return x


def _affine(x: F32, layer: tuple[F32, F32]) -> F32:
    return x @ layer[0] + layer[1]


def _normal(x: F32, weight: F32, bias: F32) -> F32:
    centred = x - x.mean(-1, keepdims=True)
    spread: F32 = np.square(centred).mean(-1, keepdims=True)
    normal: F32 = centred / np.sqrt(spread + np.float32(_EPS))
    return normal * weight + bias


def _gelu_tanh(x: F32) -> F32:
    inner = np.float32(0.7978845608028654) * (x + np.float32(0.044715) * x * x * x)
    bent: F32 = np.tanh(inner, dtype=np.float32)
    return np.float32(0.5) * x * (np.float32(1) + bent)


def _erf(x: F32) -> F32:
    return np.asarray(erf(x), np.float32)


def _gelu(x: F32) -> F32:
    return np.float32(0.5) * x * (np.float32(1) + _erf(x * np.float32(0.7071067811865476)))
