"""`gn0 train dagger`: two stages that go on where they were stopped, and are never mixed up."""

from __future__ import annotations

import gc
import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from gn0.cli.main import main
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.suites.suite import save_suite

pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.data.answer_form import AnswerForm
from gn0.policies.bae.actor import Actor
from gn0.policies.bae.policy_settings import PolicySettings, load_policy_settings
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.training import dapo, imitation
from gn0.training.policy_driver import PolicyDriver
from gn0.training.pupil import build_pupil
from gn0.training.runs.stage_chain import read_stages
from gn0.training.streams.step_ring import StepRing
from gn0.training.streams.stream_collected import StreamCollected
from gn0.training.worlds import load_lessons

# python -c: a collection that is killed once so many steps are there
KILLED = """
import os, signal, sys
from gn0.training.streams.stream_live import StreamLive
plain = StreamLive.step
def step(self):
    if self.ring.count == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGKILL)
    plain(self)
StreamLive.step = step
from gn0.cli.main import main
main(sys.argv[2:])
"""


def _make_suite(root: Path, name: str, seed: int) -> Path:
    save_scene(replace(build_example_scene(), id=name), root / name)
    scene = load_scene(root / name)
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 6, seed)
    return save_suite(root / f"suite-{name}", [scene], episodes, name=name, max_steps=12).folder


@pytest.fixture(scope="module")
def suite(tmp_path_factory) -> Path:
    return _make_suite(tmp_path_factory.mktemp("suite"), "flat", 0)


@pytest.fixture(scope="module")
def start(suite, tmp_path_factory) -> Path:
    """A policy of random weights with small pictures."""
    view = MapView(squares=(EgoSquare(32, 0.24), EgoSquare(32, 0.6)))
    form = AnswerForm(layout="compact")
    settings = PolicySettings(prompt="short", pictures=("near", "far"), form=form, view=view)
    folder = tmp_path_factory.mktemp("start") / "policy"
    build_pupil("nano", settings, load_lessons(suite).texts).save(folder)
    return folder


@pytest.fixture(autouse=True)
def _emulated(own_cache, monkeypatch) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))


def _words(suites: tuple[Path, ...] | Path, out: Path, *more: object) -> list[str]:
    listed = suites if isinstance(suites, tuple) else (suites,)
    return [
        "train", "dagger", *map(str, listed), "--split", "all", "--held-out", "", "--batch", "4",
        "--report", "1", "--save", "2", "--device", "host", "--out", str(out), *map(str, more),
    ]  # fmt: skip


def _read(folder: Path) -> list[dict]:
    """Lines of metrics without what the clock says."""
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    clock = ("seconds", "samples_per_second")
    return [{k: v for k, v in line.items() if k not in clock} for line in lines]


def _read_told(folder: Path) -> str:
    """What the policy's last stage tells of itself."""
    return read_stages(folder / "policy")[-1].told


def _forget(run: Path, step: int) -> None:
    """As if the run had been killed after the state of a step."""
    for state in (run / "checkpoints").iterdir():
        if int(state.name.removeprefix("step-")) > step:
            shutil.rmtree(state)
    shutil.rmtree(run / "policy")


def _same(one: Path, other: Path) -> None:
    for name in ("model.safetensors", "tokenizer.json", "policy.json"):
        assert (one / "policy" / name).read_bytes() == (other / "policy" / name).read_bytes()
    assert _read(one) == _read(other)


