"""The objective is the paper's by hand and TRL's to 1e-5; a bandit is solved with it."""

from __future__ import annotations

import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.errors import ConfigError  # noqa: E402
from gn0.policies.bae.actor import Actor  # noqa: E402
from gn0.policies.bae.questions import list_allowed  # noqa: E402
from gn0.training.learner import Learner  # noqa: E402
from gn0.training.recipe import Recipe  # noqa: E402
from gn0.training.rl.policy_gradient import (  # noqa: E402
    AnswerBatch,
    AnswerScorer,
    PolicyLoss,
    clip_objective,
    group_advantages,
    measure_kl,
)

GROUP = 4


def sample(pupil, states, *, free: bool = False, seed: int = 0):
    """Prompts of states, and GROUP answers to each."""
    batch = pupil.maker.make(states)
    actor = Actor(
        pupil.model, pupil.table.layout, pupil.slots, pupil.maker.frame, len(batch),
        temperature=1.0, seed=seed, free=free, answers=GROUP,
    )  # fmt: skip
    return batch, actor.decide(batch.pictures, batch.ids)


def allowed_of(pupil, *, free: bool = False):
    return list_allowed(pupil.slots, pupil.maker.frame, free=free)


def test_advantages_by_hand() -> None:
    rewards = torch.tensor([[1.0, 3.0], [2.0, 2.0]])
    assert group_advantages(rewards)[0].tolist() == pytest.approx([-1, 1], abs=1e-5)
    assert group_advantages(rewards)[1].tolist() == [0, 0]
    theirs = group_advantages(rewards, unbiased=True, epsilon=1e-4)
    assert theirs[0].tolist() == pytest.approx([-1 / (math.sqrt(2) + 1e-4), 1 / 1.41431356], 1e-5)


def test_the_objective_by_hand() -> None:
    """Two answers, of one and of three tokens: ratios above, below and within the clips."""
    ratio = torch.tensor([[1.5, 1.0, 1.0], [0.5, 1.5, 1.1]])
    mask = torch.tensor([[True, False, False], [True, True, True]])
    gains = torch.tensor([2.0, -1.0])
    both = [ratio.log(), torch.zeros(2, 3), gains, mask]
    # min(1.5, 1.28) · 2; then the lower of −0.5 and −0.8, of −1.5 and −1.28, and −1.1
    loss, clipped = clip_objective(*both)
    assert loss.item() == pytest.approx(-(2.56 + (-0.8 - 1.5 - 1.1) / 3) / 2)
    assert clipped.item() == pytest.approx(2 / 4)
    loss, _ = clip_objective(*both, aggregation="token")
    assert loss.item() == pytest.approx(-(2.56 - 0.8 - 1.5 - 1.1) / 4)
    none = mask.clone()
    none[1] = False  # an answer that counts for nothing is not in the mean
    assert clip_objective(*both[:3], none)[0].item() == pytest.approx(-2.56)
    assert clip_objective(*both[:3], none & False)[0].item() == 0


def test_kl_is_nought_at_the_start_and_positive_elsewhere() -> None:
    chances = torch.log(torch.tensor([[0.5, 0.2]]))
    mask = torch.ones(1, 2, dtype=torch.bool)
    assert measure_kl(chances, chances, mask).item() == 0
    other = torch.log(torch.tensor([[0.25, 0.2]]))
    expected = (0.5 - math.log(0.5) - 1) / 2  # of the first token alone
    assert measure_kl(chances, other, mask).item() == pytest.approx(expected)


def test_kl_in_the_loss_pulls_towards_the_start(pupil, draw_states) -> None:
    """Without advantages the gradient is KL's alone; none of it where the policy is the start."""
    batch, said = sample(pupil, draw_states(2))
    mask = torch.from_numpy(pupil.slots.chosen)[None].expand(len(said.ids), -1)
    loss = PolicyLoss(pupil.forward, allowed_of(pupil), kl_weight=0.5)
    plain = [batch.pictures, batch.ids, said.ids, said.logprobs, torch.zeros(len(said.ids)), mask]
    assert loss(AnswerBatch(*plain, said.logprobs)).loss.item() == pytest.approx(0, abs=1e-9)
    far = said.logprobs + 0.4 * mask
    found = loss(AnswerBatch(*plain, far)).loss
    assert found.item() == pytest.approx(0.5 * (math.exp(0.4) - 1.4), rel=1e-4)
    found.backward()
    assert pupil.model.lm_head.weight.grad.abs().max() > 0
    assert loss(AnswerBatch(*plain)).loss.item() == 0


