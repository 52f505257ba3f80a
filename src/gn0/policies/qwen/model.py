"""Qwen3-VL in NumPy: a prompt of pictures and text, then an answer token by token.

The same weights, shapes and order of operations as `Qwen3VLForConditionalGeneration`; what a prompt
of fixed layout makes constant (positions, places of pictures) is computed once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.errors import CheckpointError
from gn0.geometry import U8
from gn0.policies.qwen.architecture import Architecture, load_architecture
from gn0.policies.qwen.layout import I64, PromptLayout
from gn0.policies.qwen.tables import F32, rotate_tokens
from gn0.policies.qwen.tower import Features, Tower, rotate, softmax
from gn0.policies.qwen.weights import Weights, open_weights


@dataclass(frozen=True)
class _Layer:
    before: F32
    qkv: F32
    query_norm: F32
    key_norm: F32
    out: F32
    between: F32
    gate_up: F32
    down: F32


@dataclass
class Cache:
    """Keys and values of what was read so far.

    Attributes:
        keys, values: float32 [B, kv heads, room, head] of each layer.
        used: tokens that are in.
        last: float32 [B, hidden], of the last token.
    """

    keys: list[F32]
    values: list[F32]
    used: int
    last: F32


class QwenNumpy:
    """A Qwen3-VL model on the CPU, without torch.

    Args:
        architecture: its shapes.
        weights: by name, as transformers saves them.

    Raises:
        CheckpointError: weights are missing or have other shapes than the architecture.
    """

    def __init__(self, architecture: Architecture, weights: Weights) -> None:
        self.architecture = architecture
        text = architecture.text
        check_shapes(architecture, weights)
        self.tower = Tower(architecture.vision, weights)
        prefix = "model.language_model."
        self.embedding = weights[f"{prefix}embed_tokens.weight"]
        self.head = self.embedding if text.tied else weights["lm_head.weight"]
        self._norm = weights[f"{prefix}norm.weight"]

        def joined(layer: int, *names: str) -> F32:
            matrices = [weights[f"{prefix}layers.{layer}.{name}.weight"] for name in names]
            return np.ascontiguousarray(np.concatenate(matrices).T)

        self._layers = [
            _Layer(
                before=weights[f"{prefix}layers.{k}.input_layernorm.weight"],
                qkv=joined(k, "self_attn.q_proj", "self_attn.k_proj", "self_attn.v_proj"),
                query_norm=weights[f"{prefix}layers.{k}.self_attn.q_norm.weight"],
                key_norm=weights[f"{prefix}layers.{k}.self_attn.k_norm.weight"],
                out=joined(k, "self_attn.o_proj"),
                between=weights[f"{prefix}layers.{k}.post_attention_layernorm.weight"],
                gate_up=joined(k, "mlp.gate_proj", "mlp.up_proj"),
                down=joined(k, "mlp.down_proj"),
            )
            for k in range(text.layers)
        ]

    def read(
        self, layout: PromptLayout, ids: I64, features: Sequence[Features], room: int = 0
    ) -> Cache:
        """Read prompts of one layout.

        Args:
            layout: where text and pictures lie.
            ids: int64 [B, P].
            features: of each picture of the layout, those of all prompts [B, tokens, hidden].
            room: tokens of the answers, to be read later.

        Raises:
            CheckpointError: ids or features have other shapes than the layout.
        """
        self._check_prompt(layout, ids, features)
        x = self.embedding[ids]
        for (at, count), seen in zip(layout.places, features, strict=True):
            x[:, at : at + count] = seen.merged
        text = self.architecture.text
        shape = (len(ids), text.kv_heads, len(layout) + room, text.head_dim)
        keys, values = ([np.empty(shape, np.float32) for _ in self._layers] for _ in range(2))
        cache = Cache(keys, values, 0, x[:, -1])
        self._run(x, layout.positions, cache, layout.places, features)
        return cache

    def add(self, cache: Cache, ids: I64, positions: I64) -> None:
        """Read further tokens int64 [B, n] at positions [3, n] into the cache."""
        self._run(self.embedding[ids], positions, cache)

    def score(self, cache: Cache, allowed: I64 | None = None) -> F32:
        """Logits float32 [B, allowed, or vocabulary] of the token behind the cache."""
        rows = self.head if allowed is None else self.head[allowed]
        return cache.last @ rows.T

    def _check_prompt(self, layout: PromptLayout, ids: I64, features: Sequence[Features]) -> None:
        if ids.ndim != 2 or ids.shape[1] != len(layout):
            raise CheckpointError(f"ids have shape {ids.shape}, not [prompts, {len(layout)}]")
        if ids.size and not 0 <= ids.min() <= ids.max() < self.architecture.text.vocabulary:
            raise CheckpointError("an id of the prompt lies outside the vocabulary")
        wanted = [(len(ids), count, self.architecture.text.hidden) for _, count in layout.places]
        got = [seen.merged.shape for seen in features]
        if got != wanted:
            raise CheckpointError(f"pictures' features have shapes {got}, not {wanted}")

    def _run(
        self,
        x: F32,
        positions: I64,
        cache: Cache,
        places: Sequence[tuple[int, int]] = (),
        features: Sequence[Features] = (),
    ) -> None:
        eps = np.float32(self.architecture.text.eps)
        cos, sin = rotate_tokens(positions, self.architecture.text)
        end = cache.used + x.shape[1]
        for k, layer in enumerate(self._layers):
            seen = self._attend(layer, root_normal(x, layer.before, eps), cos, sin, cache, k)
            x = x + seen @ layer.out
            gate, up = np.split(root_normal(x, layer.between, eps) @ layer.gate_up, 2, -1)
            x = x + (gate / (np.float32(1) + np.exp(-gate)) * up) @ layer.down
            for (at, count), pictures in zip(places, features, strict=True):
                if k < len(pictures.levels):
                    x[:, at : at + count] += pictures.levels[k]
        cache.used = end
        cache.last = root_normal(x[:, -1], self._norm, eps)

    def _attend(self, layer: _Layer, x: F32, cos: F32, sin: F32, cache: Cache, k: int) -> F32:
        text = self.architecture.text
        batch, count, _ = x.shape
        groups, eps = text.heads // text.kv_heads, np.float32(text.eps)
        parts = (x @ layer.qkv).reshape(batch, count, -1, text.head_dim)
        split = (text.heads, text.heads + text.kv_heads)
        query, key, value = (part.transpose(0, 2, 1, 3) for part in np.split(parts, split, 2))
        query = rotate(root_normal(query, layer.query_norm, eps), cos, sin)
        begin, end = cache.used, cache.used + count
        cache.keys[k][:, :, begin:end] = rotate(root_normal(key, layer.key_norm, eps), cos, sin)
        cache.values[k][:, :, begin:end] = value
        keys, values = cache.keys[k][:, :, :end], cache.values[k][:, :, :end]
        query = (query * np.float32(text.head_dim**-0.5)).reshape(
            batch, text.kv_heads, groups * count, text.head_dim
        )
        weights: F32 = np.matmul(query, keys.swapaxes(-1, -2), dtype=np.float32)
        if count > 1:
            later = np.arange(end) > np.arange(begin, end)[:, None]
            weights.reshape(batch, text.kv_heads, groups, count, end)[..., later] = -np.inf
        seen = (softmax(weights) @ values).reshape(batch, text.heads, count, text.head_dim)
        return seen.transpose(0, 2, 1, 3).reshape(batch, count, -1)


def root_normal(x: F32, weight: F32, eps: np.float32) -> F32:
    """RMS norm of the last axis."""
    return x / np.sqrt(np.square(x).mean(-1, keepdims=True) + eps) * weight


def load_numpy_model(folder: Path) -> QwenNumpy:
    """A model from a Hugging Face folder of safetensors.

    Raises:
        CheckpointError: the folder holds no such model, or not all of it.
    """
    return QwenNumpy(load_architecture(folder), open_weights(folder))


def encode_pictures(
    model: QwenNumpy, layout: PromptLayout, pictures: Sequence[U8]
) -> list[Features]:
    """Features of each picture of the layout, from uint8 [B, H, W, 3] of each.

    Pictures of one size are encoded together.

    Raises:
        CheckpointError: another number or size of pictures than the layout's.
    """
    got = [tuple(some.shape[1:]) for some in pictures]
    wanted = [(size.height, size.width, 3) for size in layout.sizes]
    if got != wanted or any(some.dtype != np.uint8 for some in pictures):
        raise CheckpointError(f"pictures have shapes {got}, not {wanted} of uint8")
    found: dict[int, Features] = {}
    for shape in dict.fromkeys(got):
        which = [k for k, one in enumerate(got) if one == shape]
        batch = len(pictures[which[0]])
        encoded = model.tower.encode(np.concatenate([pictures[k] for k in which]))
        for order, k in enumerate(which):
            found[k] = encoded.pick(slice(order * batch, (order + 1) * batch))
    return [found[k] for k in range(len(got))]


def answer_prompts(
    model: QwenNumpy,
    layout: PromptLayout,
    ids: I64,
    pictures: Sequence[U8],
    slots: Sequence[I64 | int],
    draws: F32 | None = None,
) -> NDArray[np.int64]:
    """Answers int64 [B, slots], each token out of its slot's ids: the most probable, or drawn.

    Slots of one id are not asked for: they are read together with the token before them.

    Args:
        model: answers.
        layout: of all prompts.
        ids: int64 [B, P], prompts.
        pictures: of each picture of the layout uint8 [B, H, W, 3].
        slots: ids that each token may have; or a place in the prompt whose token it is.
        draws: float32 [B, slots], by which tokens are drawn instead (`pick_token`); None: none.

    Raises:
        CheckpointError: pictures or ids do not fit the layout.
    """
    out = np.empty((len(ids), len(slots)), np.int64)
    for k, allowed, scores in _score_slots(model, layout, ids, pictures, slots, out):
        out[:, k] = allowed[pick_token(scores, None if draws is None else draws[:, k])]
    return out


def pick_token(scores: F32, draws: F32 | None) -> NDArray[np.intp]:
    """Which of K choices each of B has: [B].

    Args:
        scores: [B, K], logits.
        draws: [B] in [0, 1), by which one is drawn at temperature 1; below 0: the most probable,
            the first of equals. None: that for all.
    """
    best: NDArray[np.intp] = scores.argmax(-1)
    if draws is None or (draws < 0).all():
        return best
    shares = np.exp(scores.astype(np.float64) - scores.max(-1, keepdims=True))
    upto = shares.cumsum(-1)
    drawn = (upto <= draws[:, None].astype(np.float64) * upto[:, -1:]).sum(-1)
    return np.where(draws < 0, best, drawn.clip(max=scores.shape[1] - 1))


def weigh_answers(
    model: QwenNumpy,
    layout: PromptLayout,
    ids: I64,
    pictures: Sequence[U8],
    slots: Sequence[I64 | int],
    answers: I64,
) -> dict[int, NDArray[np.float64]]:
    """How probable the model held each choice of answers int64 [B, slots].

    Args:
        model: answered.
        layout: of all prompts.
        ids: int64 [B, P], prompts.
        pictures: of each picture of the layout uint8 [B, H, W, 3].
        slots: ids that each token may have.
        answers: what was said.

    Returns:
        by slot with a choice: float64 [B, ids of the slot], at temperature 1, among the slot's ids.

    Raises:
        CheckpointError: pictures or ids do not fit the layout.
    """
    found = {}
    for k, _, scores in _score_slots(model, layout, ids, pictures, slots, answers.copy()):
        shares = np.exp(scores.astype(np.float64) - scores.max(-1, keepdims=True))
        found[k] = shares / shares.sum(-1, keepdims=True)
    return found


def _score_slots(
    model: QwenNumpy,
    layout: PromptLayout,
    ids: I64,
    pictures: Sequence[U8],
    slots: Sequence[I64 | int],
    out: I64,
) -> Iterator[tuple[int, I64, F32]]:
    """Slots with a choice in turn, with their ids and the scores [B, ids] of these.

    Answers `out` are read on as they then stand; slots of one id are filled in.
    """
    features = encode_pictures(model, layout, pictures)
    cache = model.read(layout, ids, features, room=len(slots))
    where = layout.positions_behind(len(slots))
    read = 0  # tokens of the answer that the cache holds
    for k, allowed in enumerate(slots):
        if isinstance(allowed, int):
            out[:, k] = ids[:, allowed]
            continue
        if len(allowed) == 1:
            out[:, k] = allowed[0]
            continue
        if read < k:
            model.add(cache, out[:, read:k], where[:, read:k])
            read = k
        yield k, allowed, model.score(cache, allowed)


def check_shapes(architecture: Architecture, weights: Weights) -> None:
    """Refuse weights that are not those of the architecture.

    Raises:
        CheckpointError: one is missing or has another shape; it is named.
    """
    for name, shape in list_shapes(architecture).items():
        if name not in weights:
            raise CheckpointError(
                f"weights {name} are missing", remedy="copy the whole folder, with all its shards"
            )
        if weights.shape_of(name) != shape:
            what = f"weights {name} have shape {weights.shape_of(name)}, config.json says {shape}"
            raise CheckpointError(what)


def list_shapes(architecture: Architecture) -> dict[str, tuple[int, ...]]:
    """Name and shape of all weights that the model needs."""
    text, vision = architecture.text, architecture.vision
    shapes: dict[str, tuple[int, ...]] = {}

    def linear(name: str, out: int, into: int, bias: bool = True) -> None:
        shapes[f"{name}.weight"] = (out, into)
        if bias:
            shapes[f"{name}.bias"] = (out,)

    def norm(name: str, size: int) -> None:
        shapes[f"{name}.weight"] = shapes[f"{name}.bias"] = (size,)

    top = "model.visual."
    shapes[f"{top}patch_embed.proj.weight"] = (
        vision.hidden, 3, vision.temporal, vision.patch, vision.patch,
    )  # fmt: skip
    shapes[f"{top}patch_embed.proj.bias"] = (vision.hidden,)
    shapes[f"{top}pos_embed.weight"] = (vision.positions, vision.hidden)
    for k in range(vision.layers):
        norm(f"{top}blocks.{k}.norm1", vision.hidden)
        norm(f"{top}blocks.{k}.norm2", vision.hidden)
        linear(f"{top}blocks.{k}.attn.qkv", 3 * vision.hidden, vision.hidden)
        linear(f"{top}blocks.{k}.attn.proj", vision.hidden, vision.hidden)
        linear(f"{top}blocks.{k}.mlp.linear_fc1", vision.intermediate, vision.hidden)
        linear(f"{top}blocks.{k}.mlp.linear_fc2", vision.hidden, vision.intermediate)
    merged = vision.hidden * vision.merge**2
    levels = [f"deepstack_merger_list.{k}" for k in range(len(vision.deepstack))]
    for name in ("merger", *levels):
        norm(f"{top}{name}.norm", vision.hidden if name == "merger" else merged)
        linear(f"{top}{name}.linear_fc1", merged, merged)
        linear(f"{top}{name}.linear_fc2", vision.out, merged)
    top = "model.language_model."
    shapes[f"{top}embed_tokens.weight"] = (text.vocabulary, text.hidden)
    shapes[f"{top}norm.weight"] = (text.hidden,)
    for k in range(text.layers):
        layer = f"{top}layers.{k}."
        for name in ("input_layernorm", "post_attention_layernorm"):
            shapes[f"{layer}{name}.weight"] = (text.hidden,)
        for name, heads in (("q", text.heads), ("k", text.kv_heads), ("v", text.kv_heads)):
            linear(f"{layer}self_attn.{name}_proj", heads * text.head_dim, text.hidden, bias=False)
        linear(f"{layer}self_attn.o_proj", text.hidden, text.heads * text.head_dim, bias=False)
        for name in ("q_norm", "k_norm"):
            shapes[f"{layer}self_attn.{name}.weight"] = (text.head_dim,)
        linear(f"{layer}mlp.gate_proj", text.intermediate, text.hidden, bias=False)
        linear(f"{layer}mlp.up_proj", text.intermediate, text.hidden, bias=False)
        linear(f"{layer}mlp.down_proj", text.hidden, text.intermediate, bias=False)
    if not text.tied:
        shapes["lm_head.weight"] = (text.vocabulary, text.hidden)
    return shapes
