"""Qwen3-VL from random weights, in sizes that a card or a laptop trains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import torch
from transformers import Qwen3VLConfig, Qwen3VLForConditionalGeneration

from gn0.errors import ConfigError
from gn0.paper import MAP_BINS
from gn0.policies.bae.tokens import TokenIds

_THETA = 10_000.0  # for hundreds of tokens; 5,000,000 of the released models is for thousands


@dataclass(frozen=True)
class ModelSize:
    """A geometry to train from scratch.

    Attributes:
        hidden, layers, heads, kv_heads, head_dim, intermediate: of the language model.
        vision_hidden, vision_layers, vision_heads, vision_intermediate: of the vision tower.
        deepstack: its layers whose features the language model's first layers are given.
        patch: side of a patch [px]; four patches are a token.
        positions: entries of its square table of positions.
    """

    hidden: int
    layers: int
    heads: int
    kv_heads: int
    head_dim: int
    intermediate: int
    vision_hidden: int
    vision_layers: int
    vision_heads: int
    vision_intermediate: int
    deepstack: tuple[int, ...]
    patch: int = 8
    positions: int = 576


SIZES: Mapping[str, ModelSize] = MappingProxyType(
    {
        "nano": ModelSize(128, 4, 4, 2, 32, 384, 96, 3, 4, 288, (0, 1)),
        "tiny": ModelSize(384, 6, 6, 2, 64, 1024, 256, 4, 4, 768, (1, 2)),
    }
)


def list_config(size: ModelSize, tokens: TokenIds) -> dict[str, Any]:
    """The config.json of a size with a tokenizer's ids, as `Qwen3VLConfig` takes it."""
    half = size.head_dim // 2
    third = half // 3
    return {
        "text_config": {
            "vocab_size": tokens.vocabulary.rows,
            "hidden_size": size.hidden,
            "intermediate_size": size.intermediate,
            "num_hidden_layers": size.layers,
            "num_attention_heads": size.heads,
            "num_key_value_heads": size.kv_heads,
            "head_dim": size.head_dim,
            "max_position_embeddings": 8192,
            "pad_token_id": tokens.pad,
            "bos_token_id": None,
            "eos_token_id": tokens.end,
            "tie_word_embeddings": True,
            "rope_parameters": {
                "rope_type": "default",
                "rope_theta": _THETA,
                "mrope_interleaved": True,
                "mrope_section": [half - 2 * third, third, third],
            },
        },
        "vision_config": {
            "depth": size.vision_layers,
            "hidden_size": size.vision_hidden,
            "intermediate_size": size.vision_intermediate,
            "num_heads": size.vision_heads,
            "patch_size": size.patch,
            "spatial_merge_size": 2,
            "temporal_patch_size": 2,
            "out_hidden_size": size.hidden,
            "num_position_embeddings": size.positions,
            "deepstack_visual_indexes": list(size.deepstack),
        },
        "image_token_id": tokens.image,
        "video_token_id": tokens.video,
        "vision_start_token_id": tokens.vision_start,
        "vision_end_token_id": tokens.vision_end,
        "tie_word_embeddings": True,
    }


def build_model(size: str, tokens: TokenIds, seed: int = 0) -> Qwen3VLForConditionalGeneration:
    """A model of random weights; the rows of <0> to <999> begin as points of a line.

    Neighbouring bins begin with like rows (sines and cosines of 0.5 to 60 periods over the map), so
    that the order of the bins need not be learned.

    Args:
        size: a key of `SIZES`.
        tokens: ids of the tokenizer.
        seed: of the weights.

    Raises:
        ConfigError: no such size.
    """
    if size not in SIZES:
        raise ConfigError(f"no size {size!r}", remedy=f"choose one of {', '.join(SIZES)}")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = Qwen3VLForConditionalGeneration(Qwen3VLConfig(**list_config(SIZES[size], tokens)))
        with torch.no_grad():
            rows = model.get_input_embeddings().weight
            first = tokens.vocabulary.number
            rows[first : first + MAP_BINS] = _bins_on_a_line(rows.shape[1])
    return model.eval()


def _bins_on_a_line(hidden: int) -> torch.Tensor:
    at = torch.arange(MAP_BINS)[:, None] / MAP_BINS
    periods = torch.logspace(math.log10(0.5), math.log10(60), 32)[None]
    waves = torch.cat([(2 * math.pi * periods * at).sin(), (2 * math.pi * periods * at).cos()], 1)
    waves = waves / periods.repeat(1, 2).sqrt()
    mixed = waves / waves.std() @ (torch.randn(64, hidden) / 8)
    return 0.02 * mixed + 0.002 * torch.randn(MAP_BINS, hidden)