@pytest.mark.slow
def test_dagger_goes_on_in_mid_collection_and_in_mid_epoch(
    suite, start, tmp_path, capsys, monkeypatch
) -> None:
    """Twenty states of one agent, killed after 18 of them; two epochs, stopped in the first."""
    own = ["--start", start, "--states", 19, "--epochs", 2, "--agents", 1]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    drawn: list[int] = []
    plain = StepRing.draw

    def draw(self, numbers, dark=None, **options):
        if not options:
            drawn.extend(numbers.tolist())
        return plain(self, numbers, dark, **options)

    monkeypatch.setattr(StepRing, "draw", draw)
    monkeypatch.setattr("gn0.training.dagger.VARIOUS", 2.0)  # none is as various as that
    assert main(_words(suite, whole, *own)) == 0
    told = capsys.readouterr().out
    assert "--rescue 16" in told
    monkeypatch.setattr("gn0.training.dagger.VARIOUS", 0.0)
    assert "collecting: step 16 of 20" in told and "collected 20 states of the policy's" in told
    assert 0 < _read(whole)[0]["different"] <= 1 <= _read(whole)[0]["collected_episodes"]
    assert Counter(drawn) == dict.fromkeys(range(20), 2)
    assert Counter(drawn[:20]) == dict.fromkeys(range(20), 1)
    first, *others = _read(whole)
    assert first["step"] == 0 and first["driven"] > 0.5 and first["collected"] == 20
    assert [line["samples"] for line in others] == list(range(4, 41, 4))
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, "18", *_words(suite, parts, *own)],
        env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, timeout=300,
    )  # fmt: skip
    assert killed.returncode == -9, killed.stderr
    assert not list((parts / "checkpoints").glob("*")) and (parts / "walks.json").is_file()
    capsys.readouterr()
    assert main(_words(suite, parts, *own)) == 0
    told = capsys.readouterr().out
    assert "goes on collecting at step 16 of 20" in told and "--rescue" not in told
    assert not (parts / "walks.json").exists()
    _same(whole, parts)
    _forget(parts, 8)
    assert main(_words(suite, parts, *own)) == 0
    _same(whole, parts)
    record = json.loads((parts / "run.json").read_text())
    assert record["stage"] == record["recipe"]["stage"] == "dagger"
    assert main(_words(suite, parts, *own, "--driver", "expert")) == 2
    assert "driver was 'policy', is 'expert'" in capsys.readouterr().err


@pytest.mark.slow
def test_a_policy_goes_on_with_prompts_as_long_as_it_knows_them(start, tmp_path, capsys) -> None:
    """At another length it answers as if it had learned little: what is too long is left out."""
    save_scene(replace(build_example_scene(), id="flat"), tmp_path / "flat")
    scene = load_scene(tmp_path / "flat")
    first, *others = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 6, 0)

    def tell(episode):
        words = "walk on" + ", and on" * 40
        mission = msgspec.structs.replace(episode.mission, instruction=words)
        return msgspec.structs.replace(episode, mission=mission)

    one, every = (
        save_suite(tmp_path / name, [scene], episodes, name=name, max_steps=12).folder
        for name, episodes in (("one", [tell(first), *others]), ("every", [*map(tell, others)]))
    )
    known, own = load_policy_settings(start).text_length, ["--start", start, "--agents", 4]
    short = ["--states", 8, "--epochs", 1]
    runs: dict[str, list[object]] = {
        "dagger": short,
        "live": ["--live", "--samples", 4, "--kept", 80],
        "longer": [*short, "--text-length", known + 8],
        "sft": ["--pictures", "near,far", "--samples", 4, "--kept", 80],
    }
    for name, more in runs.items():
        words = _words(one, tmp_path / name, *own, *more)
        if name == "sft":
            words[1] = name
        assert main(words) == 0
        told, longer = capsys.readouterr().out, name == "longer"
        assert load_policy_settings(tmp_path / name / "policy").text_length == known + 8 * longer
        assert "left out 1 episode of more than" in told
        assert ("it answers worse until" in told) == longer
    assert main(_words(every, tmp_path / "none", *own, *short)) == 2
    told = capsys.readouterr().err
    assert "all 5 episodes say more than" in told and "--text-length" in told


@pytest.mark.slow
def test_the_expert_rescues_on_request_where_states_are_gathered_once(
    suite, start, tmp_path, monkeypatch
) -> None:
    """In DAgger and in DAPO; in a run that says nothing of it the policy drives alone."""
    own = ["--start", start, "--agents", 4]
    driven, told = [], []
    for more in ([], ["--rescue", 1]):
        out = tmp_path / f"dagger{len(more)}"
        assert main(_words(suite, out, *own, "--states", 24, "--epochs", 1, *more)) == 0
        driven.append(_read(out)[0]["driven"])
    assert driven[1] < driven[0]
    plain = dapo.collect_states

    def collect(*args, **settings):
        told.append(settings["rescue"])
        return plain(*args, **settings)

    monkeypatch.setattr(dapo, "collect_states", collect)
    words = ["train", "dapo", str(suite), "--split", "all", "--held-out", "", "--states", "8",
             "--prompts", "4", "--answers", "2", "--epochs", "1", "--minibatches", "1", "--device",
             "host", *map(str, own)]  # fmt: skip
    for more in ([], ["--rescue", "3"]):
        assert main([*words, "--out", str(tmp_path / f"dapo{len(more)}"), *more]) == 0
    assert told == [0, 3]


