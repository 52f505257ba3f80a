"""The policy in training drives a stream: what is carried out is what the benchmark would do."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.data.answer_form import AnswerForm  # noqa: E402
from gn0.data.answer_slots import ACTION  # noqa: E402
from gn0.errors import ConfigError  # noqa: E402
from gn0.paper import LEFT  # noqa: E402
from gn0.policies.bae.engines import open_engine  # noqa: E402
from gn0.policies.bae.policy_settings import PolicySettings  # noqa: E402
from gn0.policies.bae.questions import Questions  # noqa: E402
from gn0.sim.ego_map import EgoSquare, MapView  # noqa: E402
from gn0.training.policy_driver import open_driver  # noqa: E402
from gn0.training.pupil import Pupil, build_pupil, load_pupil  # noqa: E402
from gn0.training.streams.step_ring import StepRing  # noqa: E402
from gn0.training.streams.stream_live import StreamLive  # noqa: E402

VIEW = MapView(squares=(EgoSquare(32, 0.24), EgoSquare(16, 0.5)))
SETTINGS = PolicySettings(
    prompt="short", pictures=("near",), form=AnswerForm(layout="compact"), view=VIEW
)


@pytest.fixture(scope="module")
def walker(rooms, tmp_path_factory) -> tuple[Pupil, Path]:
    """A pupil of random weights in training, and its checkpoint."""
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    texts = [episode.instruction for episode in rooms[1]]
    pupil = build_pupil("nano", SETTINGS, texts, seed=3)
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        for weight in pupil.model.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    folder = tmp_path_factory.mktemp("walker") / "checkpoint"
    pupil.save(folder)  # bfloat16: what drives is what was saved
    loaded = load_pupil(folder)
    loaded.model.train()
    return loaded, folder


def _open(make_env, pupil: Pupil, agents: int = 3, **settings) -> StreamLive:
    env = make_env(agents, ("ego_map",), map_view=VIEW)
    texts = [episode.mission.instruction for episode in env.episodes]
    driver = open_driver(pupil, agents).enter(pupil.maker(texts, "cpu"))
    ring = StepRing(env, 20, names=["near", "far"])
    return StreamLive(env, ring, seed=1, driver=driver, **settings)


def test_agents_do_what_the_policy_answers(make_env, walker) -> None:
    """Three actions of each answer that the torch-free twin gives to the same pictures and words.

    A wrong STOP is always carried out here, so the log is the policy's own but where an episode
    began after a decision.
    """
    pupil, folder = walker
    stream = _open(make_env, pupil, stop_share=1.0)
    questions = Questions(folder)
    engine = open_engine(questions, "numpy", "cpu", "float32", 3)
    spoken = np.flatnonzero(questions.slots.kinds == ACTION)
    codes = {token: code for code, token in enumerate(questions.slots.vocabulary.actions)}
    shown = []
    plain = stream.driver

    def watch(states):
        shown.append(states)
        return plain(states)

    stream.driver = watch
    for _ in range(6):
        stream.step()
    assert len(shown) == 2 and pupil.model.training
    log = stream._log[:6].numpy()
    kept = {name: stream.ring[name].numpy() for name in ("step", "actions")}
    compared, seen = 0, set()
    for decision, states in enumerate(shown):
        ids = np.stack([
            questions.fill(
                stream.texts[states.episode[k]], int(states.last[k]), bool(states.collided[k]),
                float(states.pose[k, 2]),
            )
            for k in range(3)
        ])  # fmt: skip
        said = engine.answer([states.pictures["near"].numpy()], ids)[:, spoken]
        for k in range(3):
            for since in range(3):
                step = 3 * decision + since
                if kept["step"][step, k] < since:  # its episode began after the decision
                    assert log[step, k] == kept["actions"][step, k, 0]
                    continue
                assert log[step, k] == codes[int(said[k, since])]
                compared += 1
                seen.add(int(log[step, k]))
    assert compared >= 12 and len(seen) > 1


def test_it_acts_with_the_weights_of_the_moment(make_env, walker) -> None:
    pupil = load_pupil(walker[1])
    stream = _open(make_env, pupil)
    stream.step()
    states = stream.ring.latest()
    before = stream.driver(states)
    with torch.no_grad():
        kept = [weight.clone() for weight in pupil.model.parameters()]
        for weight in pupil.model.parameters():
            weight.add_(0.5 * torch.sin(torch.arange(weight.numel()).view_as(weight)))
    assert not torch.equal(stream.driver(states), before)

    class Lent:
        """The weights of before, within."""

        def __enter__(self) -> None:
            own = zip(pupil.model.parameters(), kept, strict=True)
            with torch.no_grad():
                self.own = [(w, w.clone(), w.copy_(k))[:2] for w, k in own]

        def __exit__(self, *_) -> None:
            with torch.no_grad():
                for weight, value in self.own:
                    weight.copy_(value)

    lent = open_driver(pupil, 3, weights=Lent).enter(stream.driver.maker)
    assert torch.equal(lent(states), before)
    assert not torch.equal(stream.driver(states), before)


def test_fewer_agents_are_told_the_same_and_too_many_actions_are_refused(make_env, walker) -> None:
    pupil = walker[0]
    stream = _open(make_env, pupil)
    stream.step()
    states = stream.ring.latest()
    told = stream.driver(states)
    assert told.shape == (3, 3)
    assert torch.equal(stream.driver(states.pick(slice(1, 2))), told[1:2])
    with pytest.raises(ConfigError, match="9 of 6 actions"):
        open_driver(pupil, 3, executed=9)


def test_answers_are_drawn_where_it_gets_nowhere_and_a_stream_goes_on(make_env, walker) -> None:
    """Only there, by numbers of the stream's seed; what was stopped in mid-walk says the same."""
    pupil = replace(walker[0], settings=msgspec.structs.replace(SETTINGS, draw_after=2))

    def make() -> StreamLive:
        stream = _open(make_env, pupil, stop_share=0.0, fill=5, ratio=1.0)
        stream.drawing = stream.driver.drawing
        return stream

    stream = make()
    assert (stream.drawing.after, stream.drawing.slots) == (2, len(pupil.slots))
    plain, shown = stream.driver, []

    def watch(states, draws):
        shown.append((states, draws.clone()))
        return plain(states, draws)

    stream.driver = watch
    told, kept = [], None
    for batch in range(8):
        if batch == 6:
            kept = json.loads(json.dumps(stream.state()))
        told.append(stream.draw(6).actions.numpy().tobytes())
    log = stream._log.numpy()
    lost = [bool(row) for _, draws in shown for row in (draws >= 0).all(1)]
    assert any(lost) and not all(lost)
    for states, draws in shown:
        assert (((draws >= 0) & (draws < 1)).all(1) | (draws < 0).all(1)).all()
        first = (states.last < 0) & (draws >= 0).any(1)
        assert not first.any()  # who has just begun is not lost
    greedy = torch.stack([plain(states, torch.full_like(draws, -1)) for states, draws in shown])
    drawn = torch.stack([plain(states, draws) for states, draws in shown])
    differ = (greedy != drawn).any(-1).flatten().tolist()
    assert any(differ) and not any(d and not was for d, was in zip(differ, lost, strict=True))
    other = make()
    other.restore(kept)
    assert [other.draw(6).actions.numpy().tobytes() for _ in range(2)] == told[6:]
    at = slice(stream.ring.count - 6, stream.ring.count)
    assert (other._log.numpy()[at] == log[at]).all()


