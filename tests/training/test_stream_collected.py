"""States that are gathered once: every one once an epoch, and nothing lost by a stop on the way."""

from __future__ import annotations

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")
from gn0.errors import ConfigError, FormatError, SimError  # noqa: E402
from gn0.training.streams.step_ring import StepRing  # noqa: E402
from gn0.training.streams.stream_collected import StreamCollected  # noqa: E402
from gn0.training.streams.stream_live import StreamLive  # noqa: E402

FIELDS = ("episode", "pose", "last", "collided", "actions", "waypoints", "distance")


def tell(states) -> bytes:
    """All bytes of states."""
    arrays = [getattr(states, name) for name in FIELDS]
    arrays += [states.pictures[name] for name in sorted(states.pictures)]
    return b"".join(array.contiguous().numpy().tobytes() for array in arrays)


def wander(states):
    """A policy that goes by what it sees."""
    sums = states.pictures["near"].flatten(1).sum(1)
    return torch.stack([(sums + k) % 4 for k in (0, 1, 1)], 1)


@pytest.fixture
def make(make_env):
    """Makes streams of 40 states that three agents gather."""

    def build(states: int = 40, driver=wander, views: bool = False) -> StreamCollected:
        env = make_env(3, ("rgb", "ego_map") if views else ("ego_map",))
        live = StreamLive(env, StepRing(env, 17), seed=5, driver=driver)
        return StreamCollected(live, states, seed=5, dark=0.1)

    return build


def test_an_epoch_has_every_state_once(make) -> None:
    stream = make()
    orders = [stream.order(k, 16) for k in range(0, 120, 16)]  # batches end in mid-epoch
    numbers = np.concatenate(orders)[:120].reshape(3, 40)
    for epoch in numbers:
        assert sorted(epoch) == list(range(40))
    assert (numbers[0] != numbers[1]).any() and (numbers[1] != numbers[2]).any()


def test_states_that_are_alike_count_once(make) -> None:
    stream = make()
    stream.collect()
    drawn = [stream.draw(8) for _ in range(5)]
    own = {
        (number, *(round(1000 * value) for value in pose))
        for one in drawn
        for number, pose in zip(one.episode.tolist(), one.pose.tolist(), strict=True)
    }
    assert stream.count_variety() == (len(own), len({number for number, *_ in own}))
    assert len(own) < 40  # whoever turns to and fro comes back


def test_samples_are_the_states_of_the_first_steps(make) -> None:
    stream = make()
    stream.collect()
    assert stream.whole and stream.live.ring.count == stream.steps == 14
    kept = stream.live.ring["pose"].flatten(0, 1)[:40]
    drawn = torch.cat([stream.draw(8).pose for _ in range(5)])
    assert sorted(map(tuple, drawn.tolist())) == sorted(map(tuple, kept.tolist()))


@pytest.mark.parametrize(
    ("stop", "views"), [(5, False), pytest.param(11, True, marks=pytest.mark.slow)]
)
def test_collecting_goes_on_where_it_was_stopped(make, stop: int, views: bool) -> None:
    """In mid-plan of the policy, too: the same states, the same counts, the same order."""
    whole = make(views=views)
    counts = whole.collect()
    assert counts.steps == 42 and 0 < counts.asked <= 42

    class StoppedError(Exception):
        pass

    kept = {}
    half = make(views=views)

    def save() -> None:
        kept.update(json.loads(json.dumps(half.state())))
        raise StoppedError

    with pytest.raises(StoppedError):
        half.collect(save, every=stop)
    again = make(views=views)
    again.restore(kept)
    assert again.live.ring.count == stop and not again.whole
    assert again.collect() == counts
    told = [tell(whole.draw(16)) for _ in range(4)]
    assert [tell(again.draw(16)) for _ in range(2)] == told[:2]
    late = make(driver=None, views=views)  # nobody drives any more: all is in the log
    late.restore(json.loads(json.dumps(again.state())))
    assert [tell(late.draw(16)) for _ in range(2)] == told[2:]


def test_an_expert_gathers_as_many(make) -> None:
    stream = make(driver=None)
    counts = stream.collect()
    assert counts.steps == 42 and counts.asked == 0
    assert len(stream.draw(40)) == 40


def test_what_does_not_fit_is_refused(make) -> None:
    stream = make()
    with pytest.raises(SimError, match="before all are there"):
        stream.draw(4)
    with pytest.raises(ConfigError, match="ring that keeps 51"):
        make(52)
    with pytest.raises(ConfigError, match="41 states were collected, here are 40"):
        stream.restore({"states": 41, "drawn": 0, "walks": {}})
    with pytest.raises(FormatError, match="no state of collected states"):
        stream.restore({"states": 40})
