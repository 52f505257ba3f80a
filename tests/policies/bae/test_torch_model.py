"""The torch model: stock transformers' numbers, checkpoints it can load, and the twin's answers."""

from __future__ import annotations

import copy
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

os.environ.setdefault("HF_HUB_OFFLINE", "1")
torch = pytest.importorskip("torch", reason="the policy's model needs gn0[train]")
transformers = pytest.importorskip("transformers", reason="the policy's model needs gn0[train]")

from PIL import Image  # noqa: E402

from gn0.data.codec import NAVIGATION_TOKENS  # noqa: E402
from gn0.errors import CheckpointError, ConfigError, DataError  # noqa: E402
from gn0.policies.bae.checkpoint import Checkpoint, load_checkpoint, save_checkpoint  # noqa: E402
from gn0.policies.bae.forward import ForwardConstant  # noqa: E402
from gn0.policies.bae.processor import ProcessorPictures, build_processor  # noqa: E402
from gn0.policies.bae.sizes import SIZES, build_model  # noqa: E402
from gn0.policies.bae.tokenizer import read_token_ids, train_tokenizer  # noqa: E402
from gn0.policies.qwen.architecture import load_architecture, parse_architecture  # noqa: E402
from gn0.policies.qwen.layout import PictureSize, build_layout  # noqa: E402
from gn0.policies.qwen.model import answer_prompts, load_numpy_model  # noqa: E402
from gn0_trials.random_qwen import build_random_checkpoint  # noqa: E402

WORDS = ["go to the red sofa", "turn left at the door and stop by the bed", "find the lamp"]
FREE = np.arange(1000)


@pytest.fixture(scope="module")
def tokenizer():
    return train_tokenizer(WORDS)


@pytest.fixture(scope="module")
def nano(tokenizer, tmp_path_factory: pytest.TempPathFactory) -> tuple[Checkpoint, Path]:
    ids = read_token_ids(tokenizer)
    model = build_model("nano", ids)
    with torch.no_grad(), torch.random.fork_rng(devices=[]):  # of some size, as if trained
        torch.manual_seed(1)
        for weight in model.parameters():
            weight.add_(0.05 * torch.randn_like(weight))
    made = Checkpoint(model, tokenizer, ids)
    folder = tmp_path_factory.mktemp("nano") / "checkpoint"
    save_checkpoint(folder, made, shard_mb=3, dtype=torch.float32)
    return made, folder


def prompts(checkpoint: Checkpoint, batch: int, seed: int = 0):
    """Layout, ids and pictures of prompts with two pictures and eight words."""
    ids, stream = checkpoint.ids, np.random.default_rng(seed)
    parts = [ids.start]
    for size in (PictureSize(32, 32), PictureSize(48, 32)):
        parts += [ids.vision_start, size, ids.vision_end]
    architecture = parse_architecture(checkpoint.model.config.to_dict())
    layout = build_layout(architecture, [*parts, *[0] * 8, ids.end])
    rows = np.tile(layout.ids, (batch, 1))
    rows[:, -9:-1] = stream.integers(0, 250, (batch, 8))
    pictures = [
        stream.integers(0, 256, (batch, size.height, size.width, 3), dtype=np.uint8)
        for size in layout.sizes
    ]
    return layout, rows, pictures


def stock_logits(checkpoint: Checkpoint, ids, pictures, grad: bool = False):
    """What transformers' own forward says of whole sequences int64 [B, L]."""
    patch = checkpoint.model.config.vision_config.patch_size
    processor = build_processor(checkpoint.tokenizer, patch)
    flat = [Image.fromarray(some[row]) for row in range(len(ids)) for some in pictures]
    seen = processor.image_processor(images=flat, return_tensors="pt")
    full = torch.as_tensor(ids)
    checkpoint.model.model.rope_deltas = None
    with torch.set_grad_enabled(grad):
        return checkpoint.model(
            input_ids=full,
            pixel_values=seen["pixel_values"],
            image_grid_thw=seen["image_grid_thw"],
            mm_token_type_ids=(full == checkpoint.ids.image).int(),
            attention_mask=torch.ones_like(full),
        ).logits


