"""Decisions of many agents are those of the model's own sampling, whatever the batch."""

from __future__ import annotations

import gc

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.errors import ConfigError, DeviceMemoryError  # noqa: E402
from gn0.policies.bae.actor import Actor, share_pool  # noqa: E402
from gn0.policies.bae.questions import find_place, list_allowed  # noqa: E402


def act(pupil, count: int, **settings) -> Actor:
    return Actor(
        pupil.model.eval(), pupil.table.layout, pupil.slots, pupil.maker.frame, count, **settings
    )


def test_greedy_answers_are_those_of_the_model(pupil, draw_states) -> None:
    batch = pupil.maker.make(draw_states(12))
    said = act(pupil, 12).decide(batch.pictures, batch.ids)
    allowed = [torch.from_numpy(one) for one in list_allowed(pupil.slots, pupil.maker.frame)]
    with torch.no_grad():
        features = pupil.forward.encode(batch.pictures)
        want = pupil.forward.sample(features, batch.ids, allowed)
        logits = pupil.forward.logits(features, batch.ids, want.ids)
    assert torch.equal(said.ids, want.ids)
    assert torch.equal(said.logprobs, want.logprobs)
    for k, own in enumerate(allowed):  # teacher-forced, the same tokens are the most probable
        scores = logits[:, k, own]
        at = (want.ids[:, k : k + 1] == own).int().argmax(-1)
        mine = scores.gather(1, at[:, None])[:, 0]
        assert float((scores.max(-1).values - mine).max()) <= 1e-5
    assert torch.equal(said.actions, pupil.maker.actions(said.ids))
    metres = pupil.maker.waypoints(said.ids)
    assert metres.shape == (12, 12, 2)
    assert said.tokens.shape == (12, 12, 2)


def test_fewer_agents_are_filled_up_and_change_nothing(pupil, draw_states) -> None:
    batch = pupil.maker.make(draw_states(8))
    actor = act(pupil, 8)
    whole = actor.decide(batch.pictures, batch.ids)
    some = actor.decide([one[5:] for one in batch.pictures], batch.ids[5:])
    assert torch.equal(some.ids, whole.ids[5:])
    assert whole.ids.shape == (8, len(pupil.slots))  # the first are the caller's own


def test_a_model_that_learns_acts_with_what_it_has_now(pupil, draw_states) -> None:
    batch = pupil.maker.make(draw_states(6))
    actor = act(pupil, 6)
    before = actor.decide(batch.pictures, batch.ids).ids
    kept = {name: one.clone() for name, one in pupil.model.state_dict().items()}
    with torch.no_grad():
        for weight in pupil.model.parameters():
            weight.mul_(-1.3)
    assert not torch.equal(actor.decide(batch.pictures, batch.ids).ids, before)
    pupil.model.load_state_dict(kept)
    assert torch.equal(actor.decide(batch.pictures, batch.ids).ids, before)


def test_draws_hang_on_the_seed_and_say_how_likely_they_were(pupil, draw_states) -> None:
    batch = pupil.maker.make(draw_states(4))
    one, same, other = (
        act(pupil, 4, temperature=1.0, seed=seed).decide(batch.pictures, batch.ids)
        for seed in (3, 3, 4)
    )
    assert torch.equal(one.ids, same.ids)
    assert not torch.equal(one.ids, other.ids)
    assert float(one.logprobs.max()) <= 0
    free = [len(own) > 1 for own in list_allowed(pupil.slots, pupil.maker.frame)]
    assert sum(free) == 30  # 24 coordinates and 6 actions
    assert ((one.entropy > 0) == torch.tensor(free)).all()


def test_the_place_is_where_the_square_has_the_agent(pupil) -> None:
    x, y = find_place(pupil.maker.frame)
    assert x == 484  # (16 - 0.5) / 32 px, times 1000, rounded half up
    assert y == 634  # (0.65 * 32 - 0.5) / 32 px


def test_other_shapes_are_refused(pupil, draw_states) -> None:
    batch = pupil.maker.make(draw_states(5))
    actor = act(pupil, 4)
    with pytest.raises(ConfigError, match="1 to 4"):
        actor.decide(batch.pictures, batch.ids)
    with pytest.raises(ConfigError, match="give 2 pictures"):
        actor.decide(batch.pictures[:1], batch.ids[:4])
    with pytest.raises(ConfigError, match="uint8"):
        actor.decide([one[:4].float() for one in batch.pictures], batch.ids[:4])
    with pytest.raises(ConfigError, match="at least 1"):
        act(pupil, 0)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a card")
def test_recorded_actors_of_a_card_compute_in_the_same_memory(pupil, draw_states) -> None:
    """Whoever was asked between, the answers are those that the same actor gave alone."""
    batch, model = pupil.maker.make(draw_states(12)), pupil.model.cuda()
    pictures, ids = [one.cuda() for one in batch.pictures], batch.ids.cuda()
    thirds = [([one[at : at + 4] for one in pictures], ids[at : at + 4]) for at in (0, 4, 8)]
    want = act(pupil, 12, recorded=False).decide(pictures, ids).ids
    some = [act(pupil, 4, recorded=False).decide(*third).ids for third in thirds]
    wide, tight = act(pupil, 12), act(pupil, 4)
    assert torch.equal(wide.decide(pictures, ids).ids, want)
    torch.cuda.empty_cache()
    before = torch.cuda.memory_reserved()
    for _ in range(3):
        for third, own in zip(thirds, some, strict=True):
            assert torch.equal(tight.decide(*third).ids, own)
        assert torch.equal(wide.decide(pictures, ids).ids, want)
    assert torch.cuda.memory_reserved() - before < 2**26
    del wide, tight  # as at the end of a stage's collection; the next one is recorded after it
    gc.collect()
    assert torch.equal(act(pupil, 12).decide(pictures, ids).ids, want)
    model.cpu()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a card")
def test_the_memory_that_actors_share_outlives_them() -> None:
    """A stage's actor may go while something that it computed stays, and the next one comes."""
    number = torch.ones(1000, device="cuda")

    def record() -> tuple[torch.cuda.CUDAGraph, torch.Tensor]:
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=share_pool(0).id):
            twice = number * 2
        graph.replay()
        return graph, twice

    first, said = record()
    del first
    gc.collect()
    second, again = record()
    second.replay()
    assert torch.equal(said, again)


def test_a_card_that_is_too_small_is_told_in_bytes(pupil, draw_states, monkeypatch) -> None:
    batch = pupil.maker.make(draw_states(4))
    actor = act(pupil, 4)

    def lacks(*_, **__) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(actor.forward, "sample", lacks)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (2**20, 80 * 2**30))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda device: 30 * 2**30)
    with pytest.raises(
        DeviceMemoryError,
        match=r"4 agents.*1048576 of its 85899345920.* 32212254720 are the model's",
    ) as caught:
        actor.decide(batch.pictures, batch.ids)
    assert "--agents" in caught.value.remedy
