"""The folder of a run: one writer, each step told once, whatever was killed in between."""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="training needs gn0[train]")

from gn0.config import Config
from gn0.errors import StorageError, TrainingError
from gn0.training.runs.metrics_file import MetricsFile, read_metrics
from gn0.training.runs.progress_line import (
    ProgressLine,
    TrainingReport,
    format_report,
    format_seconds,
)
from gn0.training.runs.recipe_text import (
    describe_command,
    describe_recipe,
    list_recipe_differences,
)
from gn0.training.runs.run_folder import (
    CHECKPOINTS,
    EVENTS,
    LOG,
    METRICS,
    count_card_seconds,
    open_run,
    read_run,
)
from gn0.training.runs.state_folder import STATE, name_state

FACTS = {
    "stage": "sft", "recipe": {"rate": 0.001, "steps": 8}, "hashes": {"corpus": "c0ffee"},
    "command": ["gn0", "train", "sft"], "device": "cpu", "versions": {"torch": "2.13.0"},
}  # fmt: skip


@contextmanager
def opened(folder: Path, **other):
    with open_run(folder, **{**FACTS, **other}) as run:
        yield run


def put_state(folder: Path, step: int) -> None:
    """A state by its looks: whether it is whole is not the run folder's business."""
    (folder / CHECKPOINTS / name_state(step)).mkdir(parents=True)
    (folder / CHECKPOINTS / name_state(step) / STATE).write_text("{}")


def steps_of(folder: Path) -> list[int]:
    return [line["step"] for line in read_metrics(folder / METRICS)]


def test_a_run_is_begun_and_gone_on_with(tmp_path: Path) -> None:
    """Lines behind the checkpoint are told again, none twice and none left out."""
    with opened(tmp_path) as run:
        assert run.resumed is None and run.notes == ()
        for step in range(1, 8):
            run.report(step, {"loss": 1 / step})
            if step in (3, 5):
                put_state(tmp_path, step)
    with (tmp_path / METRICS).open("ab") as file:
        file.write(b'{"step": 8, "lo')  # killed in the middle of a line
    with opened(tmp_path) as run:
        assert run.resumed == tmp_path / CHECKPOINTS / name_state(5)
        assert steps_of(tmp_path) == [1, 2, 3, 4, 5]
        for step in range(6, 9):
            run.report(step, {"loss": 1 / step})
    assert steps_of(tmp_path) == list(range(1, 9))
    record = read_run(tmp_path)
    assert [session.step for session in record.sessions] == [0, 5]
    assert record.recipe == FACTS["recipe"] and record.hashes == {"corpus": "c0ffee"}
    assert (tmp_path / LOG).read_text().count("begins at step") == 2


def test_an_earlier_state_gives_later_ones_up(tmp_path: Path) -> None:
    with opened(tmp_path) as run:
        for step in range(1, 8):
            run.report(step, {})
    put_state(tmp_path, 3)
    put_state(tmp_path, 5)
    none = pytest.raises(TrainingError, match="no checkpoint of step 4")
    with none as caught, opened(tmp_path, from_step=4):
        pass
    assert "3, 5" in caught.value.remedy
    with opened(tmp_path, from_step=3) as run:
        assert run.resumed is not None and run.resumed.name == name_state(3)
    assert steps_of(tmp_path) == [1, 2, 3]
    assert [path.name for path in (tmp_path / CHECKPOINTS).iterdir()] == [name_state(3)]


def test_without_a_state_it_begins_again(tmp_path: Path) -> None:
    with opened(tmp_path) as run:
        run.report(1, {"loss": 1.0})
    with opened(tmp_path) as run:
        assert run.resumed is None and steps_of(tmp_path) == []


def test_two_writers_are_one_too_many(tmp_path: Path) -> None:
    with (
        opened(tmp_path),
        pytest.raises(TrainingError, match="another training run is writing"),
        opened(tmp_path),
    ):
        pass


@pytest.mark.parametrize(
    ("other", "named"),
    [({"recipe": {"rate": 0.002, "steps": 8}}, "rate was 0.001, is 0.002"),
     ({"hashes": {"corpus": "bad"}}, "corpus was 'c0ffee', is 'bad'"),
     ({"stage": "dagger"}, "it is sft, this is dagger")],
)  # fmt: skip
def test_another_run_is_refused(tmp_path: Path, other: dict, named: str) -> None:
    with opened(tmp_path) as run:
        run.report(1, {})
    put_state(tmp_path, 1)
    with pytest.raises(TrainingError, match=named) as caught, opened(tmp_path, **other):
        pass
    assert "--fresh" in caught.value.remedy
    assert steps_of(tmp_path) == [1]
    with opened(tmp_path, **other, fresh=True) as run:
        assert run.resumed is None
    assert len(read_run(tmp_path).sessions) == 1