@pytest.mark.slow
def test_who_acted_is_let_go_before_learning_begins(suite, start, tmp_path, monkeypatch) -> None:
    """On a card its memory is the learner's then: no driver and no actor is alive any more."""
    alive: list[str] = []
    plain = StreamCollected.count_variety

    def count(self):
        kept = (type(one) for one in gc.get_objects())
        alive.extend(kind.__name__ for kind in kept if kind in (PolicyDriver, Actor))
        return plain(self)

    monkeypatch.setattr(StreamCollected, "count_variety", count)
    own = ["--start", start, "--states", 16, "--epochs", 1, "--agents", 4]
    assert main(_words(suite, tmp_path / "run", *own)) == 0
    assert _read(tmp_path / "run")[0]["driven"] > 0.5
    assert alive == []


def test_the_control_has_as_many_samples_of_the_experts_walks(suite, start, tmp_path) -> None:
    own = ["--start", start, "--states", 16, "--epochs", 2, "--agents", 4]
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    assert main(_words(suite, mine, *own)) == 0
    assert main(_words(suite, theirs, *own, "--driver", "expert")) == 0
    one, other = _read(mine), _read(theirs)
    assert [line.get("samples") for line in one] == [line.get("samples") for line in other]
    assert one[0]["driven"] > 0.5 and other[0]["driven"] == 0
    assert not other[0]["walks_cut_short"] and other[0]["agreement"] is None
    recipes = [json.loads((run / "run.json").read_text())["recipe"] for run in (mine, theirs)]
    assert {k for k in recipes[0] if recipes[0][k] != recipes[1][k]} == {"driver"}


@pytest.mark.slow
def test_dagger_live_goes_on_and_carries_its_driver_to_scenes_that_join(
    suite, start, tmp_path, capsys
) -> None:
    second = _make_suite(tmp_path, "other-flat", 1)
    suites = (suite, second)
    own = ["--live", "--start", start, "--samples", 24, "--agents", 4, "--kept", 80, "--joins",
           "0,12", "--beta-from", 4, "--beta-to", 12, "--acts", "averaged", "--confirm-stop",
           "--draw-after", 2,
           "--text-length", 40, "--held-out", "test", "--examined", 2, "--asked", 8]  # fmt: skip
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert main(_words(suites, whole, *own)) == 0
    told = capsys.readouterr().out
    assert "before the first step: entropy" in told and "after" in told
    lines = _read(whole)
    assert lines[0]["step"] == 0 and lines[0]["entropy"] > 0
    assert [line["beta"] for line in lines[1:]] == [1, 0.5, 0, 0, 0, 0]
    assert lines[1]["driven"] == 0 and lines[4]["driven"] > 0.5  # the second scene has joined
    assert {"own_stop_recall", "own_stop_precision", "own_agreement"} <= set(lines[-1])
    assert load_policy_settings(whole / "policy").draw_after == 2
    results = json.loads((whole / "run.json").read_text())["results"]
    assert results["entropy_before"] == lines[0]["entropy"]
    shutil.copytree(whole, parts)
    _forget(parts, 4)
    assert main(_words(suites, parts, *own)) == 0
    _same(whole, parts)


@pytest.mark.slow
def test_a_suite_that_does_not_come_is_waited_for_no_longer_than_time_is(
    suite, start, tmp_path, capsys
) -> None:
    """Not for an hour where the run has minutes: the rest of them would be lost, unsaid."""
    own = ["--live", "--start", start, "--samples", 24, "--agents", 4, "--kept", 80, "--joins",
           "0,8", "--text-length", 40, "--held-out", "", "--examined", 0, "--save", 1,
           "--minutes", 0.2]  # fmt: skip
    out = tmp_path / "run"
    assert main(_words((suite, tmp_path / "never"), out, *own)) == 2
    said = capsys.readouterr()
    assert f"waiting for {tmp_path / 'never'}" in said.out
    assert "no suite after" in said.err and "give the same command again" in said.err
    assert (out / "checkpoints" / "step-000000002").is_dir()  # it may be gone on with
    assert main(_words((suite, tmp_path / "never"), out, *own, "--join-late")) == 0
    assert f"{tmp_path / 'never'}: not there yet, and not waited for" in capsys.readouterr().out
    assert _read(out)[-1]["suites"] == 1 and "never came too late" in _read_told(out)


