"""Small Qwen3-VL checkpoints of random weights, written without torch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.policies.qwen.architecture import parse_architecture
from gn0.policies.qwen.model import list_shapes
from gn0.seeds import random_stream

IMAGE, START, END, VISION_START, VISION_END, VOCABULARY = 90, 91, 92, 93, 94, 128


def list_config(**changes: Any) -> dict[str, Any]:
    """config.json of a model of 60,000 weights, as transformers 5 writes it."""
    text = {
        "model_type": "qwen3_vl_text", "vocab_size": VOCABULARY, "hidden_size": 32,
        "intermediate_size": 48, "num_hidden_layers": 3, "num_attention_heads": 4,
        "num_key_value_heads": 2, "head_dim": 16, "hidden_act": "silu", "attention_bias": False,
        "max_position_embeddings": 512, "rms_norm_eps": 1e-6, "tie_word_embeddings": True,
        "rope_parameters": {
            "rope_type": "default", "rope_theta": 10000.0, "mrope_interleaved": True,
            "mrope_section": [4, 2, 2],
        },
    }  # fmt: skip
    vision = {
        "model_type": "qwen3_vl_vision", "depth": 3, "hidden_size": 24, "num_heads": 2,
        "intermediate_size": 40, "hidden_act": "gelu_pytorch_tanh", "patch_size": 4,
        "spatial_merge_size": 2, "temporal_patch_size": 2, "in_channels": 3, "out_hidden_size": 32,
        "num_position_embeddings": 36, "deepstack_visual_indexes": [0, 2],
    }  # fmt: skip
    return {
        "model_type": "qwen3_vl", "architectures": ["Qwen3VLForConditionalGeneration"],
        "text_config": text, "vision_config": vision, "image_token_id": IMAGE,
        "video_token_id": 95, "vision_start_token_id": VISION_START,
        "vision_end_token_id": VISION_END, "tie_word_embeddings": True,
    } | changes  # fmt: skip


def write_safetensors(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write float32 arrays as the format's page has it."""
    header: dict[str, Any] = {}
    at = 0
    for name, array in arrays.items():
        span = [at, at + array.nbytes]
        header[name] = {"dtype": "F32", "shape": list(array.shape), "data_offsets": span}
        at = span[1]
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    with path.open("wb") as file:
        file.write(len(text).to_bytes(8, "little") + text)
        for array in arrays.values():
            file.write(np.ascontiguousarray(array, "<f4").tobytes())


def random_weights(config: Mapping[str, Any], seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """Weights of a configuration: norms about 1, all else about 0."""
    found = {}
    for name, shape in list_shapes(parse_architecture(config)).items():
        drawn = random_stream(seed, "random qwen", name).normal(0, 0.15, shape)
        about = 1.0 if "norm" in name and name.endswith("weight") else 0.0
        found[name] = (about + drawn).astype(np.float32)
    return found


def build_random_checkpoint(folder: Path, seed: int = 0, **changes: Any) -> Path:
    """Write config.json and model.safetensors; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    config = list_config(**changes)
    (folder / "config.json").write_text(json.dumps(config), "utf-8")
    write_safetensors(folder / "model.safetensors", random_weights(config, seed))
    return folder


def draw_prompt(seed: int = 0, batch: int = 2) -> tuple[list[Any], NDArray[Any], list[Any]]:
    """A prompt of two pictures: parts of its layout, ids of its text [B, 5], pictures uint8."""
    from gn0.policies.qwen.layout import PictureSize

    stream = random_stream(seed, "prompt")
    sizes = [PictureSize(16, 16), PictureSize(24, 16)]
    parts: list[Any] = [START]
    for size in sizes:
        parts += [VISION_START, size, VISION_END]
    parts += [1, 2, 3, 4, 5, END]
    text = stream.integers(0, 80, (batch, 5))
    pictures = [
        stream.integers(0, 256, (batch, size.height, size.width, 3), dtype=np.uint8)
        for size in sizes
    ]
    return parts, text, pictures
