"""Shapes of a Qwen3-VL model, as its config.json states them, and sizes to train from scratch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gn0.errors import CheckpointError, brief

LARGEST_CONFIG = 1 << 20  # bytes of a config.json; real ones have 2 kB


@dataclass(frozen=True)
class TextShape:
    """The language model: a decoder with grouped queries and rotary positions in three axes.

    Attributes:
        vocabulary: rows of the embedding, padding included.
        hidden, layers, heads, kv_heads, head_dim, intermediate: sizes.
        eps: of the RMS norms.
        theta: base of the rotary frequencies.
        sections: how many frequencies go by time, height and width; interleaved.
        tied: the embedding is also the output's matrix.
    """

    vocabulary: int
    hidden: int
    layers: int
    heads: int
    kv_heads: int
    head_dim: int
    intermediate: int
    eps: float
    theta: float
    sections: tuple[int, int, int]
    tied: bool


@dataclass(frozen=True)
class VisionShape:
    """The vision tower: a transformer over patches, merged 2×2, with features of several depths.

    Attributes:
        hidden, layers, heads, intermediate: sizes.
        patch: side of a patch [px].
        merge: patches of a token's side.
        temporal: frames of a patch; a picture is repeated that often.
        out: size of what the language model is given.
        positions: entries of the learned square table of positions.
        deepstack: layers whose features are added to the first layers of the language model.
        theta: base of the rotary frequencies.
    """

    hidden: int
    layers: int
    heads: int
    intermediate: int
    patch: int
    merge: int
    temporal: int
    out: int
    positions: int
    deepstack: tuple[int, ...]
    theta: float = 10_000.0

    @property
    def token(self) -> int:
        """Side of the square [px] that becomes one token."""
        return self.patch * self.merge


@dataclass(frozen=True)
class Architecture:
    """A Qwen3-VL model without its weights.

    Attributes:
        text, vision: the two parts.
        image: id of the token that stands for a token of a picture.
    """

    text: TextShape
    vision: VisionShape
    image: int


def load_architecture(folder: Path) -> Architecture:
    """Read the config.json of a Hugging Face folder.

    Raises:
        CheckpointError: none is there, it is no JSON, or not of a Qwen3-VL that we can run.
    """
    path = folder / "config.json"
    try:
        if path.stat().st_size > LARGEST_CONFIG:
            raise CheckpointError("larger than any configuration", where=path)
        config = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise CheckpointError(
            f"no model configuration: {error.strerror or error}",
            where=path,
            remedy="name the folder that holds config.json and the safetensors files",
        ) from None
    except (ValueError, RecursionError):
        raise CheckpointError("not JSON", where=path) from None
    return parse_architecture(config, path)


def parse_architecture(config: Any, where: str | Path = "config.json") -> Architecture:
    """Shapes from a configuration of transformers 4.57 or 5 (`Qwen3VLConfig`).

    Raises:
        CheckpointError: another architecture, a field missing or of the wrong type, or an option
            that this code does not compute.
    """
    fields = _Fields(config, where)
    fields.expect("model_type", "qwen3_vl")
    text, vision = fields.below("text_config"), fields.below("vision_config")
    text.expect("hidden_act", "silu")
    text.expect("attention_bias", False)
    vision.expect("hidden_act", "gelu_pytorch_tanh")
    rope = text.either("rope_parameters", "rope_scaling")
    rope.expect("rope_type", "default")
    rope.expect("mrope_interleaved", True)
    heads = text.count("num_attention_heads")
    theta = (rope if "rope_theta" in rope.table else text).number("rope_theta")
    axial = vision.table.get("rope_parameters")
    shape = TextShape(
        vocabulary=text.count("vocab_size"),
        hidden=text.count("hidden_size"),
        layers=text.count("num_hidden_layers"),
        heads=heads,
        kv_heads=text.count("num_key_value_heads"),
        head_dim=text.count("head_dim"),
        intermediate=text.count("intermediate_size"),
        eps=text.number("rms_norm_eps"),
        theta=theta,
        sections=rope.counts("mrope_section", 3),  # type: ignore[arg-type]
        tied=bool(fields.table.get("tie_word_embeddings", False)),
    )
    tower = VisionShape(
        hidden=vision.count("hidden_size"),
        layers=vision.count("depth"),
        heads=vision.count("num_heads"),
        intermediate=vision.count("intermediate_size"),
        patch=vision.count("patch_size"),
        merge=vision.count("spatial_merge_size"),
        temporal=vision.count("temporal_patch_size"),
        out=vision.count("out_hidden_size"),
        positions=vision.count("num_position_embeddings"),
        deepstack=vision.counts("deepstack_visual_indexes", None, least=0),
        theta=_Fields(axial, where, "vision_config.rope_parameters.").number("rope_theta")
        if axial is not None
        else 10_000.0,
    )
    found = Architecture(shape, tower, fields.count("image_token_id"))
    _check(found, where)
    return found


def _check(found: Architecture, where: str | Path) -> None:
    text, vision = found.text, found.vision
    faults = (
        (text.heads % text.kv_heads, "heads cannot share the key-value heads evenly"),
        (text.head_dim % 2, "head_dim is odd"),
        (sum(text.sections) != text.head_dim // 2, "mrope_section is not half of head_dim"),
        (vision.hidden % (4 * vision.heads), "a vision head's size is not a multiple of four"),
        (vision.out != text.hidden, "out_hidden_size is not the language model's hidden_size"),
        (round(vision.positions**0.5) ** 2 != vision.positions, "the position table is not square"),
        (len(vision.deepstack) > text.layers, "more deepstack levels than language layers"),
        (any(k >= vision.layers for k in vision.deepstack), "deepstack names a missing layer"),
        (found.image >= text.vocabulary, "image_token_id lies outside the vocabulary"),
    )
    for bad, what in faults:
        if bad:
            raise CheckpointError(what, where=where)


@dataclass(frozen=True)
class _Fields:
    """A table of a configuration, read strictly."""

    table: Any
    where: str | Path
    path: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.table, Mapping):
            name = self.path.rstrip(".") or "the file"
            raise CheckpointError(f"{name} is not a table", where=self.where)

    def _fail(self, name: str, wanted: str) -> CheckpointError:
        got = brief(self.table[name]) if name in self.table else "missing"
        return CheckpointError(f"{self.path}{name} is {got}, not {wanted}", where=self.where)

    def below(self, name: str) -> _Fields:
        return _Fields(self.table.get(name), self.where, f"{self.path}{name}.")

    def either(self, *names: str) -> _Fields:
        for name in names:
            if self.table.get(name) is not None:
                return self.below(name)
        return self.below(names[0])

    def expect(self, name: str, value: Any) -> None:
        if self.table.get(name) != value:
            raise self._fail(name, f"{value!r}, the only one that is computed here")

    def number(self, name: str) -> float:
        value = self.table.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e12:
            raise self._fail(name, "a positive number")
        return float(value)

    def count(self, name: str) -> int:
        value = self.table.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 < value < 1 << 31:
            raise self._fail(name, "a positive whole number")
        return value

    def counts(self, name: str, size: int | None, least: int = 1) -> tuple[int, ...]:
        value = self.table.get(name)
        good = isinstance(value, list | tuple) and size in (None, len(value))
        if not good or not all(type(one) is int and least <= one < 1 << 31 for one in value):
            raise self._fail(name, f"{size or 'some'} whole numbers")
        return tuple(value)