@pytest.mark.parametrize("free", [False, True])
def test_chances_are_those_that_answers_were_sampled_with(pupil, draw_states, free) -> None:
    batch, said = sample(pupil, draw_states(2), free=free)
    assert said.ids.shape == (2 * GROUP, len(pupil.slots))
    assert len({tuple(row) for row in said.ids[:GROUP].tolist()}) == GROUP
    scorer = AnswerScorer(pupil.forward, allowed_of(pupil, free=free))
    with torch.no_grad():
        found = scorer.score(batch.pictures, batch.ids, said.ids)
    assert torch.allclose(found.logprobs, said.logprobs, atol=2e-6)
    assert torch.allclose(found.entropy, said.entropy, atol=2e-6)
    assert (found.logprobs[:, ~scorer.chosen] == 0).all()
    # pictures that are encoded eight times say the same
    every = [one.repeat_interleave(GROUP, 0) for one in batch.pictures]
    with torch.no_grad():
        eight = scorer.score(every, batch.ids.repeat_interleave(GROUP, 0), said.ids)
    assert torch.allclose(found.logprobs, eight.logprobs, atol=1e-6)


def test_a_seed_draws_the_same_again(pupil, draw_states) -> None:
    batch = pupil.maker.make(draw_states(2))
    actor = Actor(
        pupil.model, pupil.table.layout, pupil.slots, pupil.maker.frame, 2, temperature=1.0,
        answers=GROUP,
    )  # fmt: skip
    told = []
    for seed in (5, 6, 5):
        actor.reseed(seed)
        told.append(actor.decide(batch.pictures, batch.ids).ids)
    assert torch.equal(told[0], told[2])
    assert not torch.equal(told[0], told[1])
    with pytest.raises(ConfigError, match="0 answers"):
        Actor(
            pupil.model, pupil.table.layout, pupil.slots, pupil.maker.frame, 2, answers=0
        )  # fmt: skip


def test_batches_split_into_whole_groups() -> None:
    rows = torch.arange(12)
    batch = AnswerBatch((rows[:3],), rows[:3], rows, rows, rows, rows)
    parts = batch.split(2)
    assert [part.ids.tolist() for part in parts] == [[0, 1], [2]]
    assert [part.answers.tolist() for part in parts] == [list(range(8)), [8, 9, 10, 11]]
    assert len(batch.split(9)) == 3


