"""Checkpoints that are not whole, forged or of another kind are refused, and say why."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from gn0.errors import CheckpointError, Gn0Error
from gn0.policies.qwen.architecture import load_architecture, parse_architecture
from gn0.policies.qwen.model import load_numpy_model
from gn0.policies.qwen.weights import open_weights
from gn0_trials.random_qwen import build_random_checkpoint, list_config, write_safetensors


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return build_random_checkpoint(tmp_path / "model")


def refused(folder: Path, message: str) -> None:
    with pytest.raises(CheckpointError, match=message) as caught:
        load_numpy_model(folder)
    assert "Traceback" not in str(caught.value)


def test_a_folder_without_a_model(tmp_path: Path) -> None:
    refused(tmp_path, "no model configuration.*config.json and the safetensors")


@pytest.mark.parametrize("text", ["", "{", "[]", "[" * 100_000, '{"model_type": "llama"}', "null"])
def test_a_configuration_of_nothing_we_know(folder: Path, text: str) -> None:
    (folder / "config.json").write_text(text)
    refused(folder, "config.json: ")


@pytest.mark.parametrize(
    ("part", "field", "value", "message"),
    [
        ("text_config", "hidden_size", None, "text_config.hidden_size"),
        ("text_config", "hidden_size", 32.5, "a positive whole number"),
        ("text_config", "head_dim", 0, "a positive whole number"),
        ("text_config", "hidden_act", "gelu", "'silu', the only one"),
        ("text_config", "num_key_value_heads", 3, "evenly"),
        ("text_config", "num_hidden_layers", 1, "more deepstack levels"),
        ("vision_config", "out_hidden_size", 16, "not the language model's hidden_size"),
        ("vision_config", "num_position_embeddings", 35, "not square"),
        ("vision_config", "deepstack_visual_indexes", [0, 9], "a missing layer"),
        ("vision_config", "deepstack_visual_indexes", "0", "some whole numbers"),
        (None, "image_token_id", 128, "outside the vocabulary"),
        (None, "vision_config", [], "vision_config is not a table"),
        ("text_config", "hidden_size", 64, "config.json says|not the language model's"),
    ],
)
def test_a_field_that_is_wrong_is_named(part, field: str, value, message: str) -> None:
    config = list_config()
    (config[part] if part else config)[field] = value
    with pytest.raises(CheckpointError, match=message):
        parse_architecture(config)


def test_the_released_models_spell_rotary_settings_in_another_way() -> None:
    config = list_config()
    text = config["text_config"]
    rope = text.pop("rope_parameters")
    text["rope_theta"] = 5_000_000
    rope.pop("rope_theta")
    text["rope_scaling"] = rope
    assert parse_architecture(config).text.theta == 5e6


def test_pickles_are_refused_by_name(folder: Path) -> None:
    (folder / "model.safetensors").rename(folder / "pytorch_model.bin")
    refused(folder, "pytorch_model.bin is a pickle.*save_pretrained")


def test_a_missing_shard_is_named(folder: Path) -> None:
    whole = dict(open_weights(folder))
    names = list(whole)
    for k, part in enumerate((names[::2], names[1::2])):
        write_safetensors(folder / f"{k}.safetensors", {name: whole[name] for name in part})
    (folder / "model.safetensors").unlink()
    index = {"weight_map": {n: f"{k % 2}.safetensors" for k, n in enumerate(names)}}
    (folder / "model.safetensors.index.json").write_text(json.dumps(index))
    load_numpy_model(folder)
    (folder / "1.safetensors").unlink()
    refused(folder, "1 of 2 shards are missing, the first is 1.safetensors")


@pytest.mark.parametrize("name", ["../m.safetensors", "/etc/passwd", "a/b.safetensors", "x.bin"])
def test_shards_outside_the_folder_are_not_read(folder: Path, name: str) -> None:
    index = {"weight_map": {"a": name}}
    (folder / "model.safetensors.index.json").write_text(json.dumps(index))
    refused(folder, "is not a file in its folder")


def test_a_shard_of_another_hash(folder: Path) -> None:
    path = folder / "model.safetensors"
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    (folder / "shards.json").write_text(json.dumps({path.name: digest}))
    load_numpy_model(folder)
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    refused(folder, "its hash is not the one that shards.json states")


def test_weights_of_another_model(folder: Path) -> None:
    whole = dict(open_weights(folder))
    name = next(iter(whole))
    write_safetensors(folder / "model.safetensors", {k: v for k, v in whole.items() if k != name})
    refused(folder, f"weights {re.escape(name)} are missing")
    write_safetensors(folder / "model.safetensors", whole | {name: np.zeros((1, 2), np.float32)})
    refused(folder, r"have shape \(1, 2\), config.json says")


def test_bfloat16_and_float16_are_read(folder: Path, tmp_path: Path) -> None:
    values = np.array([1.5, -2.25, 3.0, 1e-3], np.float32)
    for kind, data in (
        ("F16", values.astype("<f2")),
        ("BF16", (values.view(np.uint32) >> 16).astype("<u2")),
    ):
        entry = {"a": {"dtype": kind, "shape": [2, 2], "data_offsets": [0, 8]}}
        text = json.dumps(entry).encode()
        blob = len(text).to_bytes(8, "little") + text + data.tobytes()
        (tmp_path / "model.safetensors").write_bytes(blob)
        got = open_weights(tmp_path)["a"]
        assert got.dtype == np.float32
        np.testing.assert_allclose(got.ravel(), values, rtol=2**-8)


HEADER = {"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}}


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    header=st.one_of(
        st.binary(max_size=40),
        st.recursive(
            st.none() | st.integers() | st.text(max_size=5),
            lambda more: st.lists(more, max_size=3) | st.dictionaries(st.text(max_size=8), more),
            max_leaves=8,
        ).map(lambda value: json.dumps({"a": value}).encode()),
    ),
    length=st.none() | st.integers(0, 2**64 - 1),
    data=st.binary(max_size=16),
)
@example(json.dumps(HEADER).encode(), None, b"1234567")
@example(json.dumps({"a": HEADER["a"] | {"data_offsets": [8, 0]}}).encode(), None, b"12345678")
@example(json.dumps({"a": HEADER["a"] | {"shape": [1 << 39, 1 << 39]}}).encode(), None, b"")
@example(b"", 0, b"")
def test_no_bytes_break_the_reader(tmp_path: Path, header: bytes, length, data: bytes) -> None:
    size = len(header) if length is None else length
    blob = size.to_bytes(8, "little") + header + data
    (tmp_path / "model.safetensors").write_bytes(blob)
    try:
        for array in open_weights(tmp_path).values():
            assert array.nbytes <= 2 * len(data)
    except Gn0Error as error:
        assert error.code == "CHECKPOINT"


def test_an_empty_or_a_cut_file(folder: Path) -> None:
    path = folder / "model.safetensors"
    data = path.read_bytes()
    path.write_bytes(b"")
    refused(folder, "cannot be read")
    path.write_bytes(data[:-4])
    refused(folder, "bytes are stated to lie at.*copy it again")


def test_the_shapes_say_what_a_model_is(folder: Path) -> None:
    found = load_architecture(folder)
    assert found.vision.token == 8
    assert found.text.sections == (4, 2, 2)
    assert found.text.tied
