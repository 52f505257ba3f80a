"""Evaluation on a device plays what the benchmark plays, and its figures are what they say."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.bench.results import load_results  # noqa: E402
from gn0.bench.runner import run_suite  # noqa: E402
from gn0.data.answer_form import AnswerForm  # noqa: E402
from gn0.device.host import DeviceHost  # noqa: E402
from gn0.errors import ConfigError  # noqa: E402
from gn0.policies.bae.actor import Actor  # noqa: E402
from gn0.policies.bae.policy_settings import PolicySettings  # noqa: E402
from gn0.sim.device_env import VectorEnvDevice  # noqa: E402
from gn0.sim.ego_map import EgoSquare, MapView  # noqa: E402
from gn0.training.exams.evaluation import (  # noqa: E402
    ClosedLoop,
    score_states,
)
from gn0.training.exams.walks import summarise_walks  # noqa: E402
from gn0.training.pupil import Pupil, build_pupil, load_pupil  # noqa: E402
from gn0.training.streams.live_counts import LiveCounts  # noqa: E402

VIEW = MapView(squares=(EgoSquare(32, 0.24, content="occupancy"),))
SETTINGS = PolicySettings(
    prompt="short", pictures=("near",), form=AnswerForm(layout="compact"), view=VIEW
)


@pytest.fixture(scope="module")
def walker(flats_suite, tmp_path_factory: pytest.TempPathFactory) -> tuple[Pupil, Path]:
    """A pupil of random weights, and its checkpoint."""
    texts = [episode.instruction for episode in flats_suite.episodes]
    pupil = build_pupil("nano", SETTINGS, texts, seed=3)
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        for weight in pupil.model.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    folder = tmp_path_factory.mktemp("walker") / "checkpoint"
    pupil.save(folder)  # bfloat16: what is played is what was saved
    return load_pupil(folder), folder


@pytest.fixture(scope="module")
def env(flats_suite) -> VectorEnvDevice:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    return VectorEnvDevice(
        4, suite=flats_suite.folder, device=DeviceHost(), sensors=("ego_map",), map_view=VIEW
    )


@pytest.mark.parametrize("draw_after", [0, 3])
def test_it_plays_what_the_benchmark_plays(
    walker, env, flats_suite, tmp_path: Path, worker_here: None, draw_after: int
) -> None:
    pupil, folder = walker
    options = {"checkpoint": str(folder), "backend": "torch", "draw_after": draw_after}
    run_suite(flats_suite, "bae", tmp_path / "run", policy_options=options)
    theirs = {one.episode: one.metrics for one in load_results(tmp_path / "run")}
    walks = ClosedLoop(env, pupil, draw_after=draw_after).play()
    notes = [one.notes or {} for one in load_results(tmp_path / "run")]
    assert any("answers drawn" in one for one in notes) == (draw_after > 0)
    assert [walk.episode for walk in walks] == [e.id for e in flats_suite.episodes]
    assert len({walk.steps for walk in walks}) > 1
    for walk in walks:
        metrics = theirs[walk.episode]
        assert metrics is not None
        assert (walk.steps, walk.success) == (metrics.steps, metrics.success)
        assert walk.oracle == metrics.oracle_success
        np.testing.assert_allclose(
            (walk.length, walk.left, walk.spl, walk.shortest),
            (metrics.trajectory_length, metrics.navigation_error_geodesic, metrics.spl,
             metrics.shortest_length), atol=1e-6,
        )  # fmt: skip
        assert walk.cut_short == metrics.collisions
    told = summarise_walks(walks)
    assert told["all"]["episodes"] == 12
    assert told["all"]["SR"] == np.mean([one.success for one in theirs.values()])
    assert set(told) == {"all", "goal"}


def test_controls_take_away_what_they_say(walker, env) -> None:
    loop = ClosedLoop(env, walker[0])
    shown: list[int] = []
    asked: list[list[int]] = []
    decide = loop.actor.decide

    def watch(pictures, prompts, draws):
        shown.append(int(pictures[0].max()))
        asked.append(prompts.tolist())
        return decide(pictures, prompts, draws)

    loop.actor.decide = watch  # type: ignore[method-assign]
    loop.play([0, 1])
    told = asked[0][0]
    assert min(shown) > 0
    shown.clear()
    asked.clear()
    loop.play([0, 1], control="no_pictures")
    assert max(shown) == 0
    assert asked[0][0] == told
    asked.clear()
    loop.play([0, 1], control="no_words")
    assert asked[0][0] != told
    with pytest.raises(ConfigError, match="no control"):
        loop.play([0], control="silence")  # type: ignore[arg-type]


def test_every_step_is_held_against_the_expert(walker, env) -> None:
    """By the labels of the places where the walks led, looked up beside the loop."""
    loop = ClosedLoop(env, walker[0], labelled=True)
    said, right = [], []
    step = env.step

    def watch(actions):
        said.append(torch.from_dlpack(actions).clone())
        right.append(torch.from_dlpack(env.labels(1.0).actions)[:, 0].clone())
        return step(actions)

    env.step = watch
    try:
        walks = loop.play([0, 1, 2, 3])
    finally:
        del env.step
    mine, theirs = torch.stack(said), torch.stack(right)
    live = torch.arange(len(mine))[:, None] < torch.tensor([walk.steps for walk in walks])
    counts = loop.counts
    assert counts.steps == counts.asked == int(live.sum())
    assert counts.agreed == int((live & (mine == theirs)).sum())
    assert counts.due == int((live & (theirs == 0)).sum())
    assert counts.stopped == int((live & (mine == 0)).sum()) == sum(w.stopped for w in walks)
    assert counts.stopped_right == int((live & (mine == 0) & (theirs == 0)).sum())
    assert counts.forwards == sum(w.forwards for w in walks) and counts.ended == 4


def test_who_begins_another_episode_is_held_against_the_expert_anew(walker, env) -> None:
    """What is counted of four agents in turn is what is counted of four episodes at a time."""
    loop = ClosedLoop(env, walker[0], labelled=True)
    apart = LiveCounts()
    for begin in (0, 4, 8):
        loop.play(range(begin, begin + 4))
        apart += loop.counts
    loop.play()
    assert loop.counts == apart and apart.ended == 12 and apart.steps > apart.agreed > 0


def test_a_stop_is_asked_again_and_three_actions_are_carried_out(walker, env) -> None:
    pupil = walker[0]
    plain, sure = ClosedLoop(env, pupil), ClosedLoop(env, pupil, confirm_stop=True)
    walks = plain.play([0, 1, 2, 3])
    most = max(walk.steps for walk in walks)
    assert plain.asks == -(-most // 3)
    assert [w.episode for w in sure.play([0, 1, 2, 3])] == [w.episode for w in walks]


def test_states_are_scored_by_free_answers(pupil, draw_states) -> None:
    states = draw_states(10)
    actor = Actor(pupil.model.eval(), pupil.table.layout, pupil.slots, pupil.maker.frame, 4)
    batch = pupil.maker.make(states)
    said = [
        actor.decide([one[k : k + 4] for one in batch.pictures], batch.ids[k : k + 4])
        for k in (0, 4, 8)
    ]
    actions = torch.cat([one.actions for one in said])
    scores = score_states(actor, pupil.maker, states)
    assert scores.states == 10
    right = (actions[:, 0] == states.actions[:, 0]).double().mean()
    assert scores.actions[0] == pytest.approx(float(right))
    last = torch.cat([pupil.maker.waypoints(one.ids) for one in said])[:, -1]
    off = (last - states.waypoints[:, 12]).norm(dim=-1)
    assert scores.last_mean == pytest.approx(float(off.mean()), abs=1e-6)
    taught = replace(states, actions=actions.to(torch.int8))
    assert score_states(actor, pupil.maker, taught).actions == (1.0,) * 6
    assert score_states(actor, pupil.maker, taught).stop_recall in (0.0, 1.0)
    with pytest.raises(ConfigError, match="no states"):
        score_states(actor, pupil.maker, states.pick(slice(0, 0)))