def test_loss_and_gradients_are_those_of_trl(make_pupil, draw_states) -> None:
    """On answers of any tokens and length, after some weights have moved since the sampling."""
    trl = pytest.importorskip("trl.trainer.grpo_trainer")
    from collections import defaultdict
    from types import SimpleNamespace

    from accelerate import Accelerator
    from PIL import Image

    from gn0.policies.bae.processor import build_processor

    pupil = make_pupil()
    batch, said = sample(pupil, draw_states(2), free=True)
    count, size = said.ids.shape
    mask = torch.arange(size) < torch.tensor([[size - k] for k in range(count)])
    rewards = torch.linspace(0, 1, count).square().view(-1, GROUP)
    gains = group_advantages(rewards, unbiased=True, epsilon=1e-4).flatten()
    old = said.logprobs + 0.3 * torch.randn(said.logprobs.shape, generator=torch.Generator())
    # TRL knows no mask: every row of the model's output may be chosen
    rows = [np.arange(pupil.model.config.text_config.vocab_size)] * size
    loss = PolicyLoss(pupil.forward, rows)
    ours = loss(AnswerBatch(batch.pictures, batch.ids, said.ids, old, gains, mask))
    ours.loss.backward()
    mine = {
        name: w.grad.clone() for name, w in pupil.model.named_parameters() if w.grad is not None
    }
    pupil.model.zero_grad(set_to_none=True)

    trainer = trl.GRPOTrainer.__new__(trl.GRPOTrainer)
    settings = {
        "model": pupil.model, "loss_type": "grpo", "beta": 0.0, "epsilon_low": 0.2,
        "epsilon_high": 0.28, "args": SimpleNamespace(delta=None), "top_entropy_quantile": 1.0,
        "off_policy_mask_threshold": None, "importance_sampling_level": "token",
        "use_vllm": False, "aux_loss_enabled": False, "_entropy_bonus_enabled": False,
        "current_gradient_accumulation_steps": 1, "accelerator": Accelerator(cpu=True),
        "_metrics": {"train": defaultdict(list), "eval": defaultdict(list)},
    }  # fmt: skip
    for name, value in settings.items():
        setattr(trainer, name, value)
    trl.add_fused_lm_head(pupil.model, outputs=("log_probs", "entropy"))
    prompts = batch.ids.repeat_interleave(GROUP, 0)
    flat = [
        Image.fromarray(some[row // GROUP].numpy())
        for row in range(count)
        for some in batch.pictures
    ]
    processor = build_processor(pupil.tokenizer, pupil.model.config.vision_config.patch_size)
    seen = processor.image_processor(images=flat, return_tensors="pt")
    # stock code would look for a picture at an image token that was sampled
    whole = torch.cat([prompts, said.ids], 1)
    kinds = torch.cat([prompts == pupil.ids.image, torch.zeros_like(mask)], 1).int()
    theirs = trainer._compute_loss(
        pupil.model,
        {
            "prompt_ids": prompts, "prompt_mask": torch.ones_like(prompts),
            "completion_ids": said.ids, "completion_mask": mask.int(),
            "advantages": gains, "old_per_token_logps": old,
            "pixel_values": seen["pixel_values"], "image_grid_thw": seen["image_grid_thw"],
            "num_images": [2] * count, "mm_token_type_ids": kinds,
        },
    )  # fmt: skip
    assert (whole[:, -size:] != pupil.ids.image).all()
    theirs.backward()
    assert ours.loss.item() == pytest.approx(theirs.item(), abs=1e-5)
    clips = trainer._metrics["train"]["clip_ratio/region_mean"][-1]
    assert ours.clipped.item() == pytest.approx(clips, abs=1e-6)
    assert clips > 0
    for name, weight in pupil.model.named_parameters():
        if weight.grad is not None and name in mine:
            assert torch.allclose(mine[name], weight.grad, atol=1e-5), name
    assert set(mine) == {n for n, w in pupil.model.named_parameters() if w.grad is not None}


@pytest.mark.slow
def test_a_bandit_is_solved_from_a_random_start(words, draw_states) -> None:
    """Of 4,096 answers one is best, six turns to the left; nothing but rewards says which."""
    from gn0_trials.pupil_small import PupilSmall

    pupil, best = PupilSmall(words, points=0), torch.full((6,), 2)
    for name, weight in pupil.model.named_parameters():
        weight.requires_grad_("visual." not in name)
    loss = PolicyLoss(pupil.forward, allowed_of(pupil))
    learner = Learner(loss, Recipe(rate=1e-4, mean=0.0, decay=0.0))
    batch, right = pupil.maker.make(draw_states(1)), 0.0
    actor = Actor(
        pupil.model, pupil.table.layout, pupil.slots, pupil.maker.frame, 1, temperature=1.0,
        answers=16,
    )  # fmt: skip
    mask = torch.from_numpy(pupil.slots.chosen)[None].expand(16, -1)
    for _ in range(60):
        said = actor.decide(batch.pictures, batch.ids)
        rewards = (said.actions == best).float().mean(1)
        right = rewards.mean().item()
        if right > 0.9:
            break
        gains = group_advantages(rewards[None])[0]
        learner.step(
            AnswerBatch(batch.pictures, batch.ids, said.ids, said.logprobs, gains, mask), 1.0
        )
    assert right > 0.9
