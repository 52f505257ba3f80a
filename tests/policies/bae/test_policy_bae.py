"""A checkpoint as a policy: the protocol, torch and NumPy alike, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the policy's model needs gn0[train]")
pytest.importorskip("transformers", reason="the policy's model needs gn0[train]")

from gn0.bench.results import load_results  # noqa: E402
from gn0.bench.runner import run_suite  # noqa: E402
from gn0.data.answer_slots import ACTION  # noqa: E402
from gn0.errors import CheckpointError, ConfigError, PolicyError  # noqa: E402
from gn0.geometry import Pose2D  # noqa: E402
from gn0.plugins import build_plugin  # noqa: E402
from gn0.policies.bae.checkpoint import load_checkpoint, save_checkpoint  # noqa: E402
from gn0.policies.bae.engines import open_engine  # noqa: E402
from gn0.policies.bae.forward import ForwardConstant  # noqa: E402
from gn0.policies.bae.policy_bae import PolicyBae  # noqa: E402
from gn0.policies.bae.policy_settings import (  # noqa: E402
    FILE,
    load_policy_settings,
    save_policy_settings,
)
from gn0.policies.bae.questions import Questions, list_allowed  # noqa: E402
from gn0.sim.state import Action, Observation  # noqa: E402
from gn0.testing.policy_check import check_policy  # noqa: E402


def observe(seed: int, collided: bool = False, width: int = 64) -> Observation:
    stream = np.random.default_rng(seed)
    picture = stream.integers(0, 256, (32, width, 3), dtype=np.uint8)
    pose = Pose2D(*stream.uniform(-3, 3, 3))
    return Observation(0, 0.0, "", pose=pose, collided=collided, more={"ego_map": picture})


def begin(policy: PolicyBae, count: int = 1) -> None:
    rngs = [np.random.default_rng(0)] * count
    policy.reset_batch(range(count), ["go to the sofa"] * count, rngs)


class Said:
    """Says what it is told to: an engine."""

    name, batch = "script", 1

    def __init__(self, policy: PolicyBae, answers: list[str]) -> None:
        self.slots, self.answers, self.asked = policy.questions.slots, answers, 0
        self.drawn: list[bool] = []

    def answer(self, pictures, prompts, draws=None):
        """The next answer: six letters of S F L R; anything else is unreadable."""
        ids = np.where(self.slots.ids < 0, self.slots.vocabulary.number, self.slots.ids)
        said = self.answers[self.asked]
        self.drawn.append(draws is not None and bool((draws >= 0).all()))
        self.asked += 1
        codes = ["SFLR".find(letter) for letter in said]
        ids[self.slots.kinds == ACTION] = [self.slots.vocabulary.actions[c] if c >= 0 else 0
                                           for c in codes]  # fmt: skip
        return ids[None].astype(np.int64)


def follow(checkpoint: Path, answers: list[str], steps: int, **options) -> tuple[str, PolicyBae]:
    policy = PolicyBae(str(checkpoint), backend="numpy", **options)
    policy._engine = Said(policy, answers)
    begin(policy)
    done = ""
    for step in range(steps):
        done += "SFLR"[policy.act_batch([0], [observe(step)])[0]]
    assert policy._engine.asked == len(answers)
    return done, policy


@pytest.mark.parametrize("backend", ["torch", "numpy"])
def test_it_keeps_the_protocol(checkpoint: Path, backend: str, monkeypatch) -> None:
    settings = load_policy_settings(checkpoint)
    from gn0.testing import policy_check

    opened = policy_check.open_simulator
    monkeypatch.setattr(
        policy_check, "open_simulator", lambda *a, **k: opened(*a, **k, map_view=settings.view)
    )
    check_policy(lambda: PolicyBae(str(checkpoint), backend=backend), max_steps=9)
    if backend == "torch":
        check_policy(lambda: PolicyBae(str(checkpoint), backend=backend, batch=3), max_steps=9)


def test_torch_and_numpy_answer_alike(checkpoint: Path) -> None:
    one, other = (PolicyBae(str(checkpoint), backend=b, executed=1) for b in ("torch", "numpy"))
    begin(one, 8)
    begin(other, 8)
    for turn in range(3):
        seen = [observe(100 * turn + k, collided=k % 2 == 1) for k in range(8)]
        assert one.act_batch(range(8), seen) == other.act_batch(range(8), seen)
    assert one.sensors == {"ego_map", "pose"}
    assert one.identity()["checkpoint"] == other.identity()["checkpoint"]
    assert dict(one.card_rows)["computed by"] == "torch, float32 on cpu"
    assert dict(other.card_rows)["computed by"] == "NumPy, float32"


def test_three_of_six_actions_are_carried_out_and_a_stop_ends_an_answer(checkpoint: Path) -> None:
    assert follow(checkpoint, ["FFLRRR", "LLLFFF"], 6)[0] == "FFLLLL"
    assert follow(checkpoint, ["FFLRRR"], 6, executed=6)[0] == "FFLRRR"
    assert follow(checkpoint, ["FSLRRR"], 2)[0] == "FS"


def test_answers_are_drawn_where_an_agent_gets_nowhere(checkpoint: Path) -> None:
    answers = ["LLL", "RRR", "LLL", "FFF", "FRR", "RRR", "LLS"]
    done, policy = follow(checkpoint, [a + "LLL" for a in answers], 21, draw_after=6)
    assert done == "".join(answers)
    assert policy._engine.drawn == [False, False, True, True, False, False, False]
    assert policy.notes_of(0) == {"answers drawn": 2}
    assert "drawn after 6 actions" in dict(policy.card_rows)["answers"]
    assert policy.identity()["draw_after"] == 6
    assert "draw_after" not in PolicyBae(str(checkpoint), backend="numpy").identity()
    with pytest.raises(ConfigError, match="drawn after -2 actions"):
        PolicyBae(str(checkpoint), backend="numpy", draw_after=-2)


def test_a_forward_that_is_cut_short_gets_nowhere(checkpoint: Path) -> None:
    policy = PolicyBae(str(checkpoint), backend="numpy", draw_after=3)
    policy._engine = Said(policy, ["FFFLLL"] * 3)
    begin(policy)
    for step in range(9):
        policy.act_batch([0], [observe(step, collided=step > 3)])
    assert policy._engine.drawn == [False, False, True]


def test_a_stop_behind_the_first_action_is_asked_again_on_request(checkpoint: Path) -> None:
    done, policy = follow(checkpoint, ["FSFFFF", "LFSFFF", "SFFFFF"], 4, confirm_stop=True)
    assert done == "FLFS"
    assert policy.notes_of(0) == {"stops asked again": 2}
    assert policy.identity()["confirm_stop"] == "true"


def test_waypoints_are_followed_on_request_and_stop_where_the_first_action_does(
    checkpoint: Path, tmp_path: Path
) -> None:
    """All points lie in the far left corner of the map, two turns and a half away."""
    done, policy = follow(checkpoint, ["RRRRRR", "SRRRRR"], 4, carried="waypoints")
    assert done in ("LLFS", "LLLS")
    assert policy.identity()["carried"] == "waypoints"
    assert "along the answer's waypoints" in dict(policy.card_rows)["actions carried out"]
    assert "carried" not in follow(checkpoint, ["F" * 6], 1)[1].identity()
    with pytest.raises(ConfigError, match="'legs' of answers with 13 waypoints"):
        PolicyBae(str(checkpoint), backend="numpy", carried="legs")
    without = shutil.copytree(checkpoint, tmp_path / "without")
    settings = load_policy_settings(checkpoint)
    form = msgspec.structs.replace(settings.form, points=0)
    save_policy_settings(without, msgspec.structs.replace(settings, form=form))
    with pytest.raises(ConfigError, match="with 0 waypoints"):
        PolicyBae(str(without), backend="numpy", carried="waypoints")


def test_unreadable_answers_turn_once_and_stop_after_three_in_a_row(checkpoint: Path) -> None:
    answers = ["??????", "FFFFFF", "FF?FFF", "??????", "??????"]
    done, policy = follow(checkpoint, answers, 7, decoding="free")
    assert done == "LFFFLLS"
    assert policy.notes_of(0) == {"unreadable answers": 4}


def test_free_answers_of_an_untrained_model_are_counted(checkpoint: Path) -> None:
    policy = PolicyBae(str(checkpoint), backend="numpy", decoding="free")
    begin(policy)
    done = [policy.act_batch([0], [observe(k)])[0] for k in range(3)]
    assert done == [Action.LEFT, Action.LEFT, Action.STOP]
    assert policy.notes_of(0) == {"unreadable answers": 3}


@pytest.mark.parametrize("draw_after", [0, 2])
def test_the_benchmark_runs_it_the_same_alone_and_side_by_side(
    checkpoint: Path, flats_suite, tmp_path: Path, worker_here: None, draw_after: int
) -> None:
    torch.manual_seed(0)
    made = load_checkpoint(checkpoint)
    with torch.no_grad():
        for weight in made.model.parameters():  # else it stops at once
            weight.add_(0.1 * torch.randn_like(weight))
    folder = tmp_path / "walker"
    save_checkpoint(folder, made)
    shutil.copy(checkpoint / FILE, folder)
    options = {"checkpoint": str(folder), "backend": "torch", "draw_after": draw_after}
    outputs = []
    for agents in (1, 3):
        out = tmp_path / str(agents)
        summary = run_suite(
            flats_suite, "bae", out, agents=agents, policy_options=options, max_episodes=3
        )
        outputs.append([(out / n).read_bytes() for n in ("results.jsonl", "trajectories.jsonl")])
    assert outputs[0] == outputs[1]
    results = load_results(tmp_path / "1")
    assert len(results) == 3 and max(one.metrics.steps for one in results if one.metrics) > 3
    assert any("answers drawn" in (one.notes or {}) for one in results) == (draw_after > 0)
    card = dict(summary.protocol)
    assert card["actions carried out"] == "3 of 6"
    assert card["prompt parts"].startswith("task, instruction, current_pixel, heading")


def test_a_checkpoint_that_is_none_is_refused(checkpoint: Path, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no such checkpoint"):
        build_plugin("policy", "bae", {"checkpoint": str(tmp_path / "nowhere")})
    broken = tmp_path / "broken"
    for missing in ("policy.json", "tokenizer.json", "config.json", "model.safetensors"):
        shutil.rmtree(broken, ignore_errors=True)
        shutil.copytree(checkpoint, broken)
        (broken / missing).unlink()
        for backend in ("numpy", "torch"):
            with pytest.raises(CheckpointError):
                PolicyBae(str(broken), backend=backend)
    with pytest.raises(ConfigError, match="backend"):
        PolicyBae(str(checkpoint), backend="jax")
    with pytest.raises(ConfigError, match="1 to 6"):
        PolicyBae(str(checkpoint), backend="numpy", executed=7)


def test_other_pictures_and_texts_than_trained_on_are_refused(checkpoint: Path) -> None:
    policy = PolicyBae(str(checkpoint), backend="numpy")
    begin(policy)
    with pytest.raises(PolicyError, match=r"'near' is 256×32 px, .* 32×32 px"):
        policy.act_batch([0], [observe(0, width=256)])
    with pytest.raises(PolicyError, match="'near' is missing"):
        policy.act_batch([0], [without_maps(observe(0))])
    with pytest.raises(PolicyError, match="slot 4"):
        policy.act_batch([4], [observe(0)])
    for text, said in (("x" * 10_000, "characters"), ("<FWD><STOP>", "says nothing"),
                       ("", "says nothing"), ("far " * 200, "at most 64 are read")):  # fmt: skip
        with pytest.raises(ConfigError, match=said):
            policy.reset_batch([0], [text], [np.random.default_rng(0)])


def without_maps(seen: Observation) -> Observation:
    return Observation(0, 0.0, "", pose=seen.pose)


@pytest.mark.slow
def test_2000_greedy_answers_of_numpy_are_those_of_torch(checkpoint: Path) -> None:
    """Where they differ, torch holds both of the first tokens that do for equally probable."""
    count, batch = 2000, 100
    questions = Questions(checkpoint)
    numpy, plain = (
        open_engine(questions, backend, "cpu", "float32", batch) for backend in ("numpy", "torch")
    )
    allowed = list_allowed(questions.slots, questions.settings.frame)
    model = load_checkpoint(checkpoint).model
    forward = ForwardConstant(model, questions.layout, len(allowed))
    stream = np.random.default_rng(0)
    equal, distinct = 0, set()
    for _ in range(count // batch):
        pictures = [
            stream.integers(0, 256, (batch, size.height, size.width, 3), dtype=np.uint8)
            for size in questions.layout.sizes
        ]
        ids = np.stack([
            questions.fill("go to the sofa", int(stream.integers(-1, 4)), stream.random() < 0.3,
                           float(stream.uniform(-3, 3))) for _ in range(batch)
        ])  # fmt: skip
        one, other = numpy.answer(pictures, ids), plain.answer(pictures, ids)
        same = (one == other).all(1)
        equal += int(same.sum())
        distinct |= set(map(bytes, other))
        for row in np.flatnonzero(~same):
            slot = int(np.argmax(one[row] != other[row]))
            with torch.no_grad():
                features = forward.encode([torch.from_numpy(p[row : row + 1]) for p in pictures])
                told = torch.from_numpy(ids[row : row + 1]), torch.from_numpy(other[row : row + 1])
                logits = forward.logits(features, *told)[0, slot]
            assert abs(float(logits[one[row, slot]] - logits[other[row, slot]])) < 1e-4
    assert len(distinct) > count / 4  # they hang on what is shown
    assert equal >= 0.999 * count


def test_torch_and_numpy_are_as_sure_of_an_answer(checkpoint: Path) -> None:
    one, other = (PolicyBae(str(checkpoint), backend=b) for b in ("torch", "numpy"))
    for policy in (one, other):
        begin(policy)
        policy.act_batch([0], [observe(7)])
    pictures, said = one.questions.show(observe(7)), one.last_said(0)
    assert said is not None
    mine, theirs = (policy.weigh(pictures, said.prompt, said.answer) for policy in (one, other))
    assert set(mine) == set(theirs) and len(mine) == 30  # 24 coordinates and 6 actions
    slots = one.questions.slots
    for slot, shares in mine.items():
        np.testing.assert_allclose(shares, theirs[slot], atol=1e-5)
        assert slots.allowed(slot)[shares.argmax()] == said.answer[slot]