def test_what_may_differ_is_said(tmp_path: Path) -> None:
    with opened(tmp_path):
        pass
    with opened(tmp_path, recipe={"rate": 0.001, "steps": 16}, free={"steps"}) as run:
        assert run.notes == ("recipe: steps was 8, is 16",)
    assert "steps was 8, is 16" in (tmp_path / LOG).read_text()


def test_something_else_stays_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    for fresh in (False, True):
        refused = pytest.raises(TrainingError, match="holds something else")
        with refused, opened(tmp_path, fresh=fresh):
            pass
    assert (tmp_path / "thesis.tex").read_text() == "mine"
    with pytest.raises(TrainingError, match="no training run"):
        read_run(tmp_path)


def test_a_finished_run_says_so(tmp_path: Path) -> None:
    with opened(tmp_path) as run:
        put_state(tmp_path, 8)
        run.finish(8, {"SR": 0.5})
    with opened(tmp_path) as run:
        assert run.finished == 8
    assert read_run(tmp_path).results == {"SR": 0.5}
    with opened(tmp_path, fresh=True) as run:
        assert run.finished is None


def test_step_0_is_what_was_before_the_first(tmp_path: Path) -> None:
    """It stays once a state is of it; a result that is no number is null."""
    for _ in range(2):  # killed before a state of step 0
        with opened(tmp_path) as run:
            run.report(0, {"entropy": 1.5})
            run.report(1, {"loss": 2.0})
    assert steps_of(tmp_path) == [0, 1]
    put_state(tmp_path, 0)
    with opened(tmp_path) as run:
        assert run.resumed == tmp_path / CHECKPOINTS / name_state(0)
        run.report(1, {"loss": 2.0})
        run.finish(1, {"entropy": 1.25, "waypoint": float("nan")})
    assert steps_of(tmp_path) == [0, 1]
    assert read_run(tmp_path).results == {"entropy": 1.25, "waypoint": None}


def test_metrics_are_plain_json_in_order(tmp_path: Path) -> None:
    """What is no number is null, as JSON has no NaN; a step is never told twice."""
    file = MetricsFile(tmp_path / METRICS)
    file.add(10, {"loss": 0.5, "stop_precision": float("nan")})
    with pytest.raises(TrainingError, match="step 10 is reported after step 10"):
        file.add(10, {})
    file.close()
    text = (tmp_path / METRICS).read_text()
    assert json.loads(text) == {"step": 10, "loss": 0.5, "stop_precision": None}
    (tmp_path / METRICS).write_text(text + "hello\n")
    with pytest.raises(StorageError, match="line 2 is not a line of metrics"):
        MetricsFile(tmp_path / METRICS, 20)


def test_tensorboard_reads_the_curves_of_a_resumed_run(tmp_path: Path) -> None:
    """Its own reader sees each step once: what lay behind the checkpoint is void."""
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    with opened(tmp_path) as run:
        for step in range(1, 6):
            run.report(step, {"loss": float(step)})
    put_state(tmp_path, 3)
    with opened(tmp_path) as run:
        for step in range(4, 7):
            run.report(step, {"loss": 10.0 * step})
    read = EventAccumulator(str(tmp_path / EVENTS))
    read.Reload()
    points = [(point.step, point.value) for point in read.Scalars("loss")]
    assert points == [(1, 1.0), (2, 2.0), (3, 3.0), (4, 40.0), (5, 50.0), (6, 60.0)]
    assert "tensorflow" not in sys.modules


class Inner(Config, frozen=True):
    password: str = "p4ss"
    tokenizer: str = "folder"


class Outer(Config, frozen=True, kw_only=True):
    inner: Inner = Inner()
    out: str = "o"
    tokens: int = 34
    options: dict[str, str]


def test_recipes_and_commands_are_kept_without_secrets() -> None:
    kept = describe_recipe(Outer(options={"my_token_2": "t0k", "checkpoint": "c"}))
    assert kept == {
        "inner": {"password": "(not kept)", "tokenizer": "folder"},
        "out": "o",
        "tokens": 34,
        "options": {"my_token_2": "(not kept)", "checkpoint": "c"},
    }
    words = ["gn0", "train", "sft", "--tokenizer", "t", "--hub-token", "x", "--api-key=y",
             "--policy-option", "secret=z", "--out", "o"]  # fmt: skip
    shown = describe_command(words)
    assert not {"x", "y", "z"} & set(" ".join(shown).replace("=", " ").split())
    assert shown[3:5] == ["--tokenizer", "t"] and shown[-2:] == ["--out", "o"]


