"""Learning of policies that remember: losses by hand, rounds, and what is played in closed loop."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.bench.results import load_results  # noqa: E402
from gn0.bench.runner import run_suite  # noqa: E402
from gn0.policies.bae.tokenizer import train_tokenizer  # noqa: E402
from gn0.policies.bae.tokenizer_file import TokenizerFile  # noqa: E402
from gn0.policies.cma.cma_checkpoint import (  # noqa: E402
    CmaCheckpoint,
    build_net,
    load_cma_checkpoint,
    save_cma_checkpoint,
)
from gn0.policies.cma.cma_settings import SIZES, CmaSettings  # noqa: E402
from gn0.sim.ego_map import EgoSquare, MapView  # noqa: E402
from gn0.training.exams.recurrent_examination import ClosedLoopRecurrent  # noqa: E402
from gn0.training.recurrent_learner import (  # noqa: E402
    DriverNet,
    RecurrentLearner,
    RecurrentRecipe,
    WordTable,
    judge_stretch,
    look,
    weigh_turns,
)
from gn0.training.recurrent_stage import RoundPlan  # noqa: E402
from gn0.training.streams.stream_walks import StreamWalks, Stretch  # noqa: E402

VIEW = MapView(squares=(EgoSquare(32, 0.24, content="occupancy"),))
RECIPE = RecurrentRecipe(rate=3e-3, warm_steps=10, tail=0.5)


def make_net(texts, seed: int = 0, **chosen):
    words = train_tokenizer(texts, 40).backend_tokenizer
    own = {
        "sizes": SIZES["nano"], "text_length": 24, "vocabulary": words.get_vocab_size(),
        "view": VIEW, "pictures": ("near",),
    }  # fmt: skip
    return build_net(CmaSettings(**(own | chosen)), seed), words


def make_stretch(turns, expert, progress) -> Stretch:
    size = torch.tensor(expert).shape
    nothing = torch.zeros(size, dtype=torch.int64)
    return Stretch({}, nothing, nothing, torch.tensor(expert), torch.tensor(turns),
                   torch.tensor(progress))  # fmt: skip


def test_a_walk_is_the_mean_over_its_weights_and_turns_weigh_more() -> None:
    turns = [[True, True], [False, True], [True, False]]
    weights = weigh_turns(torch.tensor(turns), 3.2)
    np.testing.assert_allclose(weights, [[3.2, 3.2], [1, 3.2], [3.2, 1]], rtol=1e-6)
    stretch = make_stretch(turns, [[1, 1], [1, 2], [0, 2]], [[0.0, 0.0], [0.5, 1.0], [np.nan, 1.0]])
    logits = torch.log(torch.tensor([
        [[0.1, 0.6, 0.2, 0.1], [0.1, 0.6, 0.2, 0.1]],
        [[0.2, 0.5, 0.2, 0.1], [0.7, 0.1, 0.1, 0.1]],
        [[0.4, 0.2, 0.2, 0.2], [0.1, 0.1, 0.7, 0.1]],
    ]))  # fmt: skip
    believed = torch.tensor([[0.1, 0.0], [0.5, 0.0], [7.0, 1.0]])
    found = judge_stretch(logits, believed, stretch, RecurrentRecipe(progress_weight=2.0))
    first = (3.2 * -np.log(0.6) - np.log(0.5) + 3.2 * -np.log(0.4)) / 7.4
    other = (3.2 * -np.log(0.6) + 3.2 * -np.log(0.1) - np.log(0.7)) / 7.4
    assert found.actions.item() == pytest.approx((first + other) / 2, rel=1e-5)
    assert found.progress.item() == pytest.approx((0.01 + 1) / 5, rel=1e-5)  # five are known
    assert found.loss.item() == pytest.approx((first + other) / 2 + 2 * 1.01 / 5, rel=1e-5)
    assert found.right.item() == pytest.approx(5 / 6)
    assert found.right_turns.item() == pytest.approx(3 / 4)


def test_samples_are_shared_out_among_rounds() -> None:
    plan = RoundPlan(samples=1000, rounds=3, forced=0.4)
    assert plan.count_steps(10) == 100
    assert plan.count_steps(33) == 31
    rounds = [plan.find_round(step, 100) for step in range(1, 101)]
    assert [rounds.count(k) for k in range(4)] == [40, 20, 20, 20]
    assert rounds == sorted(rounds)
    alone = RoundPlan(samples=10, rounds=0)
    assert {alone.find_round(step, 10) for step in range(1, 11)} == {0}
    assert [plan.find_round(step, 2) for step in (1, 2)] == [0, 1]
    assert plan.find_round_at(1e9) == 0  # no limit


def test_so_is_the_time_where_minutes_are_given() -> None:
    plan = RoundPlan(samples=10**9, minutes=10, rounds=3, forced=0.4)
    rounds = [plan.find_round_at(60 * minute) for minute in np.arange(0.05, 10, 0.1)]
    assert [rounds.count(k) for k in range(4)] == [40, 20, 20, 20]
    assert rounds == sorted(rounds)
    assert plan.find_round_at(60 * 11) == 3
    assert RoundPlan(minutes=10, rounds=0).find_round_at(500) == 0
    assert RoundPlan(minutes=10, forced=1).find_round_at(599) == 0
    assert RoundPlan(minutes=10, forced=0, rounds=2).find_round_at(0) == 1


def test_each_text_of_a_stretch_is_read_once_and_as_a_driver_reads_it() -> None:
    texts = ["go to the sofa", "leave the room", "go to the sofa", "turn left at the table"]
    net, words = make_net(texts)
    table = WordTable(TokenizerFile(words), texts, 24, "cpu")
    assert table.row_of.tolist() == [0, 1, 0, 2]
    asked = torch.tensor([3, 0, 2, 2, 3])
    found = table.read(net, asked)
    every = table.read_all(net)
    assert found is not None and every is not None
    torch.testing.assert_close(found.states, every.pick(table.row_of[asked]).states)
    torch.testing.assert_close(found.last, every.pick(table.row_of[asked]).last)
    assert found.there.sum(1).tolist() == [table.counts[k] for k in (2, 0, 0, 0, 2)]
    blind, _ = make_net(texts, words=False)
    assert table.read(blind, asked) is None and table.read_all(blind) is None


@pytest.mark.parametrize("pictures", [("rgb", "depth", "near"), ()])
def test_encoders_can_be_compiled_as_a_whole(pictures) -> None:
    """Traced without a compiler: nothing in them breaks the graph, and they see the same."""
    net, _ = make_net(["go"], pictures=pictures)
    draws = torch.manual_seed(0)
    shown = {
        "rgb": torch.randint(0, 256, (5, 128, 128, 3), dtype=torch.uint8, generator=draws),
        "depth": torch.rand((5, 128, 128), generator=draws) * 9,
        "near": torch.randint(0, 256, (5, 32, 32, 3), dtype=torch.uint8, generator=draws),
    }
    see = torch.compile(net.see, backend="eager", fullgraph=True, dynamic=False)
    given = [shown[name] for name in pictures]
    plain, found = look(net, given, torch.bfloat16), look(net, given, torch.bfloat16, see)
    assert len(found) == len(pictures)
    for one, other in zip(plain, found, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_what_is_learned_from_is_what_would_be_done(make_env) -> None:
    """Stretch by stretch the learner goes through the same states as the driver, step by step."""
    env = make_env(2, sensors=("rgb", "depth", "ego_map"), map_view=VIEW)
    texts = [episode.instruction for episode in env.episodes]
    net, words = make_net(texts, pictures=("rgb", "depth", "near"))
    table = WordTable(TokenizerFile(words), texts, 24, "cpu")
    stream = StreamWalks(env, net.settings.pictures, VIEW, 6, seed=0)
    stream.begin(0, [])
    learner = RecurrentLearner(net, table, 2, RECIPE)
    driver = DriverNet(net, table, 2, None)
    for _ in range(3):
        stretch = stream.draw()
        with torch.no_grad():
            learner.judge(stretch)
        for t in range(6):
            shown = [stretch.pictures[name][t] for name in net.settings.pictures]
            driver.choose(shown, stretch.texts[t], stretch.last[t])
        torch.testing.assert_close(learner.memory, driver.memory, atol=1e-5, rtol=1e-4)
    learner.forget()
    assert not learner.memory.any()


def test_it_plays_what_the_benchmark_plays(flats_suite, tmp_path: Path, worker_here, own_cache,
                                           monkeypatch) -> None:  # fmt: skip
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    from gn0.device.host import DeviceHost
    from gn0.sim.device_env import VectorEnvDevice

    texts = [episode.instruction for episode in flats_suite.episodes]
    net, words = make_net(texts, preset="gn_bench", text_length=64)
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(2)
        net.choose.weight.add_(3 * torch.randn_like(net.choose.weight))
        net.choose.bias.copy_(torch.tensor([-1.0, 1.0, 0.0, 0.0]))
    folder = tmp_path / "policy"
    save_cma_checkpoint(folder, CmaCheckpoint(net, words.to_str().encode()))
    run_suite(flats_suite, "cma", tmp_path / "run", policy_options={"checkpoint": str(folder)})
    theirs = {one.episode: one.metrics for one in load_results(tmp_path / "run")}
    env = VectorEnvDevice(
        4, suite=flats_suite.folder, device=DeviceHost(), sensors=("ego_map",), map_view=VIEW
    )
    loaded = load_cma_checkpoint(folder).model
    walks = ClosedLoopRecurrent(env, loaded, TokenizerFile(words)).play()
    assert len(walks) == len(theirs) == 12
    for walk in walks:
        metrics = theirs[walk.episode]
        assert metrics is not None
        assert (walk.steps, walk.success) == (metrics.steps, metrics.success)
        assert walk.length == pytest.approx(metrics.trajectory_length, abs=1e-6)


@pytest.mark.parametrize("graph", ["cma", "seq2seq"])
def test_it_learns_to_do_what_it_was_told_step_by_step(graph) -> None:
    """Blind, it must read, count its steps from stretch to stretch, and begin anew with a walk."""
    texts = ["go to the sofa", "go to the table", "go to the door"]
    walks = torch.tensor([[1, 2, 1, 3, 0], [1, 1, 3, 2, 0], [2, 2, 1, 1, 0]])
    net, words = make_net(texts, graph=graph, pictures=())
    table = WordTable(TokenizerFile(words), texts, 24, "cpu")
    learner = RecurrentLearner(net, table, 8, RECIPE)
    agents = torch.arange(8)
    right, losses = [], []
    for step in range(160):
        at = torch.arange(7 * step, 7 * step + 7)[:, None] + agents
        number, t = at // 5, at % 5
        told = (number * (agents + 1) + agents) % 3
        last = torch.where(t == 0, -1, walks[told, t - 1])
        unknown = torch.full(t.shape, torch.nan)
        stretch = Stretch({}, told, last, walks[told, t], torch.ones_like(t).bool(), unknown)
        found, _ = learner.step(stretch, min(1.0, (step + 1) / 10))
        right.append(float(found.right))
        losses.append(float(found.loss.detach()))
    assert min(right[-5:]) == 1
    assert np.mean(losses[-5:]) < 0.15 < np.mean(losses[:5]) - 1


@pytest.mark.slow
@pytest.mark.parametrize("graph", ["cma", "seq2seq"])
def test_it_learns_eight_walks_by_heart_and_walks_them(graph, make_env) -> None:
    """In 400 updates at most: how soon the loss falls hangs on seed and processor."""
    view = MapView(squares=(EgoSquare(32, 0.15),))
    env = make_env(8, sensors=("ego_map",), map_view=view)
    texts = [episode.instruction for episode in env.episodes]
    net, words = make_net(texts, view=view, graph=graph)
    table = WordTable(TokenizerFile(words), texts, 24, "cpu")
    stream = StreamWalks(env, net.settings.pictures, view, 16, seed=0)
    stream.begin(0, [])
    learner = RecurrentLearner(net, table, 8, RECIPE)
    losses, end = [], 400
    for step in range(400):
        found, _ = learner.step(stream.draw(), min(1.0, (step + 1) / 10, (end + 10 - step) / 40))
        losses.append(float(found.loss.detach()))
        if np.mean(losses[-10:]) < 0.04 * losses[0]:
            end = min(end, step + 40)  # it knows them: the rate falls
        if step == end:
            break
    assert np.mean(losses[-10:]) < 0.1 * losses[0]
    walks = ClosedLoopRecurrent(env, net.eval(), TokenizerFile(words)).play()
    assert len(walks) == 8
    assert np.mean([walk.success for walk in walks]) >= 0.75
