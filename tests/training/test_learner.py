"""Learning from labels: the paper's loss, the recipe's rates and averaged weights."""

from __future__ import annotations

import math

import pytest

torch = pytest.importorskip("torch")

from PIL import Image  # noqa: E402
from torch.utils._python_dispatch import TorchDispatchMode  # noqa: E402

from gn0.errors import DeviceMemoryError  # noqa: E402
from gn0.policies.bae.forward import ForwardConstant  # noqa: E402
from gn0.policies.bae.processor import build_processor  # noqa: E402
from gn0.training.learner import Learner, LossForward, group_weights  # noqa: E402
from gn0.training.recipe import RECIPES, Recipe  # noqa: E402
from gn0.training.schedule import Schedule  # noqa: E402

PLAIN = Recipe(stop_weight=1.0, distance_weight=0.0)


def test_the_loss_is_the_one_of_stock_transformers(pupil, draw_states) -> None:
    """All answers are of one length, so the mean by sample is the mean by token."""
    batch = pupil.maker.make(draw_states(3))
    ours = LossForward(pupil.forward, pupil.slots, PLAIN)(batch).loss
    whole = torch.cat([batch.ids, batch.answer], 1)
    labels = whole.clone()
    labels[:, : batch.ids.shape[1]] = -100
    flat = [Image.fromarray(some[row].numpy()) for row in range(3) for some in batch.pictures]
    processor = build_processor(pupil.tokenizer, pupil.model.config.vision_config.patch_size)
    seen = processor.image_processor(images=flat, return_tensors="pt")
    theirs = pupil.model(
        input_ids=whole,
        pixel_values=seen["pixel_values"],
        image_grid_thw=seen["image_grid_thw"],
        mm_token_type_ids=(whole == pupil.ids.image).int(),
        labels=labels,
    ).loss
    assert ours.item() == pytest.approx(theirs.item(), abs=2e-5)


def test_the_first_stop_of_an_answer_weighs_as_the_recipe_says(pupil, draw_states) -> None:
    states = draw_states(4)
    states.actions[:] = 1
    states.actions[0, 2:] = 0
    batch = pupil.maker.make(states)
    plain = LossForward(pupil.forward, pupil.slots, PLAIN)
    heavy = LossForward(pupil.forward, pupil.slots, Recipe(stop_weight=4.0, distance_weight=0.0))
    weights = heavy._weigh(batch.answer)
    assert weights.sum().item() == weights.numel() + 3  # one token of weight 4
    assert weights[1:].eq(1).all()
    assert batch.answer[weights > 1].tolist() == [pupil.slots.vocabulary.actions[0]]
    assert heavy(batch).loss > plain(batch).loss


@pytest.mark.parametrize("speed", [{"joined": True}, {"narrow": True}, {"compiled": True}])
def test_speeds_give_the_same_loss_and_gradient(speed, pupil, draw_states) -> None:
    """In float32; under autocast a narrow one is only near, and is checked to be."""
    batch, recipe = pupil.maker.make(draw_states(3)), Recipe()
    layout, count = pupil.table.layout, len(pupil.slots)

    def learn(autocast: bool, compiled: bool = False, **options):
        forward = ForwardConstant(pupil.model, layout, count, **options)
        loss = LossForward(forward, pupil.slots, recipe)
        if compiled:  # traced as a whole, without a compiler
            loss._judge = torch.compile(loss._compute, backend="eager", fullgraph=True)
        pupil.model.zero_grad()
        with torch.autocast("cpu", torch.bfloat16, enabled=autocast):
            found = loss(batch).loss
        found.backward()
        return found.detach(), [w.grad.clone() for w in pupil.model.parameters()]

    (plain, wanted), (fast, got) = learn(False), learn(False, **speed)
    torch.testing.assert_close(fast, plain, atol=1e-5, rtol=0)
    for one, other in zip(got, wanted, strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-3)
    near, far = learn(True)[0], learn(True, **speed)[0]
    assert far.item() == pytest.approx(near.item(), abs=0.02)


