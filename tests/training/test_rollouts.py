"""Answers to visited states are carried out and scored; groups that say nothing may be left out."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.data.answer_form import AnswerForm  # noqa: E402
from gn0.errors import ConfigError  # noqa: E402
from gn0.policies.bae.policy_settings import PolicySettings  # noqa: E402
from gn0.sim.ego_map import EgoSquare, MapView  # noqa: E402
from gn0.training.pupil import build_pupil  # noqa: E402
from gn0.training.rl import rollouts  # noqa: E402
from gn0.training.rl.rollouts import Asked, RolloutMaker, RolloutSettings  # noqa: E402
from gn0.training.rl.visited_states import collect_states  # noqa: E402

GROUP = 3
SQUARES = MapView(squares=(EgoSquare(32, 0.24), EgoSquare(32, 0.6)))


@pytest.fixture
def open_maker(make_env, rooms):
    """A `RolloutMaker` of a random model in the two flats, and its pupil."""

    def make(layout: str = "compact", *, walks="expert", reference="expert", log=None, **settings):
        texts = [episode.instruction for episode in rooms[1]]
        form = AnswerForm(points=3, layout=layout)
        asked = PolicySettings(prompt="short", pictures=("near", "far"), form=form, view=SQUARES)
        pupil = build_pupil("nano", asked, texts, merges=300)
        env = make_env(4, sensors=("ego_map",), map_view=SQUARES)
        visited = collect_states(env, pupil, 20, seed=1, walks=walks, reference=reference, log=log)
        own = RolloutSettings(answers=GROUP, **settings)
        return RolloutMaker(pupil, visited, own, 4), pupil

    return make


def roll(maker: RolloutMaker, *, seed: int = 0):
    asked = maker.ask(np.arange(4), seed)
    return maker.score(asked, maker.walk(asked))


def say(maker: RolloutMaker, pupil, asked: Asked, answers) -> Asked:
    """The same prompts, answered in these words."""
    ids = answers.repeat_interleave(GROUP, 0)
    return Asked(
        asked.rows, asked.pictures, asked.ids, ids, maker.visited.maker.actions(ids),
        asked.entropy,
    )  # fmt: skip


@pytest.mark.parametrize("walks", ["policy", "expert"])
def test_states_are_collected_again_from_their_log(open_maker, walks) -> None:
    first, _ = open_maker(walks=walks)
    again, _ = open_maker(walks=walks, log=first.visited.log)
    assert len(first.visited) == 20
    assert first.visited.counts is not None and again.visited.counts is None
    rows = np.arange(20)
    one, other = first.visited.draw(rows), again.visited.draw(rows)
    for name in ("episode", "pose", "last", "collided", "actions", "waypoints", "distance"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
    for name, picture in one.pictures.items():
        assert torch.equal(picture, other.pictures[name])
    assert torch.equal(first.visited.wanted.poses, again.visited.wanted.poses)


def test_the_experts_own_answer_scores_all_that_there_is(open_maker) -> None:
    """R_traj is 1 but for the width of a coordinate, the first action right, nothing cut short."""
    maker, pupil = open_maker()
    asked = maker.ask(np.arange(4), 0)
    states = maker.visited.draw(np.arange(4))
    right = say(maker, pupil, asked, maker.visited.maker.make(states).answer)
    rollout = maker.score(right, maker.walk(right))
    assert (rollout.rewards.total > 1.49).all() and (rollout.rewards.total <= 1.5).all()
    assert rollout.rewards.collision.sum() == rollout.rewards.length.sum() == 0
    assert not rollout.varied.any()  # a group of one answer


@pytest.mark.parametrize("layout", ["compact", "json"])
def test_the_policys_own_plan_may_be_the_reference(open_maker, layout) -> None:
    """Its most probable answer then scores everything, whatever it says."""
    maker, _ = open_maker(layout, reference="policy", sampling="slots", temperature=1e-6)
    rollout = roll(maker)
    assert torch.equal(rollout.asked.actions[::GROUP], maker.visited.actions[:4])
    assert rollout.rewards.trajectory.tolist() == pytest.approx([1] * 12)
    expert = maker.visited.draw(np.arange(20)).actions
    assert not torch.equal(maker.visited.actions, expert.long())
    again, _ = open_maker(layout, reference="policy", log=maker.visited.log)
    assert torch.equal(again.visited.waypoints, maker.visited.waypoints)


def test_answers_of_one_seed_are_the_same_and_differ_in_a_group(open_maker) -> None:
    maker, _ = open_maker()
    first, again, other = roll(maker, seed=3), roll(maker, seed=3), roll(maker, seed=4)
    assert torch.equal(first.asked.answers, again.asked.answers)
    assert torch.equal(first.scores, again.scores)
    assert not torch.equal(first.asked.answers, other.asked.answers)
    assert first.varied.all() and first.readable.all()
    assert first.mask.sum(1).tolist() == [4 + 6] * 12  # two waypoints and six actions
    told = {name: float(value) for name, value in maker.measure(first).items()}
    terms = ("trajectory", "first", "collision", "length", "format")
    weights = (1, 0.5, -0.5, -0.2, -2)
    total = sum(w * told[f"reward_{n}"] for w, n in zip(weights, terms, strict=True))
    assert told["reward"] == pytest.approx(total)
    assert told["groups_dropped"] == 0 and told["entropy_action_1"] > 1


def test_free_answers_that_cannot_be_read_score_minus_two_and_nothing_else(open_maker) -> None:
    maker, pupil = open_maker("json")
    assert maker.free and len(maker.allowed[0]) == pupil.slots.vocabulary.size
    rollout = roll(maker)  # a random model writes no JSON
    assert not rollout.readable.any()
    assert rollout.scores.tolist() == [-2] * 12
    assert rollout.rewards.trajectory.sum() == rollout.rewards.first.sum() == 0
    assert not rollout.varied.any()
    # one that writes it is read, and its own place is no waypoint of it
    states = maker.visited.draw(np.arange(4))
    right = maker.visited.maker.make(states).answer
    answers = rollout.asked.answers.clone()
    answers[::GROUP] = right
    asked = Asked(
        rollout.asked.rows, rollout.asked.pictures, rollout.asked.ids, answers,
        maker.visited.maker.actions(answers), rollout.asked.entropy,
    )  # fmt: skip
    mixed = maker.score(asked, maker.walk(asked))
    assert mixed.readable.tolist() == [True, False, False] * 4
    assert (mixed.scores[::GROUP] > 1.49).all()
    assert mixed.mask[::GROUP].all()  # the end token counts
    slots, _ = open_maker("json", sampling="slots")
    assert roll(slots).readable.all()


def test_groups_without_variance_are_left_out_of_the_loss(open_maker, monkeypatch) -> None:
    """What is judged is the task's reward: answers that differ by their shaping alone are alike."""
    maker, _ = open_maker(drop_uniform=True)
    plain = roll(maker)
    old = torch.zeros(plain.mask.shape)
    assert torch.equal(maker.batch(plain, old).mask, plain.mask)
    judge = rollouts.score_answers

    def shape_one(*args, **options):
        found = judge(*args, **options)
        group = slice(GROUP, 2 * GROUP)
        found.trajectory[group], found.first[group] = 0.25, 1
        found.total[group] = torch.tensor([0.75, 0.5, 0.25], dtype=torch.float64)
        return found

    monkeypatch.setattr(rollouts, "score_answers", shape_one)
    rollout = maker.score(plain.asked, maker.walk(plain.asked))
    assert rollout.varied.tolist() == [True, False, True, True]
    batch = maker.batch(rollout, old)
    assert batch.mask.any(1).tolist() == [True] * 3 + [False] * 3 + [True] * 6
    told = maker.measure(rollout)
    assert float(told["groups_dropped"]) == float(told["groups_uniform"]) == 0.25
    some = rollout.join(plain).pick(torch.tensor([1, 4]))
    assert some.varied.tolist() == [False, True]
    assert torch.equal(some.scores[GROUP:], plain.scores[:GROUP])
    assert torch.equal(some.asked.answers[:GROUP], plain.asked.answers[GROUP : 2 * GROUP])


def test_long_answers_are_punished_evenly(open_maker) -> None:
    maker, pupil = open_maker("json", overlong=4)
    whole = len(pupil.slots)
    asked = maker.ask(np.arange(4), 0)
    assert asked.answers.shape[1] == whole + 4
    answers = torch.full_like(asked.answers, pupil.slots.vocabulary.number)
    for row, length in enumerate((5, whole, whole + 1, whole + 3)):
        answers[row, length - 1] = pupil.slots.vocabulary.end
    own = Asked(
        asked.rows, asked.pictures, asked.ids, answers, asked.actions, asked.entropy,
    )  # fmt: skip
    rollout = maker.score(own, maker.walk(own))
    assert rollout.mask.sum(1).tolist()[:5] == [5, whole, whole + 1, whole + 3, whole + 4]
    assert rollout.overlong.tolist()[:5] == [0, 0, 0.25, 0.75, 1]
    assert rollout.scores.tolist()[:5] == [-2, -2, -2.25, -2.75, -3]
    with pytest.raises(ConfigError, match="too long"):
        open_maker("compact", overlong=4)
