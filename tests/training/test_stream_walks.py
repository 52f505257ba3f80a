"""Stretches of walks: what is in them, who drives, and that they go on where they were left."""

from __future__ import annotations

import json

import pytest

torch = pytest.importorskip("torch")

from gn0.errors import ConfigError, FormatError  # noqa: E402
from gn0.paper import LEFT, STOP  # noqa: E402
from gn0.training.streams.stream_walks import StreamWalks, measure_progress  # noqa: E402


class Turner:
    """Always turns left, and counts its steps."""

    def __init__(self, count: int, action: int = LEFT) -> None:
        self.memory, self.action = torch.zeros(count), action
        self.asked: list = []

    def choose(self, pictures, texts, last):
        """All is on one action."""
        self.asked.append((pictures, texts.clone(), last.clone()))
        self.memory += 1
        logits = torch.full((len(texts), 4), -1e9)
        logits[:, self.action] = 0
        return logits


@pytest.fixture
def make_stream(make_env):
    """A stream of N agents who see colour, depth and one map."""
    from gn0.sim.ego_map import EgoSquare, MapView

    view = MapView(squares=(EgoSquare(24, 0.2), EgoSquare(16, 0.5)))

    def make(count: int = 3, steps: int = 5, pictures=("rgb", "depth", "near"), **options):
        shown = {"ego_map" if name == "near" else name for name in pictures}
        env = make_env(count, sensors=tuple(sorted(shown)) or ("goal_vector",))
        return StreamWalks(env, pictures, view, steps, seed=4, **options)

    return make


def copy(stretch):
    names = ("texts", "last", "expert", "turns", "progress")
    found = {name: getattr(stretch, name).clone() for name in names}
    return found | {f"of {n}": one.clone() for n, one in stretch.pictures.items()}


def test_the_expert_walks_whole_episodes_and_each_begins_without_a_past(make_stream) -> None:
    stream = make_stream(3, 24)
    stream.begin(0, [])
    stretch = stream.draw()
    assert {n: tuple(p.shape) for n, p in stretch.pictures.items()} == {
        "rgb": (24, 3, 20, 24, 3), "depth": (24, 3, 20, 24), "near": (24, 3, 24, 24, 3)
    }  # fmt: skip
    assert stretch.pictures["depth"].dtype == torch.float32
    begins = stretch.last < 0
    assert begins[0].all() and begins.sum() > 3
    for agent in range(3):
        for t in range(1, 24):
            before = int(stretch.expert[t - 1, agent])
            if begins[t, agent]:
                assert before == STOP  # the expert ends an episode by STOP alone
                assert stretch.turns[t, agent]
                assert stretch.progress[t, agent] == 0
            else:
                assert stretch.texts[t, agent] == stretch.texts[t - 1, agent]
                assert stretch.last[t, agent] == before  # it drives
                assert stretch.turns[t, agent] == (stretch.expert[t, agent] != before)
    ends = stretch.expert == STOP
    assert (stretch.progress[ends] > 0.3).all()  # the ways are short, STOP within 1 m
    assert len(stream.texts) == len(stream.env.episodes)


def test_progress_is_the_share_of_the_way_that_is_behind() -> None:
    inf = float("inf")
    whole = torch.tensor([4.0, 4.0, 4.0, 4.0, 0.0, inf, 4.0])
    left = torch.tensor([4.0, 1.0, 6.0, 40.0, 0.0, 1.0, inf])
    found = measure_progress(whole.double(), left.double())
    assert found[:4].tolist() == [0.0, 0.75, -0.5, -1.0]
    assert torch.isnan(found[4:]).all()


def test_in_a_round_agents_are_shared_out_and_policies_drive_theirs(make_stream) -> None:
    stream = make_stream(5, 6, beta=lambda number: 0.0)
    drivers = [Turner(2), Turner(1)]
    stream.begin(2, drivers)
    assert [list(range(5))[stream.share(k)] for k in range(3)] == [[0, 3], [1, 4], [2]]
    stretch = stream.draw()
    following = stretch.last[1:]
    for agent in (1, 4, 2):
        assert set(following[:, agent].tolist()) <= {LEFT, -1}
    for agent in (0, 3):
        assert (
            (following[:, agent] == stretch.expert[:-1, agent]) | (following[:, agent] < 0)
        ).all()
    assert len(drivers[0].asked) == 6
    pictures, texts, last = drivers[0].asked[3]
    assert torch.equal(texts, stretch.texts[3, 1::3])
    assert torch.equal(last, stretch.last[3, 1::3])
    assert torch.equal(pictures[0], stretch.pictures["rgb"][3, 1::3])
    with pytest.raises(ConfigError, match="one policy a round"):
        stream.begin(2, drivers[:1])


@pytest.mark.parametrize(("beta", "stops", "own"), [(1.0, 1.0, 0), (0.0, 0.0, 0), (0.0, 1.0, 1)])
def test_the_expert_takes_over_by_chance_and_where_a_policy_stops_too_soon(
    make_stream, beta, stops, own
) -> None:
    stream = make_stream(2, 4, pictures=(), beta=lambda number: beta, stop_share=stops)
    stream.begin(1, [Turner(1, STOP)])
    stretch = stream.draw()
    begun = (stretch.last[1:, 1] < 0).sum()  # episodes that ended at once
    assert (begun == 3) == bool(own)


def test_it_goes_on_where_it_was_left(make_stream) -> None:
    def begun():
        stream = make_stream(3, 7, pictures=("near",), beta=lambda number: 0.5)
        return stream, [Turner(1), Turner(1)]

    stream, drivers = begun()
    stream.begin(2, drivers)
    for _ in range(3):
        stream.draw()
    state, arrays = json.loads(json.dumps(stream.state())), stream.arrays()
    wanted = [copy(stream.draw()) for _ in range(2)]
    other, others = begun()
    other.restore(state, arrays, others)
    for one in wanted:
        found = copy(other.draw())
        for name, array in one.items():
            assert torch.equal(array.nan_to_num(9), found[name].nan_to_num(9)), name
    assert torch.equal(drivers[0].memory, others[0].memory)
    with pytest.raises(FormatError, match="state of walks"):
        other.restore({**state, "round": None}, arrays, others)
    with pytest.raises(ConfigError, match="stretches of 7 steps"):
        make_stream(3, 6, ("near",)).restore(state, arrays, [Turner(1), Turner(1)])
    with pytest.raises(ConfigError, match="places of 3 agents"):
        two = make_stream(2, 7, ("near",))
        short = {name: array[:2] for name, array in arrays.items() if "driver" not in name}
        two.restore({**state, "round": 0}, short, [])


def test_no_steps_are_refused(make_stream) -> None:
    with pytest.raises(ConfigError, match="stretches of 0 steps"):
        make_stream(2, 0)