def test_neither_batch_nor_gradient_waits_for_a_card(pupil, draw_states) -> None:
    """Operations whose result the host must read before it goes on."""
    waiting = ("_local_scalar_dense", "nonzero", "masked_select", "unique", "is_nonzero", "equal")
    seen: list[str] = []

    class Watch(TorchDispatchMode):
        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            seen.append(func._schema.name.removeprefix("aten::"))
            return func(*args, **(kwargs or {}))

    states = draw_states(3)
    learner = Learner(LossForward(pupil.forward, pupil.slots, Recipe()), Recipe())
    with Watch():
        learner.descend(learner.judge(pupil.maker.make(states)))
    assert "mm" in seen
    assert not [name for name in seen if name.startswith(waiting)]


def test_a_model_learns_its_samples_by_heart(pupil, draw_states) -> None:
    batch = pupil.maker.make(draw_states(2))
    recipe = Recipe(rate=3e-3, warm_steps=5, mean=0.9)
    learner = Learner(LossForward(pupil.forward, pupil.slots, recipe), recipe)
    schedule = Schedule().end_at(60, recipe)
    for step in range(60):
        losses, norm = learner.step(batch, schedule.share(step, recipe))
        assert math.isfinite(norm.item())
    assert losses.first.item() == 1.0
    assert losses.groups.max().item() < 0.3
    before = [w.clone() for w in pupil.model.parameters()]
    with learner.averaged_weights(), torch.no_grad():
        assert learner.loss(batch).groups.max().item() < 0.5
        assert any((a != b).any() for a, b in zip(before, pupil.model.parameters(), strict=True))
    assert all((a == b).all() for a, b in zip(before, pupil.model.parameters(), strict=True))


def test_projector_and_language_learn_at_one_rate_the_tower_at_another(pupil) -> None:
    recipe = RECIPES["pretrained"]
    named = dict(pupil.model.named_parameters())
    groups = group_weights(named.items(), recipe)
    rate_of = {id(w): group["lr"] for group in groups for w in group["params"]}
    assert len(rate_of) == len(named)
    for name, weight in named.items():
        tower = "visual." in name and "merger" not in name
        assert rate_of[id(weight)] == (2e-6 if tower else 1e-5), name


def test_the_rate_warms_stays_and_falls() -> None:
    recipe = Recipe(warm_steps=100, tail=0.2, floor=0.02)
    run = Schedule().end_at(1000, recipe)
    assert run.share(0, recipe) == 0.01
    assert run.share(99, recipe) == run.share(799, recipe) == run.share(800, recipe) == 1
    assert run.share(900, recipe) == pytest.approx(0.51)
    assert run.share(1000, recipe) == pytest.approx(0.02)
    open_end = Schedule()
    assert open_end.share(10**6, recipe) == 1
    soon = open_end.end_soon(4000, recipe)
    assert (soon.tail, soon.end) == (4000, 5000)
    assert run.seconds_left(799, 500.0, 10.0) == 100 and run.seconds_left(0, 700.0, 10.0) == 0
    assert run.seconds_left(800, 500.0, 10.0) is None is run.seconds_left(0, 500.0, None)
    again = run.warm_again(500)
    assert again.share(500, recipe) == 0.01 and again.share(700, recipe) == 1
    cosine = Recipe(schedule="cosine", warm_steps=0)
    assert Schedule().end_at(100, cosine).share(50, cosine) == pytest.approx(0.5)


def test_a_card_that_is_too_small_is_told_in_bytes(pupil, draw_states, monkeypatch) -> None:
    learner = Learner(LossForward(pupil.forward, pupil.slots, PLAIN), PLAIN)

    def lacks(losses) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(learner, "descend", lacks)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (2**20, 80 * 2**30))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda device: 30 * 2**30)
    with pytest.raises(DeviceMemoryError, match="1048576 of its 85899345920") as caught:
        learner.step(pupil.maker.make(draw_states(2)), 1.0)
    assert "--batch" in caught.value.remedy