@pytest.mark.slow
def test_a_suite_that_is_late_joins_when_it_is_there(
    suite, start, tmp_path, capsys, monkeypatch
) -> None:
    second = _make_suite(tmp_path, "other-flat", 1)
    asked = []

    def is_whole(path) -> bool:
        asked.append(path)
        return Path(path) == suite or len(asked) > 3

    monkeypatch.setattr(imitation, "is_whole", is_whole)
    own = ["--live", "--start", start, "--samples", 32, "--agents", 4, "--kept", 80, "--joins",
           "0,8", "--text-length", 40, "--examined", 0, "--join-late"]  # fmt: skip
    out = tmp_path / "run"
    assert main(_words((suite, second), out, *own)) == 0
    assert capsys.readouterr().out.count("not waited for") == 1
    joined = [line["suites"] for line in _read(out) if "suites" in line]
    assert joined[0] == 1 and joined[-1] == 2 and "too late" not in _read_told(out)
    monkeypatch.setattr(imitation.Imitation, "_find_patience", lambda *_: 0.0)  # the rate falls
    assert main(_words((suite, second), tmp_path / "falling", *own)) == 0
    assert {line.get("suites", 1) for line in _read(tmp_path / "falling")} == {1}
    told = _read_told(tmp_path / "falling")
    assert told.startswith("…/suite-flat (…/suite-other-flat came too late); 32 samples")
    assert main(_words(suite, tmp_path / "one", *own[:5], "--join-late")) == 2
    assert "all of them from the first sample on" in capsys.readouterr().err


@pytest.mark.slow
def test_a_policy_of_maps_goes_on_with_other_inputs_that_drive_in_turn(
    suite, start, tmp_path, capsys
) -> None:
    """All three from one, stopped and gone on with; then other shares, and one of them alone."""
    own = ["--live", "--samples", 16, "--agents", 2, "--kept", 34, "--beta-from", 0, "--beta-to",
           4, "--confirm-stop", "--held-out", "test", "--examined", 1, "--asked", 4]  # fmt: skip
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    mixed = [*own, "--start", start, "--inputs", "all:0.4,views:0.3,maps:0.3"]
    assert main(_words(suite, whole, *mixed)) == 0
    settings = load_policy_settings(whole / "policy")
    before = load_policy_settings(start)
    assert settings.input == "all" and set(settings.inputs) == {"views", "maps"}
    assert settings.by_input["maps"].pictures == before.pictures
    assert settings.by_input["views"].form.points == 0
    assert (settings.view, settings.preset) == (before.view, before.preset)
    words = (start / "tokenizer.json").read_bytes()
    assert (whole / "policy/tokenizer.json").read_bytes() == words
    last = _read(whole)[-1]
    assert {f"entropy_action_{i}" for i in range(1, 7)} <= set(last)
    assert "entropy_action_6_views" in last
    assert "; by action" in capsys.readouterr().out
    shutil.copytree(whole, parts)
    _forget(parts, 2)
    assert main(_words(suite, parts, *mixed)) == 0
    _same(whole, parts)
    walked = ["policy", "examine", whole / "policy", suite, "--split", "all", "--episodes", 1,
              "--agents", 1, "--device", "host", "--inputs", "views",
              "--out", tmp_path / "walks"]  # fmt: skip
    assert main([str(word) for word in walked]) == 0
    short = ["--live", "--samples", 4, "--agents", 2, "--kept", 34, "--start", whole / "policy"]
    assert main(_words(suite, tmp_path / "shares", *short, "--inputs", "all,views:2,maps:3")) == 0
    again = load_policy_settings(tmp_path / "shares/policy")
    assert again.by_input.keys() == settings.by_input.keys()
    assert main(_words(suite, tmp_path / "alone", *short, "--inputs", "views")) == 0
    alone = load_policy_settings(tmp_path / "alone/policy")
    assert not alone.inputs and alone.pictures == ("rgb", "history")
    assert main(_words(suite, tmp_path / "shown", *short, "--pictures", "near")) == 0
    assert load_policy_settings(tmp_path / "shown/policy").pictures == ("near",)