def test_how_long_one_got_nowhere_is_known_beyond_what_the_ring_holds(make_env, walker) -> None:
    stream, other = (_open(make_env, walker[0]) for _ in range(2))
    for one in (stream, other):
        one.driver = lambda states: torch.full((3, 3), LEFT, dtype=torch.int8)
    for _ in range(50):
        stream.step()
    state = json.loads(json.dumps(stream.state()))
    assert 0 < state["base"] <= 30  # the ring holds 20
    other.restore(state)
    assert stream._idle.tolist() == other._idle.tolist() == [50, 50, 50]


def test_who_gets_nowhere_is_driven_by_the_expert_until_it_does(make_env, walker) -> None:
    """An agent that only turns is rescued each time; one that follows the expert never is."""

    def walk(answer, **settings) -> tuple[np.ndarray, StreamLive]:
        stream = _open(make_env, walker[0], **settings)
        stream.driver = answer
        experts = []
        for _ in range(20):
            stream.step()
            experts.append(stream.ring["actions"][(stream.ring.count - 1) % 20, :, 0].numpy())
        return np.stack(experts), stream

    def turn(states):
        return torch.full((3, 3), LEFT, dtype=torch.int8)

    experts, stream = walk(turn, rescue=6)
    log = stream._log.numpy()[:20]
    assert (log[:6] == LEFT).all() and (log[6:9] == experts[6:9]).all()  # a decision is three
    counts = stream.tell()
    assert 0 < counts.asked < counts.steps and counts.forwards > 0
    assert walk(turn)[1].tell().forwards == 0
    with pytest.raises(ConfigError, match="rescue -1"):
        walk(turn, rescue=-1)
