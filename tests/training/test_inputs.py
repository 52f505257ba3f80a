"""One policy for several inputs: trained on them in turn, asked in any of them."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.data.answer_form import AnswerForm  # noqa: E402
from gn0.errors import CheckpointError, ConfigError  # noqa: E402
from gn0.policies.bae.engines import open_engine  # noqa: E402
from gn0.policies.bae.policy_settings import FILE, PolicySettings  # noqa: E402
from gn0.policies.bae.questions import Questions  # noqa: E402
from gn0.sim.ego_map import EgoSquare, MapView  # noqa: E402
from gn0.training.inputs import InputMixture, read_inputs  # noqa: E402
from gn0.training.learner import Learner, LossForward, open_learner  # noqa: E402
from gn0.training.pupil import Pupil, build_pupil, load_pupil  # noqa: E402
from gn0.training.recipe import Recipe  # noqa: E402
from gn0.training.runs.run_folder import open_run  # noqa: E402
from gn0.training.stage import Stage, StagePlan  # noqa: E402
from gn0.training.tally import Tally  # noqa: E402

torch.set_num_threads(1)
BASE = PolicySettings(
    prompt="short",
    pictures=("near",),
    form=AnswerForm(layout="compact"),
    view=MapView((EgoSquare(32, 0.24), EgoSquare(32, 0.6))),
)
SHARES = "maps:0.6,words=/0:0.3,near_alone=near/7:0.1"
TEXTS = ("go to the sofa", "turn left at the door, then wait", "find a plant")
RECIPE = Recipe(batch=3, warm_steps=2, mean=0.9)


def open_pupil_small() -> tuple[Pupil, dict[str, float]]:
    """A model that is asked with two maps, with none, and with one; and the shares."""
    settings, shares = read_inputs(SHARES, BASE)
    return build_pupil("nano", settings, TEXTS), shares


class Counted:
    """States that hang on how many were drawn."""

    texts = TEXTS

    def __init__(self, draw) -> None:
        self._draw, self.drawn = draw, 0

    def draw(self, count: int):
        states = self._draw(count, seed=self.drawn)
        self.drawn += count
        return states

    def state(self):
        return {"drawn": self.drawn}

    def restore(self, state) -> None:
        self.drawn = state["drawn"]


def test_a_step_is_of_the_input_that_seed_and_number_say() -> None:
    mixture = InputMixture({"a": 5, "b": 3, "c": 2}, seed=1)
    chosen = [mixture.choose(step) for step in range(3000)]
    assert chosen == [
        InputMixture({"a": 0.5, "b": 0.3, "c": 0.2}, 1).choose(k) for k in range(3000)
    ]
    shares = {name: count / 3000 for name, count in Counter(chosen).items()}
    assert shares == pytest.approx({"a": 0.5, "b": 0.3, "c": 0.2}, abs=0.03)
    assert chosen[:40] != [
        InputMixture({"a": 5, "b": 3, "c": 2}, seed=2).choose(k) for k in range(40)
    ]


def test_inputs_are_read_as_they_are_written() -> None:
    settings, shares = read_inputs("all:0.5, views:0.3,maps:0.2", BASE)
    assert shares == {"all": 0.5, "views": 0.3, "maps": 0.2}
    assert (settings.input, list(settings.inputs)) == ("all", ["views", "maps"])
    views = settings.choose("views")
    assert (views.pictures, views.form.points, views.inputs) == (("rgb", "history"), 0, {})
    assert settings.shown == ("rgb", "history", "near", "far")
    assert settings.choose().pictures == settings.pictures
    alone, none = read_inputs("maps", BASE)
    assert none == {} and alone == msgspec.structs.replace(BASE, pictures=("near", "far"))
    paper = read_inputs("maps,paper_planning_views", BASE)[0].choose("paper_planning_views")
    assert (paper.prompt, paper.form.layout, paper.form.points) == (
        "paper_planning_views",
        "json",
        0,
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nothing:1", "no input 'nothing'"),
        ("maps:x", "'x' is not a share"),
        ("maps,maps", "'maps' stands twice"),
        ("maps,maps=near/3", "'maps' names no input, or two"),
        (" , ", "no input"),
        ("maps:0,views", "share 0.0"),
        ("maps,Mine=near/3", "'Mine' names no input"),
        ("maps,mine=near/x", "'x' is not a number of waypoints"),
        ("maps,mine=lidar", "no picture 'lidar'"),
    ],
)
def test_inputs_that_there_are_not_are_refused(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        read_inputs(text, BASE)


def test_weights_are_those_of_steps_by_hand(draw_states, tmp_path: Path) -> None:
    """A stage over three inputs, against a learner whose loss is exchanged by hand."""
    pupil, shares = open_pupil_small()
    mixture, states = InputMixture(shares, 4), [draw_states(3, seed=3 * k) for k in range(6)]
    learner = open_learner(pupil, pupil.inputs["maps"].table(TEXTS), RECIPE)
    assert [n for n, _ in learner.loss.named_parameters()][-2:] == [
        "distance.weight",
        "distance.bias",
    ]
    plan = StagePlan(samples=18, report=6, save=0)
    maker = pupil.inputs["maps"].maker(TEXTS, "cpu")
    stage = Stage(pupil, learner, Counted(draw_states), maker, plan, {}, "c", mixture=mixture)
    with open_run(tmp_path, stage="sft", recipe={}, hashes={}, command=[], device="cpu",
                  versions={}) as run:  # fmt: skip
        stage.run(run, lambda _: None)

    own, _ = open_pupil_small()
    losses = {
        name: LossForward(one.forward(one.table(TEXTS)), one.slots, RECIPE)
        for name, one in own.inputs.items()
    }
    first = losses["maps"]
    by_hand = Learner(first, RECIPE)
    chosen = []
    for step, some in enumerate(states, 1):
        name = mixture.choose(step)
        chosen.append(name)
        losses[name].distance = first.distance
        by_hand._called = losses[name]
        batch = own.inputs[name].maker(TEXTS, "cpu").make(some)
        by_hand.step(batch, stage.schedule.share(step - 1, RECIPE))
    assert len(set(chosen)) > 1
    for name, weight in learner.weights.items():
        assert torch.equal(weight, by_hand.weights[name]), name
        assert torch.equal(learner.averaged[name], by_hand.averaged[name]), name
    line = json.loads((tmp_path / "metrics.jsonl").read_text().splitlines()[-1])
    for name in set(chosen):
        assert line[f"loss_{name}"] > 0
        assert (f"loss_points_{name}" in line) == (name != "words")
    counts = Counter(chosen)
    mean = sum(line[f"loss_{name}"] * count for name, count in counts.items()) / 6
    assert line["loss"] == pytest.approx(mean)


def test_a_stopped_run_goes_on_to_the_same_bytes(draw_states, tmp_path: Path) -> None:
    def run(samples: int, stop: int = 0):
        pupil, shares = open_pupil_small()
        learner = open_learner(pupil, pupil.inputs["maps"].table(TEXTS), RECIPE)
        maker = pupil.inputs["maps"].maker(TEXTS, "cpu")
        plan = StagePlan(samples=samples, report=6, save=2)
        stage = Stage(pupil, learner, Counted(draw_states), maker, plan, {}, "c",
                      mixture=InputMixture(shares, 4))  # fmt: skip
        return stage

    def play(stage: Stage, steps: range) -> None:
        stage.schedule = stage.schedule.end_at(6, RECIPE)
        for step in steps:
            batch = stage.make_batch(step, stage.stream.draw(3))
            stage.learner.step(batch, stage.schedule.share(step - 1, RECIPE))
            stage.counters = msgspec.structs.replace(stage.counters, step=step)

    whole, half, rest = run(18), run(18), run(18)
    play(whole, range(1, 7))
    play(half, range(1, 4))
    state = half.state()
    copied = {n: w.detach().clone() for n, w in half.learner.weights.items()}
    with torch.no_grad():
        for name, weight in rest.learner.weights.items():
            weight.copy_(copied[name])
    rest.restore(state)
    play(rest, range(4, 7))
    for name, weight in whole.learner.weights.items():
        assert torch.equal(weight, rest.learner.weights[name]), name


def test_a_mixture_of_other_inputs_is_refused(draw_states) -> None:
    pupil, _ = open_pupil_small()
    learner = open_learner(pupil, pupil.inputs["maps"].table(TEXTS), RECIPE)
    maker = pupil.inputs["maps"].maker(TEXTS, "cpu")
    with pytest.raises(ConfigError, match="a mixture of maps, views for a policy with inputs maps"):
        Stage(pupil, learner, Counted(draw_states), maker, StagePlan(), {}, "c",
              mixture=InputMixture({"maps": 1, "views": 1}))  # fmt: skip


def test_a_saved_policy_answers_alike_in_torch_and_numpy_in_each_input(tmp_path: Path) -> None:
    pupil, _ = open_pupil_small()
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        for weight in pupil.model.parameters():
            weight.add_(0.08 * torch.randn_like(weight))
    pupil.save(tmp_path / "policy")
    again = load_pupil(tmp_path / "policy")
    assert again.settings.by_input.keys() == pupil.inputs.keys()
    stream, answers = np.random.default_rng(0), {}
    for name, one in again.inputs.items():
        questions = Questions(tmp_path / "policy", inputs=name)
        assert questions.settings == one.settings
        assert questions.layout.ids.tolist() == one.table(TEXTS).layout.ids.tolist()
        pictures = [
            stream.integers(0, 256, (4, s.height, s.width, 3), dtype=np.uint8)
            for s in questions.layout.sizes
        ]
        ids = np.stack([questions.fill(TEXTS[k % 3], k - 1, k == 2, 0.3 * k) for k in range(4)])
        said = [
            open_engine(questions, backend, "cpu", "float32", 4).answer(pictures, ids)
            for backend in ("numpy", "torch")
        ]
        assert np.array_equal(*said), name
        answers[name] = said[0].shape[1]
    assert answers["words"] < answers["near_alone"] < answers["maps"]
    assert len(Questions(tmp_path / "policy").template.pictures) == 2
    with pytest.raises(ConfigError, match="known: maps, near_alone, words"):
        Questions(tmp_path / "policy", inputs="views")


def test_files_of_policies_asked_in_one_way_are_as_ever(tmp_path: Path) -> None:
    pupil, _ = open_pupil_small()
    pupil.inputs["near_alone"].save(tmp_path / "one")
    alone = replace(pupil.inputs["near_alone"], settings=msgspec.structs.replace(
        pupil.inputs["near_alone"].settings, input=""))  # fmt: skip
    alone.save(tmp_path / "plain")
    found = json.loads((tmp_path / "plain" / FILE).read_text())
    assert not {"input", "inputs"} & found.keys()
    with pytest.raises(ConfigError, match="there is one way alone"):
        Questions(tmp_path / "plain", inputs="maps")
    found["inputs"] = {"maps": {"prompt": "short", "pictures": ["near"], "form": {}, "odd": 1}}
    (tmp_path / "plain" / FILE).write_text(json.dumps(found))
    with pytest.raises(CheckpointError, match="odd"):
        Questions(tmp_path / "plain")


def test_means_are_told_by_input_and_over_those_that_have_them() -> None:
    from gn0.training.learner import Losses

    def losses(value: float, points: float) -> Losses:
        groups = torch.tensor([points, value, value, value])
        return Losses(torch.tensor(value), groups, torch.tensor(0.5), torch.tensor(1.0))

    tally = Tally("cpu", {"views": ("loss_points",)})
    for value, points, name in ((1.0, 4.0, "maps"), (3.0, 0.0, "views"), (5.0, 0.0, "views")):
        tally.add(losses(value, points), torch.tensor(1.0), name)
    found = tally.read()
    assert (found["loss"], found["loss_maps"], found["loss_views"]) == (3.0, 1.0, 4.0)
    assert found["loss_points"] == found["loss_points_maps"] == 4.0
    assert "loss_points_views" not in found
    assert tally.read()["loss"] == 0
    tally.add(losses(2.0, 1.0), torch.tensor(1.0))
    assert set(tally.read()) == {n for n in found if not n.endswith(("_maps", "_views"))}
