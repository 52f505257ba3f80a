"""What NaVid's agent and Uni-NaVid's loader make of our files, by their own rules.

The rules are written down from their sources and share nothing with the exporter:
jzhzhang/NaVid-VLN-CE @cf066ccd255d36d4154e9ce82d318bd17ff850f3 (`navid_agent.py`,
`VLN_CE/habitat_extensions/config/vlnce_task_navid_r2r.yaml`) and jzhzhang/Uni-NaVid
@64444eba4d4503d5b08f080673e87229f7fe7f25 (`uninavid/train/train.py`, `uninavid/constants.py`,
`offline_eval_uninavid.py`).
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gn0.cli.main import main
from gn0.data.build import build_dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.errors import DataError
from gn0.export.clips import inspect_clip
from gn0.export.dataset_source import open_source
from gn0.export.export_run import check_export, run_export
from gn0.export.exporter import ExportSettings, get_dataset_exporter
from gn0.export.trips import ExportSource
from gn0.missions.generate.settings import MissionSettings
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.sim.kinematics import heading_yaw
from gn0.suites.generation import generate_missions
from gn0.suites.suite import load_suite
from gn0.testing.toy_trips import toy_source, toy_source_for

# navid_agent.py 341, 345, 349: cm of a FORWARD, degrees of a turn, most of each; 102: the question
CM, DEGREES, MOST = 25, 30, 3
NAVID_TEMPLATE = (
    "Imagine you are a robot programmed for navigation tasks. You have been given a video of "
    "historical observations and an image of the current observation <image>. Your assigned task "
    "is: '{}'. Analyze this series of images to decide your next move, which could involve turning "
    "left or right by a specific degree or moving forward a certain distance."
)
# offline_eval_uninavid.py 45
UNINAVID_TEMPLATE = (
    "Imagine you are a robot programmed for navigation tasks. You have been given a video of "
    "historical observations and an image of the current observation <image>. Your assigned task "
    "is: '{}'. Analyze this series of images to determine your next four actions. The predicted "
    "action should be one of the following: forward, left, right, or stop."
)
# uninavid/constants.py 21, navid/constants.py
IDENTIFIER = "a video of historical observations and an image of the current observation"
# vlnce_task_navid_r2r.yaml: FORWARD_STEP_SIZE, TURN_ANGLE, HFOV, POSITION, WIDTH, HEIGHT
TASK = {"step": 0.25, "turn": 30, "hfov": 90, "eye": 1.25, "size": (640, 480)}


def agent_actions(said: str) -> list[int] | None:
    """`navid_agent.py` 225 to 253 and 333 to 353; None where it takes a random action."""
    output = said[:-1]
    if "stop" in output:
        return [0]
    for word, action, unit in (("forward", 1, CM), ("left", 2, DEGREES), ("right", 3, DEGREES)):
        if word in output:
            match = re.search(r"-?\d+", output)
            if match is None:
                return None
            return [action] * min(MOST, int(float(match.group()) / unit)) or None
    return None


def loaded_question(value: str) -> str:
    """`preprocess_multimodal`, train.py 380 to 391: the token is taken to the front."""
    if "<image>" in value:
        value = value.replace("<image>", "").strip()
        value = ("<image>\n" + value).strip()
    return value


def asked_question(template: str, task: str) -> str:
    """`predict_inference`: what the trained model is asked."""
    return "<image>\n" + template.format(task).replace("<image>", "")


def loaded_frames(path: Path, video_fps: int = 1) -> list[int]:
    """train.py 1059 to 1061; the scripts set video_fps 1 (scripts/uninavid_stage_1.sh 24)."""
    facts = inspect_clip(path)
    return list(range(0, facts.frames, round(facts.fps / video_fps)))


def talks_of(folder: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """(frames that the loader takes, entry) by walk, in order."""
    found: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    for entry in json.loads((folder / "annotations.json").read_bytes()):
        frames = len(loaded_frames(folder / entry["video"]))
        found.setdefault(entry["id"].rsplit("_", 1)[0], []).append((frames, entry))
    return found


def _walk(start: tuple[float, float, float], actions: list[int]) -> list[tuple[float, float]]:
    """Habitat's v0 actions at the sizes of NaVid's task, without walls."""
    x, y, _ = start
    turns, places = 0, [(x, y)]
    for action in actions:
        if action == 1:
            yaw = heading_yaw(start[2], turns, TASK["turn"])
            x, y = x + 0.25 * np.cos(yaw), y + 0.25 * np.sin(yaw)
        turns += {2: 1, 3: -1}.get(action, 0)
        places.append((x, y))
    return places


@pytest.fixture(scope="module")
def navid_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("navid") / "out"
    run_export(toy_source_for("navid"), "navid", out)
    return out


def test_navids_agent_walks_the_very_walk_that_was_exported(navid_folder: Path) -> None:
    """No random action, none left out: its answers lead along the poses, picture for picture."""
    trips = sorted(toy_source_for("navid").trips(), key=lambda trip: trip.episode.split)
    groups = talks_of(navid_folder)
    assert len(groups) == len(trips) == 6
    for trip, talks in zip(trips, groups.values(), strict=True):
        done: list[int] = []
        for frames, entry in talks:
            assert frames == len(done) + 1  # one picture an action, `act` 294 to 306
            actions = agent_actions(entry["conversations"][1]["value"])
            assert actions is not None, entry
            done += actions
        assert done == trip.actions
        places = np.array(_walk(trip.episode.start, done[:-1]))
        assert np.abs(places - trip.poses[:, :2]).max() < 1e-6


def test_the_trained_question_is_the_asked_one(
    navid_folder: Path, exported: Callable[[str], Path]
) -> None:
    for folder, template in (
        (navid_folder, NAVID_TEMPLATE),
        (exported("uninavid"), UNINAVID_TEMPLATE),
    ):
        for talks in talks_of(folder).values():
            for _, entry in talks:
                human = entry["conversations"][0]
                task = re.search(r"task is: '(.*)'\. Analyze", human["value"], re.DOTALL)
                assert task is not None and human["from"] == "human"
                assert loaded_question(human["value"]) == asked_question(template, task[1])
                assert IDENTIFIER in human["value"] and "NAV_ID" in entry["id"]


def test_uninavids_words_are_the_next_four_actions(exported: Callable[[str], Path]) -> None:
    trips = sorted(
        toy_source_for("uninavid", 1, longest=9).trips(), key=lambda trip: trip.episode.split
    )
    for trip, talks in zip(trips, talks_of(exported("uninavid")).values(), strict=True):
        words = [{"stop": 0, "forward": 1, "left": 2, "right": 3}]
        for number, (frames, entry) in enumerate(talks):
            said = [words[0][w] for w in entry["conversations"][1]["value"].split(" ")]
            assert frames == number + 1
            assert said == [*trip.actions, 0, 0, 0, 0][number : number + 4]


@pytest.mark.parametrize("name", ["navid", "uninavid"])
def test_walks_of_15_degrees_are_refused_with_the_command_that_helps(
    name: str, short_source: ExportSource, tmp_path: Path
) -> None:
    with pytest.raises(DataError, match="turn by 15°") as told:
        run_export(short_source, name, tmp_path / "out")
    assert f"gn0 missions generate SCENE --agent {name}" in str(told.value)
    assert "gn0 data build" in str(told.value) and "--merge-turns" in str(told.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["navid", "uninavid"])
def test_merged_turns_are_read_in_full_and_the_rest_is_counted(name: str, tmp_path: Path) -> None:
    source, out = toy_source(1), tmp_path / "out"
    done = run_export(source, name, out, ExportSettings(merge_turns=True))
    assert check_export(out) == []
    turned = {2: 0, 3: 0}
    single = 0
    for trip in source.trips():
        runs = re.findall(r"2+|3+", "".join(map(str, trip.moves)))
        single += sum(len(run) % 2 for run in runs)
        for run in runs:
            turned[int(run[0])] += len(run) // 2
    assert single > 0
    assert done.notes["single 15° turns without a word"] == single
    assert f"{single} × single 15° turns without a word" in (out / "README.md").read_text()
    if name == "navid":
        said: list[int] = []
        for talks in talks_of(out).values():
            for _, entry in talks:
                actions = agent_actions(entry["conversations"][1]["value"])
                assert actions is not None
                said += actions
        assert {2: said.count(2), 3: said.count(3)} == turned
        recovered = get_dataset_exporter("navid").load(out)
        assert all(found.moves is None for found in recovered)  # not the moves that were walked


def test_a_rate_that_loses_frames_is_never_written(tmp_path: Path) -> None:
    """At 5 frames a second its loader would see every fifth picture."""
    run_export(
        toy_source_for("navid", 1, longest=9), "navid", tmp_path / "a", ExportSettings(fps=5)
    )
    for talks in talks_of(tmp_path / "a").values():
        for frames, entry in talks:
            assert frames == int(entry["id"].rsplit("_", 1)[1]) + 1


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("The next action is turn left 15 degrees.", "random action"),
        ("The next action is turn right 45 degrees.", "does 30"),
        ("The next action is turn left 120 degrees.", "does 90"),
        ("The next action is move forward 20 cm.", "random action"),
        ("The next action is move forward 100 cm.", "does 75"),
        ("go on", "not in its words"),
    ],
)
def test_the_check_names_what_its_agent_would_misread(
    said: str, told: str, exported: Callable[[str], Path], tmp_path: Path
) -> None:
    import shutil

    folder = shutil.copytree(exported("navid"), tmp_path / "out")
    path = folder / "annotations.json"
    entries = json.loads(path.read_bytes())
    entries[0]["conversations"][1]["value"] = said
    path.write_text(json.dumps(entries))
    assert any(told in fault for fault in get_dataset_exporter("navid").check(folder))
    wanted = [int(n) for n in re.findall(r"\d+", said)]
    assert agent_actions(said) is None or sum(
        {1: CM, 2: DEGREES, 3: DEGREES}[a] for a in agent_actions(said) or []
    ) != sum(wanted)


def test_missions_for_navid_become_a_data_set_and_an_export(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command that the refusal names, from the scene to the clips."""
    save_scene(build_example_scene(), tmp_path / "flat")
    few = MissionSettings(per_scene=1, minimum_length=3.0, missions=("instruction",))
    generate_missions([tmp_path / "flat"], tmp_path / "missions", few, agent="navid")
    suite = load_suite(tmp_path / "missions")
    assert suite.about.agent.turn_degrees == TASK["turn"]
    assert suite.about.agent.camera_height == TASK["eye"]
    assert suite.about.agent.forward_step == TASK["step"]
    pictures = PictureSettings(layout="none")
    build_dataset(suite, tmp_path / "data", BuildSettings(pictures=pictures))
    source = open_source(tmp_path / "data")
    assert source.preset.picture_size == TASK["size"]
    assert source.preset.rgb.hfov == pytest.approx(TASK["hfov"])
    assert main(["export", "navid", str(tmp_path / "data"), "--limit", "1", "--every", "8",
                 "--out", str(tmp_path / "out")]) == 0  # fmt: skip
    assert "without a word" not in capsys.readouterr().out
    assert check_export(tmp_path / "out") == []
    for talks in talks_of(tmp_path / "out").values():
        assert all(agent_actions(e["conversations"][1]["value"]) for _, e in talks)