@pytest.mark.parametrize("checkpointed", [False, True])
def test_logits_and_gradients_are_those_of_transformers(nano, checkpointed: bool) -> None:
    made, _ = nano
    layout, ids, pictures = prompts(made, 3)
    answer = np.random.default_rng(2).integers(0, made.ids.vocabulary.size, (3, 7))
    ours = ForwardConstant(made.model, layout, 7, checkpointed=checkpointed)
    names = ("model.visual.patch_embed.proj.weight", "model.language_model.embed_tokens.weight",
             "model.language_model.layers.1.self_attn.q_proj.weight")  # fmt: skip
    weights = dict(made.model.named_parameters())
    grads, values = [], []
    for own in (True, False):
        made.model.zero_grad()
        if own:
            features = ours.encode([torch.from_numpy(some) for some in pictures])
            logits = ours.logits(features, torch.from_numpy(ids), torch.from_numpy(answer))
        else:
            whole = stock_logits(made, np.concatenate([ids, answer], 1), pictures, grad=True)
            logits = whole[:, len(layout) - 1 : -1]
        torch.nn.functional.cross_entropy(
            logits.flatten(0, 1), torch.from_numpy(answer).flatten()
        ).backward()
        values.append(logits.detach())
        grads.append([weights[name].grad.clone() for name in names])
    assert (values[0] - values[1]).abs().max() <= 1e-5
    for mine, theirs in zip(*grads, strict=True):
        assert (mine - theirs).abs().max() <= 1e-5 * max(1.0, float(theirs.abs().max()))


@pytest.mark.slow
def test_256_greedy_answers_are_those_of_transformers(nano) -> None:
    made, _ = nano
    layout, ids, pictures = prompts(made, 256)
    slots = [made.ids.vocabulary.number + FREE] * 4 + [np.array([made.ids.end])]
    ours = ForwardConstant(made.model, layout, len(slots))
    features = ours.encode([torch.from_numpy(some) for some in pictures])
    rows = torch.from_numpy(ids)
    got = ours.sample(features, rows, [torch.from_numpy(one) for one in slots]).ids.numpy()
    whole = stock_logits(made, np.concatenate([ids, got], 1), pictures)
    for k, allowed in enumerate(slots):
        scores = whole[:, len(layout) - 1 + k, torch.from_numpy(allowed)]
        best = scores.max(-1).values
        mine = scores.gather(1, torch.from_numpy(got[:, k : k + 1] - allowed[0]))[:, 0]
        assert (best - mine).max() <= 1e-5  # the same, but for ties


def test_the_twin_gives_the_same_answers(nano) -> None:
    made, folder = nano
    layout, ids, pictures = prompts(made, 24)
    slots = [made.ids.vocabulary.number + FREE] * 6 + [np.array([made.ids.end])] * 2
    ours = ForwardConstant(made.model, layout, len(slots))
    features = ours.encode([torch.from_numpy(some) for some in pictures])
    want = ours.sample(features, torch.from_numpy(ids), [torch.from_numpy(s) for s in slots])
    got = answer_prompts(load_numpy_model(folder), layout, ids, pictures, slots)
    assert (got == want.ids.numpy()).mean() >= 0.999


