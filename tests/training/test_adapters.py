"""Adapters learn beside frozen weights, and what is written of them is a plain model."""

from __future__ import annotations

import shutil

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")
pytest.importorskip("peft")

from transformers import Qwen3VLForConditionalGeneration  # noqa: E402

from gn0.cli.main import main  # noqa: E402
from gn0.errors import CheckpointError, ConfigError  # noqa: E402
from gn0.policies.bae.actor import Actor  # noqa: E402
from gn0.policies.bae.checkpoint import load_checkpoint  # noqa: E402
from gn0.policies.bae.questions import list_allowed  # noqa: E402
from gn0.training.adapters import add_adapters, has_adapters, merge_adapters  # noqa: E402
from gn0.training.learner import Learner, LossForward  # noqa: E402
from gn0.training.recipe import Recipe  # noqa: E402
from gn0.training.rl.policy_gradient import AnswerBatch, PolicyLoss  # noqa: E402
from gn0.training.runs.training_state import load_state  # noqa: E402
from gn0_trials.episodes_small import build_walker  # noqa: E402

RECIPE = Recipe(rate=1e-2, warm_steps=0, mean=0.0, decay=0.0, distance_weight=0.0)


def answer(pupil, batch):
    forward = pupil.forward_of(pupil.model)
    with torch.no_grad():
        return forward.logits(forward.encode(batch.pictures), batch.ids, batch.answer)


def decide(pupil, batch):
    layout, frame = pupil.table.layout, pupil.maker.frame
    actor = Actor(pupil.model, layout, pupil.slots, frame, len(batch))
    return actor.decide(batch.pictures, batch.ids).ids


def test_adapters_learn_and_the_plain_model_says_the_same(make_pupil, draw_states) -> None:
    pupil = make_pupil()
    batch = pupil.maker.make(draw_states(4))
    before, said = answer(pupil, batch), {n: w.clone() for n, w in pupil.model.state_dict().items()}
    add_adapters(pupil.model, pupil.ids, rank=8)
    assert has_adapters(pupil.model)
    torch.testing.assert_close(answer(pupil, batch), before)
    learner = Learner(LossForward(pupil.forward_of(pupil.model), pupil.slots, RECIPE), RECIPE)
    names = set(learner.weights)
    assert all("lora_" in name or name.endswith("embed_tokens.rows") for name in names)
    assert any("visual.merger.linear_fc1.lora_A" in name for name in names)
    assert any("deepstack_merger_list.1.linear_fc2.lora_B" in name for name in names)
    assert not any("visual.blocks" in name for name in names)
    losses = [learner.step(batch, 1.0)[0].loss.item() for _ in range(12)]
    assert losses[-1] < 0.6 * losses[0]
    for name, weight in pupil.model.state_dict().items():  # the frozen ones have not moved
        plain = name.replace(".base_layer", "").replace(".base.", ".")
        if "lora_" not in name and not name.endswith(".rows"):
            assert torch.equal(weight, said[plain]), name
    taught, chosen = answer(pupil, batch), decide(pupil, batch)
    merge_adapters(pupil.model)
    assert not has_adapters(pupil.model)
    assert set(pupil.model.state_dict()) == set(said)
    torch.testing.assert_close(answer(pupil, batch), taught, atol=1e-4, rtol=1e-4)
    assert torch.equal(decide(pupil, batch), chosen)
    assert pupil.model.lm_head.weight is pupil.model.model.language_model.embed_tokens.weight


def test_navigation_tokens_that_begin_alike_are_told_apart(make_pupil, draw_states) -> None:
    """As after `load_checkpoint(grow=True)`: adapters alone would never leave 1,000 equal rows."""
    pupil = make_pupil()
    words, table = pupil.ids.vocabulary, pupil.model.model.language_model.embed_tokens.weight
    with torch.no_grad():
        table[words.first : words.size] = table[: words.first].mean(0)
    batch = pupil.maker.make(draw_states(4))
    add_adapters(pupil.model, pupil.ids, rank=2, dtype=torch.float32)
    learner = Learner(LossForward(pupil.forward_of(pupil.model), pupil.slots, RECIPE), RECIPE)
    losses = [learner.step(batch, 1.0)[0].groups[0].item() for _ in range(12)]
    assert losses[0] > 6 and losses[-1] < losses[0] - 1  # ln 1000 = 6.9, of points
    own = pupil.model.model.language_model.embed_tokens
    assert torch.equal(own.weight[: words.first], table[: words.first])