def test_of_a_table_only_what_differs_is_told() -> None:
    """Shown as a whole it is cut, and was the same before and after."""
    long = {f"field_{k}": k for k in range(9)}
    then = {"plan": {**long, "samples": 8}, "inputs": {}, "seed": 0}
    now = {"plan": {**long, "samples": 16}, "inputs": {"all": 1.0}, "seed": 0}
    held, free = list_recipe_differences(then, now, free=("plan",))
    assert free == ["plan.samples was 8, is 16"]
    assert held == ["inputs was {}, is {'all': 1.0}"]
    deeper = list_recipe_differences({"a": {"b": {"c": 1}}}, {"a": {"b": {"c": 2}, "d": 3}})[0]
    assert deeper == ["a.b.c was 1, is 2", "a.d was '(absent)', is 3"]


def test_the_line_says_rate_losses_and_time_left() -> None:
    """600 samples and 10 steps in 2 s: 300/s, and 85 steps more take 17 s."""
    said: list[str] = []
    time = iter([0.0, 1.0, 2.0, 60.0])
    line = ProgressLine(said.append, seconds=2.0, clock=lambda: next(time))
    for step in (5, 10, 15, 100):
        line.update(TrainingReport(step, 100, 60 * step, 1.25, {"points": 2.0}, 0.5, 0.3))
    assert len(said) == 3  # the second came too soon
    assert said[1] == (
        "step 15/100 · 900 samples · 300/s · loss 1.2500 (points 2.000) · first action 50.0% · "
        "12th waypoint 0.30 m · 0:17 left"
    )
    assert said[2].endswith("0:00 left")
    report = TrainingReport(1, 0, 60, 1.0, {}, 0.0)
    assert format_report(report, 0.0, None) == (
        "step 1 · 60 samples · loss 1.0000 · first action 0.0%"
    )
    shares = {"agrees": 0.5, "arrives": float("nan")}
    report = TrainingReport(1, 0, 60, 1.0, {}, 0.0, walks=shares)
    assert format_report(report, 0.0, None).endswith("first action 0.0% · agrees 50%")
    assert [format_seconds(s) for s in (7, 725, 11045)] == ["0:07", "12:05", "3:04:05"]


def test_time_left_is_that_of_the_limit_where_it_ends_before_the_steps_do() -> None:
    """300 samples and 5 steps a second, 985 steps to come: 197 s, but for 30 of the plan's."""
    said: list[str] = []
    now = [0.0]
    line = ProgressLine(said.append, seconds=0.0, clock=lambda: now[0])
    for step, most in ((5, 100.0), (15, 30.0), (990, 30.0)):
        now[0] = step / 5
        line.update(TrainingReport(step, 1000, 60 * step, 1.0, {}, 0.5), most)
    assert [one.split(" · ")[0] for one in said] == ["step 5", "step 15", "step 990/1,000"]
    assert [one.split(" · ")[-1] for one in said] == ["1:40 left", "0:30 left", "0:02 left"]
    line = ProgressLine(said.append, clock=lambda: now[0])
    line.pulse(1, 20, 8, 30.0)
    now[0] += 30.0
    line.pulse(2, 20, 16, 60.0)
    line.pulse(2, 20, 16, 60.0)
    assert said[3:] == ["step 2 · 16 samples · 0.3/s · 1:00 left"]


def test_a_run_of_slow_steps_says_where_it_is_between_its_reports() -> None:
    """A step of 15 s: nothing is said of the first, then where it is, after 20 s or more."""
    said: list[str] = []
    now = [0.0]
    line = ProgressLine(said.append, clock=lambda: now[0])
    for step in range(1, 8):
        now[0] = 15.0 * step
        line.pulse(step, 20, 8 * step)
    assert said == [
        "step 3/20 · 24 samples · 0.5/s · 4:15 left",
        "step 5/20 · 40 samples · 0.5/s · 3:45 left",
        "step 7/20 · 56 samples · 0.5/s · 3:15 left",
    ]
    line.update(TrainingReport(8, 20, 64, 1.0, {}, 0.0))
    now[0] += 10.0
    line.pulse(9, 20, 72)
    assert len(said) == 4


def test_seconds_are_counted_once_for_each_card(tmp_path: Path) -> None:
    """A run that four cards began and one went on with, from a state before the last report."""
    with opened(tmp_path, processes=4, device="H100") as run:
        run.report(0, {"seconds": 0.0})
        assert count_card_seconds(tmp_path) is None
        for step, seconds in ((1, 30.0), (2, 40.0), (3, 55.0)):
            run.report(step, {"seconds": seconds})
        put_state(tmp_path, 2)
    assert count_card_seconds(tmp_path) == 220
    with opened(tmp_path, device="H100") as run:
        run.report(4, {"seconds": 47.0})
    assert count_card_seconds(tmp_path) == 4 * 40 + 7
    assert [one.devices for one in read_run(tmp_path).sessions] == ["4 × H100", "H100"]
    assert "begins at step 0 on 4 × H100" in (tmp_path / LOG).read_text()