def test_stages_before_that_cannot_be_read_are_told_before_training(
    suite, start, tmp_path, capsys
) -> None:
    shutil.copytree(start, tmp_path / "start")
    (tmp_path / "start" / "stages.json").write_text("[{}]")
    words = _words(suite, tmp_path / "run", "--start", tmp_path / "start", "--agents", 1)
    assert main(words) == 2
    told = capsys.readouterr().err
    assert "no list of stages" in told and "stages.json" in told
    assert not (tmp_path / "run").exists()


def test_answers_of_another_layout_do_not_go_on(suite, start, tmp_path, capsys) -> None:
    words = ["train", "sft", suite, "--split", "all", "--start", start, "--layout", "json",
             "--held-out", "", "--device", "host", "--out", tmp_path / "out"]  # fmt: skip
    assert main([str(word) for word in words]) == 2
    assert "answers are json, paper, 6 actions; the policy answers compact" in (
        capsys.readouterr().err
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_two_processes_gather_a_share_each_and_go_on(suite, start, tmp_path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"

    def together(out: Path) -> str:
        words = _words(suite, out, "--start", start, "--states", 8, "--epochs", 2, "--agents", 2)
        run = ["torch.distributed.run", "--standalone", "--nproc-per-node=2", "-m", "--", "gn0"]
        done = subprocess.run(
            [sys.executable, "-m", *run, *words], env=os.environ | {"OMP_NUM_THREADS": "1"},
            capture_output=True, text=True, timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "collected 8 states" in together(whole)
    shutil.copytree(whole, parts)
    _forget(parts, 2)
    together(parts)
    _same(whole, parts)
    sessions = json.loads((parts / "run.json").read_text())["sessions"]
    assert [one["processes"] for one in sessions] == [2, 2]


@pytest.mark.slow
def test_a_state_of_another_stage_is_refused(suite, start, tmp_path, capsys) -> None:
    once, live = tmp_path / "once", tmp_path / "live"
    short = ["--agents", 4]
    assert main(_words(suite, once, "--start", start, "--states", 4, "--epochs", 1, *short)) == 0
    assert main(_words(suite, live, "--live", "--start", start, "--samples", 4, *short,
                       "--kept", 80)) == 0  # fmt: skip
    capsys.readouterr()
    assert main(_words(suite, once, "--live", "--start", start, "--samples", 4, *short)) == 2
    assert "it is dagger, this is dagger_live" in capsys.readouterr().err
    assert main(_words(suite, live, "--start", start, "--states", 4, *short)) == 2
    assert "it is dagger_live, this is dagger" in capsys.readouterr().err
    shutil.rmtree(live / "checkpoints")
    shutil.copytree(once / "checkpoints", live / "checkpoints")
    more = ["--live", "--start", start, "--samples", 8, *short, "--kept", 80]
    assert main(_words(suite, live, *more)) == 2
    assert "the state is that of another recipe" in capsys.readouterr().err


def test_flags_of_the_other_stage_are_refused(suite, start, tmp_path, capsys) -> None:
    out = tmp_path / "out"
    for words, said in (
        ([], "nobody to walk"),
        (["--start", suite], "no policy.json"),
        (["--start", start, "--kept", "80"], "--kept beside states that are gathered once"),
        (["--start", start, "--live", "--beta", "0"], "--beta beside --live"),
        (["--start", start, "--live", "--layout", "json"], "--layout beside --start"),
        (["--start", start, "--live", "--inputs", "none:1"], "no input 'none'"),
        (["--start", start, "--pictures", "near"], "--pictures beside states that are gathered"),
        (["--live", "--joins", "one"], "not whole numbers"),
        (["--live", "--start", start, "--beta-from", "9", "--beta-to", "3"], "beta falls from 9"),
    ):
        assert main(_words(suite, out, *words)) == 2
        assert said in capsys.readouterr().err
    assert not out.exists()