def test_a_policy_gradient_moves_adapters_alone(make_pupil, draw_states) -> None:
    pupil = make_pupil()
    add_adapters(pupil.model, pupil.ids, rank=2, seed=1)
    batch = pupil.maker.make(draw_states(2))
    actor = Actor(
        pupil.model, pupil.table.layout, pupil.slots, pupil.maker.frame, 2, temperature=1.0,
        answers=4,
    )  # fmt: skip
    said = actor.decide(batch.pictures, batch.ids)
    allowed = list_allowed(pupil.slots, pupil.maker.frame)
    learner = Learner(PolicyLoss(pupil.forward_of(pupil.model), allowed), RECIPE)
    mask = torch.from_numpy(pupil.slots.chosen)[None].expand(8, -1)
    gains = torch.tensor([1.0, -1.0] * 4)
    given = AnswerBatch(batch.pictures, batch.ids, said.ids, said.logprobs, gains, mask)
    frozen = {n: w.clone() for n, w in pupil.model.named_parameters() if not w.requires_grad}
    first = {n: w.detach().clone() for n, w in learner.weights.items()}
    learner.step(given, 1.0)
    assert all(torch.equal(w, frozen[n]) for n, w in pupil.model.named_parameters() if n in frozen)
    assert any(not torch.equal(w, first[n]) for n, w in learner.weights.items())


def test_adapters_are_drawn_by_their_seed(make_pupil) -> None:
    def draw(seed: int):
        pupil = make_pupil()
        add_adapters(pupil.model, pupil.ids, rank=2, seed=seed)
        return [w.clone() for n, w in pupil.model.named_parameters() if "lora_A" in n]

    one, same, other = draw(0), draw(0), draw(1)
    assert all(torch.equal(a, b) for a, b in zip(one, same, strict=True))
    assert not torch.equal(one[0], other[0])
    pupil = make_pupil()
    with pytest.raises(ConfigError, match="rank 0"):
        add_adapters(pupil.model, pupil.ids, rank=0)
    add_adapters(pupil.model, pupil.ids, rank=1, dtype=torch.bfloat16)
    kinds = {weight.dtype for weight in pupil.model.parameters() if weight.requires_grad}
    assert kinds == {torch.float32}
    assert pupil.model.model.visual.patch_embed.proj.weight.dtype == torch.bfloat16


@pytest.mark.slow
def test_a_run_with_adapters_goes_on_and_writes_a_plain_policy(
    flats_suite, tmp_path, capsys
) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    start = tmp_path / "start"
    build_walker([episode.instruction for episode in flats_suite.episodes]).save(start)

    def train(out, *more: str) -> int:
        return main(
            ["train", "sft", str(flats_suite.folder), "--split", "all", "--held-out", "",
             "--source", "uniform", "--recipe", "pretrained", "--start", str(start), "--pictures",
             "near", "--lora", "4", "--batch", "4", "--agents", "4", "--report", "1", "--save",
             "1", "--device", "host", "--samples", "12", "--out", str(out), *more]
        )  # fmt: skip

    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert train(whole) == 0
    state = whole / "checkpoints" / "step-000000003"
    assert not (state / "model").exists()
    size = sum(file.stat().st_size for file in state.rglob("*"))
    assert size < 0.9 * (start / "model.safetensors").stat().st_size * 2  # which is bfloat16
    shutil.copytree(whole, parts)
    shutil.rmtree(parts / "checkpoints" / "step-000000003")
    shutil.rmtree(parts / "policy")
    assert train(parts) == 0
    one, two = (run / "policy" / "model.safetensors" for run in (whole, parts))
    assert one.read_bytes() == two.read_bytes()
    with pytest.raises(CheckpointError, match="a state of adapters"):
        load_state(state)
    plain = Qwen3VLForConditionalGeneration.from_pretrained(whole / "policy")
    own = load_checkpoint(start).model.state_dict()
    moved = {
        name for name, weight in plain.state_dict().items() if not torch.equal(weight, own[name])
    }
    assert not any("visual.blocks" in name or "norm" in name for name in moved)
    assert {name.split(".")[-2] for name in moved} >= {"q_proj", "down_proj", "linear_fc1"}
    # another model of the same name is not gone on from
    build_walker([e.instruction for e in flats_suite.episodes], seed=9).save(start, overwrite=True)
    shutil.rmtree(parts / "policy")
    assert train(parts) == 2
    assert "base was" in capsys.readouterr().err
    assert train(tmp_path / "none", "--start", "") == 2
    assert "adapters of a model of random weights" in capsys.readouterr().err