def test_the_twin_draws_the_same_answers(nano) -> None:
    made, folder = nano
    layout, ids, pictures = prompts(made, 24)
    slots = [made.ids.vocabulary.number + FREE] * 6 + [np.array([made.ids.end])] * 2
    draws = np.random.default_rng(4).random((24, 8), np.float32)
    draws[::3] = -1
    ours = ForwardConstant(made.model, layout, len(slots))
    features, rows = ours.encode([torch.from_numpy(s) for s in pictures]), torch.from_numpy(ids)
    tokens = [torch.from_numpy(s) for s in slots]
    want = ours.sample(features, rows, tokens, draws=torch.from_numpy(draws)).ids.numpy()
    got = answer_prompts(load_numpy_model(folder), layout, ids, pictures, slots, draws)
    assert (got == want).mean() >= 0.999
    greedy = ours.sample(features, rows, tokens).ids.numpy()
    assert (want[::3] == greedy[::3]).all() and (want[1::3, :6] != greedy[1::3, :6]).any(1).all()


def test_eight_answers_share_their_pictures(nano) -> None:
    """In float64: in which order a product is summed up hangs on processor and shape."""
    made, _ = nano
    layout, ids, pictures = prompts(made, 2)
    ours = ForwardConstant(copy.deepcopy(made.model).double(), layout, 4)
    seen = [torch.from_numpy(some) for some in pictures]
    rows = torch.from_numpy(ids).repeat_interleave(8, 0)
    answer = torch.from_numpy(np.random.default_rng(0).integers(0, 900, (16, 4)))
    with torch.no_grad():
        shared = ours.logits(ours.encode(seen).repeat(8), rows, answer)
        each = ours.encode([some.repeat_interleave(8, 0) for some in seen])
        assert (shared - ours.logits(each, rows, answer)).abs().max() <= 1e-6


def test_sampled_chances_are_those_of_the_logits(nano) -> None:
    made, _ = nano
    layout, ids, pictures = prompts(made, 4)
    slots = [torch.from_numpy(made.ids.vocabulary.number + FREE), torch.tensor([made.ids.end])] * 2
    ours = ForwardConstant(made.model, layout, len(slots))
    features, rows = ours.encode([torch.from_numpy(s) for s in pictures]), torch.from_numpy(ids)

    def draw(seed: int):
        generator = torch.Generator().manual_seed(seed)
        return ours.sample(features, rows, slots, temperature=1.0, generator=generator)

    drawn = draw(1)
    assert torch.equal(drawn.ids, draw(1).ids)
    assert not torch.equal(drawn.ids, draw(2).ids)
    with torch.no_grad():
        logits = ours.logits(features, rows, drawn.ids)
    for k, allowed in enumerate(slots):
        chances = logits[:, k, allowed].log_softmax(-1)
        at = (drawn.ids[:, k : k + 1] == allowed).int().argmax(-1, keepdim=True)
        assert (chances.gather(1, at)[:, 0] - drawn.logprobs[:, k]).abs().max() <= 1e-5
        assert (-(chances.exp() * chances).sum(-1) - drawn.entropy[:, k]).abs().max() <= 1e-4


def test_a_saved_model_is_loaded_by_stock_transformers(nano) -> None:
    made, folder = nano
    assert len(list(folder.glob("*.safetensors"))) > 1
    assert not list(folder.glob("*.bin"))
    stock = transformers.Qwen3VLForConditionalGeneration.from_pretrained(folder)
    words = transformers.AutoTokenizer.from_pretrained(folder)
    for name, weight in made.model.state_dict().items():
        assert torch.equal(weight, stock.state_dict()[name]), name
    assert words.get_vocab() == made.tokenizer.get_vocab()
    again = load_checkpoint(folder)
    assert again.ids == made.ids
    assert load_architecture(folder) == parse_architecture(made.model.config.to_dict())


def test_navigation_tokens_are_single_and_are_not_dropped(tokenizer) -> None:
    text = "".join(NAVIGATION_TOKENS)
    ids = tokenizer.encode(text)
    assert len(ids) == len(NAVIGATION_TOKENS)
    assert tokenizer.decode(ids, skip_special_tokens=True) == text
    assert "<999>" not in train_tokenizer(["go <999> <|im_end|>"]).decode([0])


