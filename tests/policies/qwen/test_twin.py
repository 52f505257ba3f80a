"""Qwen3-VL without torch computes what stock transformers does."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gn0.errors import CheckpointError
from gn0.policies.qwen.layout import PictureSize, build_layout
from gn0.policies.qwen.model import (
    QwenNumpy,
    answer_prompts,
    encode_pictures,
    load_numpy_model,
    pick_token,
)
from gn0_trials.random_qwen import build_random_checkpoint, draw_prompt

STOCK = json.loads(Path(__file__).with_name("stock.json").read_text("utf-8"))
ANSWER = (7, 70, 33)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> QwenNumpy:
    return load_numpy_model(build_random_checkpoint(tmp_path_factory.mktemp("qwen")))


def prompt(model: QwenNumpy, batch: int = 2):
    parts, text, pictures = draw_prompt(batch=batch)
    layout = build_layout(model.architecture, parts)
    ids = np.tile(layout.ids, (len(text), 1))
    ids[:, -6:-1] = text
    return layout, ids, pictures


def test_positions_are_those_of_transformers(model: QwenNumpy) -> None:
    layout, _, _ = prompt(model)
    behind = layout.positions_behind(len(ANSWER))
    assert np.concatenate([layout.positions, behind], 1).tolist() == STOCK["positions"]


def test_logits_are_those_of_transformers(model: QwenNumpy) -> None:
    layout, ids, pictures = prompt(model)
    cache = model.read(layout, ids, encode_pictures(model, layout, pictures), room=len(ANSWER))
    scores = [model.score(cache)]
    where = layout.positions_behind(len(ANSWER))
    for k, token in enumerate(ANSWER):
        model.add(cache, np.full((len(ids), 1), token), where[:, k : k + 1])
        scores.append(model.score(cache))
    got = np.stack(scores, 1)
    np.testing.assert_allclose(got[..., ::9], STOCK["logits"], rtol=0, atol=1e-5)
    assert got.argmax(-1).tolist() == STOCK["best"]


def test_several_tokens_at_once_are_read_as_one_by_one(model: QwenNumpy) -> None:
    layout, ids, pictures = prompt(model)
    features = encode_pictures(model, layout, pictures)
    where, answer = layout.positions_behind(3), np.tile(ANSWER, (len(ids), 1))
    once = model.read(layout, ids, features, room=3)
    model.add(once, answer, where)
    single = model.read(layout, ids, features, room=3)
    for k in range(3):
        model.add(single, answer[:, k : k + 1], where[:, k : k + 1])
    np.testing.assert_allclose(once.last, single.last, atol=1e-5)


def test_an_answer_is_out_of_its_slots_and_the_most_probable(model: QwenNumpy) -> None:
    layout, ids, pictures = prompt(model)
    slots = [np.arange(10, 40), np.array([77]), np.array([5]), np.arange(50, 54), np.array([2])]
    got = answer_prompts(model, layout, ids, pictures, slots)
    assert got[:, [1, 2, 4]].tolist() == [[77, 5, 2]] * 2
    for k in (0, 3):  # by a prompt that holds all that came before
        cache = model.read(layout, ids, encode_pictures(model, layout, pictures), room=5)
        if k:
            model.add(cache, got[:, :k], layout.positions_behind(k))
        assert (slots[k][model.score(cache)[:, slots[k]].argmax(-1)] == got[:, k]).all()


def test_tokens_are_drawn_as_probable_as_they_are() -> None:
    scores = np.array([[0.0, 2.0, -1.0, 2.0]] * 1000, np.float32)
    even = np.float32((np.arange(1000) + 0.5) / 1000)
    drawn = np.bincount(pick_token(scores, even), minlength=4) / 1000
    np.testing.assert_allclose(drawn, np.exp(scores[0]) / np.exp(scores[0]).sum(), atol=1.1e-3)
    assert set(pick_token(scores, None)) == set(pick_token(scores, even - 1)) == {1}
    low, high = np.float32([0.0] * 1000), np.nextafter(np.float32([1.0] * 1000), np.float32(0))
    assert set(pick_token(scores, low)) == {0} and set(pick_token(scores, high)) == {3}


def test_neighbours_in_a_batch_change_no_answer(model: QwenNumpy) -> None:
    layout, ids, pictures = prompt(model, batch=5)
    slots = [np.arange(128)] * 4
    together = answer_prompts(model, layout, ids, pictures, slots)
    for row in range(5):
        one = [some[row : row + 1] for some in pictures]
        alone = answer_prompts(model, layout, ids[row : row + 1], one, slots)
        assert (alone == together[row]).all()


def test_pictures_and_ids_must_fit_the_layout(model: QwenNumpy) -> None:
    layout, ids, pictures = prompt(model)
    with pytest.raises(CheckpointError, match="pictures have shapes"):
        answer_prompts(model, layout, ids, pictures[:1], [np.arange(4)])
    with pytest.raises(CheckpointError, match="uint8"):
        floats = [some.astype(np.float32) for some in pictures]
        answer_prompts(model, layout, ids, floats, [np.arange(4)])
    with pytest.raises(CheckpointError, match="not \\[prompts, "):
        answer_prompts(model, layout, ids[:, 1:], pictures, [np.arange(4)])
    with pytest.raises(CheckpointError, match="outside the vocabulary"):
        answer_prompts(model, layout, ids + 100, pictures, [np.arange(4)])
    with pytest.raises(CheckpointError, match="not a multiple of 8 px"):
        build_layout(model.architecture, [PictureSize(20, 16)])
    with pytest.raises(CheckpointError, match="token 128 lies outside"):
        build_layout(model.architecture, [128])
