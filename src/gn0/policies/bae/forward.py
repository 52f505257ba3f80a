"""Qwen3-VL for prompts of one layout, in torch: no loops over samples, no masks, no padding.

Works on the weights of a stock `Qwen3VLForConditionalGeneration`, for training and for acting.
transformers' own forward attends picture by picture in Python and finds rotary positions token by
token; here equal pictures are one batched attention, and what the layout decides is precomputed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.checkpoint import checkpoint
from transformers import Qwen3VLForConditionalGeneration

from gn0.errors import CheckpointError
from gn0.policies.qwen.architecture import Architecture, parse_architecture
from gn0.policies.qwen.layout import PromptLayout
from gn0.policies.qwen.tables import (
    place_patches,
    resample_positions,
    rotate_patches,
    rotate_tokens,
)

GATHERED = "compute_gathered"
"""Method of blocks whose weights lie in parts on several cards: calls what it is given with the
block and the rest, all of its weights at hand."""


@dataclass(frozen=True)
class FeaturesTorch:
    """What the language model is given of a prompt's pictures, in their order.

    Attributes:
        merged: [B, tokens, hidden] of each picture.
        levels: the same of each deepstack level.
    """

    merged: tuple[Tensor, ...]
    levels: tuple[tuple[Tensor, ...], ...]

    def repeat(self, times: int) -> FeaturesTorch:
        """Each sample's so many times in a row: answers to one prompt share its pictures."""

        def each(some: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
            return tuple(one.repeat_interleave(times, 0) for one in some)

        return FeaturesTorch(each(self.merged), tuple(each(level) for level in self.levels))


@dataclass(frozen=True)
class Answers:
    """What was sampled.

    Attributes:
        ids: int64 [B, slots].
        logprobs: float32 [B, slots], each token's among those that its slot allows; 0 if forced.
        entropy: float32 [B, slots], of the same distributions.
    """

    ids: Tensor
    logprobs: Tensor
    entropy: Tensor


class ForwardConstant(nn.Module):
    """A model's forward for one layout.

    Args:
        model: its weights are used, not copied.
        layout: of all prompts.
        answer: tokens of an answer, at most.
        compiled: compile the blocks (`torch.compile`, static shapes).
        checkpointed: compute blocks again on the way back instead of keeping what is inside them.
        joined: one product for query, key and value, and one for gate and up: inputs are read once.
            The same numbers; for layers without adapters.
        narrow: under autocast, what runs from layer to layer has its type, too; else float32.
    """

    def __init__(
        self,
        model: Qwen3VLForConditionalGeneration,
        layout: PromptLayout,
        answer: int,
        *,
        compiled: bool = False,
        checkpointed: bool = False,
        joined: bool = False,
        narrow: bool = False,
    ) -> None:
        super().__init__()
        self.model, self.layout, self.answer = model, layout, answer
        self.joined, self.narrow = joined, narrow
        self.architecture: Architecture = parse_architecture(model.config.to_dict())
        positions = np.concatenate([layout.positions, layout.positions_behind(answer)], 1)
        self._keep("rotation", *rotate_tokens(positions, self.architecture.text))
        vision = self.architecture.vision
        for height, width in {(size.height, size.width) for size in layout.sizes}:
            rows, columns = place_patches(height, width, vision)
            self._keep(f"patches_{height}_{width}", *rotate_patches(rows, columns, vision))
            taps, weights = resample_positions(rows, columns, height, width, vision)
            for name, table in (("taps", taps), ("weights", weights)):
                table = torch.from_numpy(table)
                self.register_buffer(f"{name}_{height}_{width}", table, persistent=False)
        self._patch_block: Callable[..., Tensor] = _patch_block
        self._text_block: Callable[..., tuple[Tensor, Tensor, Tensor]] = _text_block
        self._tail_block: Callable[..., tuple[Tensor, Tensor, Tensor]] = _tail_block
        blocks = ("_patch_block", "_text_block", "_tail_block")
        for name in blocks if compiled else ():
            setattr(self, name, torch.compile(getattr(self, name), dynamic=False))
        for name in blocks if checkpointed else ():
            setattr(self, name, partial(checkpoint, getattr(self, name), use_reentrant=False))
        sharded = hasattr(model.model.language_model.layers[0], GATHERED)
        for name in blocks if sharded else ():
            setattr(self, name, partial(_compute_gathered, getattr(self, name)))

    def _keep(self, name: str, cos: Any, sin: Any) -> None:
        self.register_buffer(f"{name}_cos", torch.from_numpy(cos), persistent=False)
        self.register_buffer(f"{name}_sin", torch.from_numpy(sin), persistent=False)

    def encode(self, pictures: Sequence[Tensor]) -> FeaturesTorch:
        """Features of a prompt's pictures, uint8 [B, H, W, 3] each, in the layout's order.

        Raises:
            CheckpointError: another number, size or type of pictures than the layout's.
        """
        got = [tuple(one.shape[1:]) for one in pictures]
        wanted = [(size.height, size.width, 3) for size in self.layout.sizes]
        if got != wanted or any(one.dtype != torch.uint8 for one in pictures):
            raise CheckpointError(f"pictures have shapes {got}, not {wanted} of uint8")
        merged: list[Tensor | None] = [None] * len(got)
        levels: list[list[Tensor | None]] = [
            [None] * len(got) for _ in self.architecture.vision.deepstack
        ]
        for shape in dict.fromkeys(got):
            which = [k for k, one in enumerate(got) if one == shape]
            x, deep = self._tower(torch.cat([pictures[k] for k in which]), *shape[:2])
            for k, part in zip(which, x.chunk(len(which)), strict=True):
                merged[k] = part
            for level, some in zip(levels, deep, strict=True):
                for k, part in zip(which, some.chunk(len(which)), strict=True):
                    level[k] = part
        return FeaturesTorch(tuple(merged), tuple(tuple(level) for level in levels))

    def logits(
        self, features: FeaturesTorch, ids: Tensor, answer: Tensor, rows: Tensor | None = None
    ) -> Tensor:
        """Logits [B, A, vocabulary or rows] of each token of an answer, given those before it.

        Args:
            features: of the prompts' pictures.
            ids: int64 [B, P], prompts.
            answer: int64 [B, A].
            rows: only these ids' logits.
        """
        return self.score(self.read(features, ids, answer), rows)

    def read(self, features: FeaturesTorch, ids: Tensor, answer: Tensor) -> Tensor:
        """Hidden states [B, A, hidden] that an answer's tokens are told from; see `logits`.

        The first is that of the prompt's last token, and knows nothing of the answer.
        """
        said = torch.cat([ids, answer[:, :-1]], 1)
        return self._read(features, said, answer.shape[1])[0]

    @torch.no_grad()
    def sample(
        self,
        features: FeaturesTorch,
        ids: Tensor,
        slots: Sequence[Tensor | int],
        *,
        temperature: float = 0.0,
        generator: torch.Generator | None = None,
        times: int = 1,
        draws: Tensor | None = None,
    ) -> Answers:
        """Answers, each token out of its slot's ids; forced runs are read at once.

        Args:
            features: of the prompts' pictures.
            ids: int64 [B, P], prompts.
            slots: int64 ids that each token may have; or a place in the prompt whose token it is.
            temperature: 0 takes the most probable, the first of equals.
            generator: of the draws.
            times: answers to each prompt, in a row: [B · times, slots]; it is read once.
            draws: float32 [B · times, slots] in [0, 1), by which tokens are drawn at temperature 1,
                as by `pick_token`; below 0: the most probable. Not with a temperature.
        """
        batch, device = len(ids) * times, ids.device
        hidden, keys, values = self._read(features, ids, 1, room=len(slots))
        out = torch.empty((batch, len(slots)), dtype=torch.int64, device=device)
        chance = torch.zeros((batch, len(slots)), device=device)
        entropy = torch.zeros((batch, len(slots)), device=device)
        last, read = hidden[:, -1], 0
        if times > 1:
            last = last.repeat_interleave(times, 0)
            keys = [one.repeat_interleave(times, 0) for one in keys]
            values = [one.repeat_interleave(times, 0) for one in values]
        for k, allowed in enumerate(slots):
            if isinstance(allowed, int):
                out[:, k] = ids[:, allowed].repeat_interleave(times, 0)
                continue
            if len(allowed) == 1:
                out[:, k] = allowed
                continue
            if read < k:
                last = self._add(out[:, read:k], keys, values, ids.shape[1] + read)
                read = k
            score = self.score(last, allowed).float()
            chances = (score / temperature if temperature > 0 else score).log_softmax(-1)
            if temperature > 0:
                picked = torch.multinomial(chances.exp(), 1, generator=generator)
            else:
                picked = score.argmax(-1, keepdim=True)
                if draws is not None:
                    upto = (score - score.amax(-1, keepdim=True)).double().exp().cumsum(-1)
                    own = draws[:, k : k + 1]
                    drawn = (upto <= own * upto[:, -1:]).sum(-1, keepdim=True)
                    picked = torch.where(own < 0, picked, drawn.clamp(max=len(allowed) - 1))
            out[:, k] = allowed[picked[:, 0]]
            chance[:, k] = chances.gather(1, picked)[:, 0]
            entropy[:, k] = -(chances.exp() * chances).sum(-1)
        return Answers(out, chance, entropy)

    def _tower(self, pictures: Tensor, height: int, width: int) -> tuple[Tensor, list[Tensor]]:
        shape, tower = self.architecture.vision, self.model.model.visual
        size = f"{height}_{width}"
        cos, sin = getattr(self, f"patches_{size}_cos"), getattr(self, f"patches_{size}_sin")
        taps, weights = getattr(self, f"taps_{size}"), getattr(self, f"weights_{size}")
        kernel = tower.patch_embed.proj
        frames = kernel.weight.sum(2).flatten(1)  # all frames of a patch are one picture
        x = functional.linear(cut_patches(pictures, shape).to(frames.dtype), frames, kernel.bias)
        x = x + (tower.pos_embed(taps) * weights[..., None]).sum(1).to(x.dtype)
        deep = {}
        for k, block in enumerate(tower.blocks):
            x = self._patch_block(block, x, cos, sin, shape.heads)
            if k in shape.deepstack:
                level = shape.deepstack.index(k)
                deep[level] = _merge(tower.deepstack_merger_list[level], x, shape.merge)
        return _merge(tower.merger, x, shape.merge), [deep[k] for k in sorted(deep)]

    def _read(
        self, features: FeaturesTorch, ids: Tensor, last: int, room: int = 0
    ) -> tuple[Tensor, list[Tensor], list[Tensor]]:
        """Hidden states of the last tokens, so many; of those before, only what these look at."""
        language = self.model.model.language_model
        x = language.embed_tokens(ids)
        if self.narrow and torch.is_autocast_enabled(x.device.type):
            x = x.to(torch.get_autocast_dtype(x.device.type))
        x = self._put(x, features.merged, add=False)
        cos, sin = self.rotation_cos[: x.shape[1]], self.rotation_sin[: x.shape[1]]
        keys, values = [], []
        for k, layer in enumerate(language.layers):
            if k + 1 == len(language.layers) and k >= len(features.levels):
                # nobody looks at its other tokens
                x, key, value = self._tail_block(layer, x, cos, sin, self.joined, last)
            else:
                x, key, value = self._text_block(layer, x, cos, sin, self.joined)
            if k < len(features.levels):
                x = self._put(x, features.levels[k], add=True)
            if room:
                keys.append(functional.pad(key, (0, 0, 0, room)))
                values.append(functional.pad(value, (0, 0, 0, room)))
        return language.norm(x[:, -last:]), keys, values

    def _put(self, x: Tensor, pictures: tuple[Tensor, ...], *, add: bool) -> Tensor:
        parts, begin = [], 0
        for (at, count), one in zip(self.layout.places, pictures, strict=True):
            parts.append(x[:, begin:at])
            parts.append(x[:, at : at + count] + one.to(x.dtype) if add else one.to(x.dtype))
            begin = at + count
        return torch.cat([*parts, x[:, begin:]], 1)

    def _add(self, ids: Tensor, keys: list[Tensor], values: list[Tensor], at: int) -> Tensor:
        language = self.model.model.language_model
        x = language.embed_tokens(ids)
        end = at + x.shape[1]
        cos, sin = self.rotation_cos[at:end], self.rotation_sin[at:end]
        seen = None if x.shape[1] == 1 else _see_back(x.shape[1], end, x.device)
        for layer, key, value in zip(language.layers, keys, values, strict=True):
            query, key[:, :, at:end], value[:, :, at:end] = _project(layer, x, cos, sin)
            looked = _look_back(query, key[:, :, :end], value[:, :, :end], seen)
            x = _finish(layer, x, looked)
        return language.norm(x[:, -1])

    def score(self, hidden: Tensor, rows: Tensor | None = None) -> Tensor:
        """Logits [..., vocabulary, or as many as `rows`] of hidden states [..., hidden]."""
        head = self.model.lm_head.weight
        return functional.linear(hidden, head if rows is None else head[rows])


def _compute_gathered(compute: Callable[..., Any], block: Any, *given: Any) -> Any:
    return getattr(block, GATHERED)(compute, *given)


def cut_patches(pictures: Tensor, shape: Any) -> Tensor:
    """Pixels -1..1 by patch [n, patches, 3 · patch²]; see `gn0.policies.qwen.tables`."""
    count, height, width, _ = pictures.shape
    side, merge = shape.patch, shape.merge
    rows, columns = height // (side * merge), width // (side * merge)
    parts = pictures.view(count, rows, merge, side, columns, merge, side, 3)
    flat = parts.permute(0, 1, 4, 2, 5, 7, 3, 6).reshape(count, -1, 3 * side * side)
    return (flat.float() / 255 - 0.5) / 0.5


def _turn(x: Tensor) -> Tensor:
    low, high = x.chunk(2, -1)
    return torch.cat((-high, low), -1)


def _rotate(x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    return x * cos + _turn(x) * sin


def _patch_block(block: Any, x: Tensor, cos: Tensor, sin: Tensor, heads: int) -> Tensor:
    count, patches, hidden = x.shape
    qkv = block.attn.qkv(block.norm1(x)).view(count, patches, 3, heads, hidden // heads)
    query, key, value = qkv.permute(2, 0, 3, 1, 4)
    query, key = (_rotate(one.float(), cos, sin).to(value.dtype) for one in (query, key))
    seen = functional.scaled_dot_product_attention(query, key, value)
    x = x + block.attn.proj(seen.transpose(1, 2).reshape(count, patches, hidden))
    return x + block.mlp(block.norm2(x))


def _merge(merger: Any, x: Tensor, merge: int) -> Tensor:
    count, patches, _ = x.shape
    return merger(x).view(count, patches // merge**2, -1)


def _project(
    layer: Any, x: Tensor, cos: Tensor, sin: Tensor, tail: int | None = None, joined: bool = False
) -> tuple[Tensor, Tensor, Tensor]:
    """Queries of the last `tail` tokens, keys and values of all."""
    own, tail = layer.self_attn, x.shape[1] if tail is None else tail
    x = layer.input_layernorm(x)
    heads = (*x.shape[:2], -1, own.head_dim)
    if joined:
        query, key, value = _join(x, own.q_proj, own.k_proj, own.v_proj)
    else:
        query, key, value = own.q_proj(x[:, -tail:]), own.k_proj(x), own.v_proj(x)
    query = own.q_norm(query.view(len(x), tail, -1, own.head_dim)).transpose(1, 2)
    key = own.k_norm(key.view(heads)).transpose(1, 2)
    value = value.view(heads).transpose(1, 2)
    query = _rotate(query, cos[-tail:], sin[-tail:])
    return query.to(value.dtype), _rotate(key, cos, sin).to(value.dtype), value


def _join(x: Tensor, *layers: Any) -> tuple[Tensor, ...]:
    """What linear layers without bias say of x, by one product."""
    weights = [layer.weight for layer in layers]
    return functional.linear(x, torch.cat(weights)).split([len(w) for w in weights], -1)


def _see_back(count: int, end: int, device: torch.device) -> Tensor:
    """Which of `end` tokens each of the last `count` may look at: bool [count, end]."""
    return torch.ones((count, end), dtype=torch.bool, device=device).tril(end - count)


def _look_back(query: Tensor, key: Tensor, value: Tensor, seen: Tensor | None) -> Tensor:
    """Attention of a few last tokens; heads that share keys are rows of one product.

    So keys and values are read once, by kernels that know nothing of groups of heads.
    """
    batch, heads, count, size = query.shape
    groups = heads // key.shape[1]
    rows = query.reshape(batch, key.shape[1], groups * count, size)
    mask = None if seen is None else seen.repeat(groups, 1)
    looked = functional.scaled_dot_product_attention(rows, key, value, attn_mask=mask)
    return looked.reshape(batch, heads, count, size)  # float32 kernels lay it out otherwise


def _finish(layer: Any, x: Tensor, seen: Tensor, joined: bool = False) -> Tensor:
    x = x + layer.self_attn.o_proj(seen.transpose(1, 2).reshape(*x.shape[:2], -1))
    inner, mlp = layer.post_attention_layernorm(x), layer.mlp
    if not joined:
        return x + mlp(inner)
    gate, up = _join(inner, mlp.gate_proj, mlp.up_proj)
    return x + mlp.down_proj(mlp.act_fn(gate) * up)


def _text_block(
    layer: Any, x: Tensor, cos: Tensor, sin: Tensor, joined: bool
) -> tuple[Tensor, Tensor, Tensor]:
    query, key, value = _project(layer, x, cos, sin, joined=joined)
    seen = functional.scaled_dot_product_attention(
        query, key, value, is_causal=True, enable_gqa=query.shape[1] != key.shape[1]
    )
    return _finish(layer, x, seen, joined), key, value


def _tail_block(
    layer: Any, x: Tensor, cos: Tensor, sin: Tensor, joined: bool, tail: int
) -> tuple[Tensor, Tensor, Tensor]:
    """A layer's last `tail` tokens, and its keys and values of all."""
    query, key, value = _project(layer, x, cos, sin, tail)
    seen = None if tail == 1 else _see_back(tail, x.shape[1], x.device)
    looked = _look_back(query, key, value, seen)
    return _finish(layer, x[:, -tail:], looked, joined), key, value