def test_the_order_of_texts_does_not_matter(tokenizer) -> None:
    assert train_tokenizer(WORDS[::-1]).get_vocab() == tokenizer.get_vocab()
    with pytest.raises(DataError, match="no texts"):
        train_tokenizer([" "])


def test_a_vocabulary_grows_by_the_mean(nano, tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    build_random_checkpoint(bare)  # another tokenizer's model, 128 rows
    words = train_tokenizer(WORDS)
    words.save_pretrained(bare)
    with pytest.raises(CheckpointError, match="rows for 128"):
        load_checkpoint(bare)
    plain = json.loads((bare / "tokenizer.json").read_text())
    kept = [one for one in plain["added_tokens"] if one["content"] not in NAVIGATION_TOKENS]
    (bare / "tokenizer.json").write_text(json.dumps(plain | {"added_tokens": kept}))
    with pytest.raises(CheckpointError, match=r"1006 of 1006 navigation.*grow=True"):
        load_checkpoint(bare)
    grown = load_checkpoint(bare, grow=True)
    rows = grown.model.get_input_embeddings().weight
    assert rows.shape[0] % 64 == 0
    assert rows.shape[0] >= len(grown.tokenizer)
    torch.testing.assert_close(rows[-1], rows[:128].mean(0))


def test_the_processor_is_loaded_again_and_cuts_pictures_alike(nano, tmp_path: Path) -> None:
    made, _ = nano
    build_processor(made.tokenizer, 8).save_pretrained(tmp_path)
    again = ProcessorPictures.from_pretrained(tmp_path)
    turn = [{"role": "user", "content": [{"type": "image"}, {"type": "text", "text": "go"}]}]
    text = again.apply_chat_template(turn, add_generation_prompt=True, tokenize=False)
    assert text == (
        "<|im_start|>user\n<|vision_start|><|image_pad|><|vision_end|>go<|im_end|>\n"
        "<|im_start|>assistant\n"
    )
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    seen = again(text=[text], images=[Image.fromarray(picture)], return_tensors="pt")
    assert (seen["input_ids"] == made.ids.image).sum() == 3 * 4


def test_sizes_are_as_told(tokenizer) -> None:
    ids = read_token_ids(tokenizer)
    for size, millions in (("nano", 2.2), ("tiny", 17)):
        count = sum(weight.numel() for weight in build_model(size, ids).parameters()) / 1e6
        assert abs(count - millions) < 0.15 * millions, (size, count)
    assert set(SIZES) == {"nano", "tiny"}
    with pytest.raises(ConfigError, match="choose one of nano, tiny"):
        build_model("huge", ids)


def test_the_same_seed_gives_the_same_weights(tokenizer) -> None:
    ids = read_token_ids(tokenizer)
    one, same, other = (build_model("nano", ids, seed).state_dict() for seed in (3, 3, 4))
    assert all(torch.equal(one[name], same[name]) for name in one)
    assert not all(torch.equal(one[name], other[name]) for name in one)


def test_from_texts_to_a_point_without_torch(tokenizer, tmp_path: Path) -> None:
    ids = read_token_ids(tokenizer)
    save_checkpoint(tmp_path / "nano", Checkpoint(build_model("nano", ids), tokenizer, ids))
    model = load_numpy_model(tmp_path / "nano")  # bfloat16, as checkpoints are by default
    words = tokenizer.encode("Go to the sofa.")
    layout = build_layout(
        model.architecture,
        [ids.start, ids.vision_start, PictureSize(64, 64), ids.vision_end, *words, ids.end],
    )
    picture = np.zeros((1, 64, 64, 3), np.uint8)
    slots = [ids.vocabulary.number + FREE] * 2  # a point: two numbers
    answer = answer_prompts(model, layout, layout.ids[None], [picture], slots)
    text = tokenizer.decode(answer[0])
    assert re.fullmatch("<[0-9]{1,3}><[0-9]{1,3}>", text), text
