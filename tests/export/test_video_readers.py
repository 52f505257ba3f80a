"""What StreamVLN's and NaVILA's loaders and evaluators make of our files, by their own rules.

Written down from InternRobotics/StreamVLN @e48f6ff7e9201d93aae003e8f64b04c00cec13bc
(`streamvln/dataset/vln_action_dataset.py`) and AnjieCheng/NaVILA
@76b98f233dd0fff05dfcd69435eec6740febff9d (`llava/data/dataset.py`,
`evaluation/vlnce_baselines/navila_trainer.py`); they share nothing with the exporters.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gn0.errors import DataError
from gn0.export.export_run import run_export
from gn0.export.exporter import ExportSettings
from gn0.export.trips import RGB, ExportSource, Trip
from gn0.testing.toy_trips import toy_source

NUM_FRAMES, FUTURE, HISTORY = 32, 4, 8  # scripts/streamvln_train_slurm.sh 39 to 41
SAID = {"step": 25, "turn": 15}  # vln_action_dataset.py 691: what its question calls the actions
CM, DEGREES = 25, 15  # navila_trainer.py 248, 261


def streamvln_samples(folder: Path) -> list[dict[str, Any]]:
    """`__init__` and `__getitem__`, 629 to 757: each sample with its pictures and answers."""
    entries = json.loads((folder / "annotations.json").read_text())
    found = []
    for entry in entries:
        video = os.path.join(folder, entry["video"])
        pictures = sorted(os.listdir(os.path.join(video, "rgb")))
        count = len(entry["actions"])
        if count < 4:
            continue
        for text in entry["instructions"]:
            for n in range(count // NUM_FRAMES + 1):
                if n * NUM_FRAMES == count:
                    continue
                actions = [*entry["actions"][1:], 0]
                times = np.arange(n * NUM_FRAMES, min((n + 1) * NUM_FRAMES, len(actions)))
                shown = np.arange(times[0], times[-1] + 1, FUTURE)
                past = np.arange(0, times[0], max(times[0] // HISTORY, 1)) if n else np.array([])
                found.append(
                    {
                        "text": text,
                        "first": int(times[0]),
                        "shown": [os.path.join(video, "rgb", pictures[i]) for i in shown],
                        "past": [os.path.join(video, "rgb", pictures[int(i)]) for i in past],
                        "said": [[actions[j] for j in times[i : i + FUTURE]]
                                 for i in range(0, len(times), FUTURE)],
                    }
                )  # fmt: skip
    return found


def navila_actions(said: str) -> list[int] | None:
    """`navila_trainer.py` 222 to 283; None where no pattern is found, which it takes for a stop."""
    patterns = (r"\bstop\b", r"\bis move forward\b", r"\bis turn left\b", r"\bis turn right\b")
    found = [n for n, pattern in enumerate(patterns) if re.search(pattern, said, re.IGNORECASE)]
    if not found:
        return None
    action = found[0]
    if action == 0:
        return [0]
    words, unit = {
        1: (r"move forward (\d+) cm", CM),
        2: (r"turn left (\d+) degree", DEGREES),
        3: (r"turn right (\d+) degree", DEGREES),
    }[action]
    match = re.search(words, said)
    amount = int(match.group(1)) if match else unit
    if amount % unit:
        amount = min((unit, 2 * unit, 3 * unit), key=lambda x: abs(x - amount))
    return [action] * (amount // unit)


def _trips(source: ExportSource) -> list[Trip]:
    return sorted(source.trips(), key=lambda trip: trip.episode.split)


def _look(source: ExportSource, trip: Trip, pose: int) -> np.ndarray:
    seen = next(source.eyes.look(trip, trip.poses[pose : pose + 1], source.preset, RGB)).rgb
    assert seen is not None
    return seen


def _same(path: str | Path, seen: np.ndarray) -> bool:
    with Image.open(path) as picture:
        return float(np.abs(np.asarray(picture).astype(int) - seen).mean()) < 8


def test_streamvlns_pictures_and_answers_go_together(tmp_path: Path) -> None:
    """At each picture it answers with the next four actions from that pose, STOP at the end."""
    source = toy_source(1)
    run_export(source, "streamvln", tmp_path / "out")
    samples = streamvln_samples(tmp_path / "out")
    trips = _trips(source)
    assert {s["text"] for s in samples} == {t.episode.instruction for t in trips}
    for trip in trips:
        own = [s for s in samples if s["text"] == trip.episode.instruction]
        if len({t.episode.instruction for t in trips}) < len(trips):
            own = [s for s in own if _same(s["shown"][0], _look(source, trip, s["first"]))]
        said = [a for sample in own for answer in sample["said"] for a in answer]
        assert said == trip.actions
        for sample in own:
            for number, (path, answer) in enumerate(
                zip(sample["shown"], sample["said"], strict=True)
            ):
                pose = sample["first"] + number * FUTURE
                assert answer == trip.actions[pose : pose + FUTURE]
                assert _same(path, _look(source, trip, pose))


def test_streamvln_refuses_actions_that_its_question_misnames(tmp_path: Path) -> None:
    """Its question says 15 degrees and 25 centimetres, whatever walked."""
    with pytest.raises(DataError, match=f"{SAID['turn']}°"):
        run_export(toy_source(1, turn=30.0), "streamvln", tmp_path / "out")


def test_navilas_evaluator_walks_the_very_walk_that_was_exported(tmp_path: Path) -> None:
    source = toy_source(1)
    run_export(source, "navila", tmp_path / "out", ExportSettings())
    walks: dict[str, list[dict[str, Any]]] = {}
    for entry in json.loads((tmp_path / "out/annotations.json").read_text()):
        walks.setdefault(entry["video_id"].split("-")[0], []).append(entry)
    for trip, talks in zip(_trips(source), walks.values(), strict=True):
        done: list[int] = []
        for entry in talks:
            assert len(entry["frames"]) == len(done) + 1  # a picture an action, the current last
            path = tmp_path / "out/train" / entry["frames"][-1]  # `image_path` ends in train
            assert _same(path, _look(source, trip, len(done)))
            actions = navila_actions(entry["a"])
            assert actions is not None
            done += actions
        assert done == trip.actions


def test_every_navila_answer_is_read_in_full(exported: Callable[[str], Path]) -> None:
    for entry in json.loads((exported("navila") / "annotations.json").read_text()):
        amounts = [int(n) for n in re.findall(r"\d+", entry["a"])]
        actions = navila_actions(entry["a"])
        assert actions is not None
        unit = {0: 0, 1: CM, 2: DEGREES, 3: DEGREES}[actions[0]]
        assert sum(amounts) == len(actions) * unit
