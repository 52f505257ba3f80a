"""Every format: out, checked, back, twice the same, after a stop, damaged; and what it may hold."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gn0.errors import ConfigError, Gn0Error
from gn0.export.export_run import run_export
from gn0.export.exporter import (
    DatasetExporter,
    ExportSettings,
    dataset_exporter_names,
    get_dataset_exporter,
)
from gn0.export.trips import ExportSource
from gn0.seeds import random_stream
from gn0.testing.dataset_exporter_check import check_dataset_exporter, check_round_trip
from gn0.testing.toy_trips import toy_source, toy_source_for
from gn0_trials.json_mutants import mutate_json

FORMATS = dataset_exporter_names()
WITHOUT_PICTURES = ("gn-matrix", "gn-matrix-json", "vlnce-r2r", "vlnce-rxr")
FAST = ExportSettings(views=("n1_60cm_30deg",), spacing=0.2, every=3)


def test_twelve_formats_are_there() -> None:
    assert len(FORMATS) >= 12
    for name in FORMATS:
        exporter = get_dataset_exporter(name)
        assert isinstance(exporter, DatasetExporter) and exporter.name == name
    with pytest.raises(ConfigError, match="known: gn-matrix"):
        get_dataset_exporter("xyzzy")
    with pytest.raises(ConfigError, match=r"did you mean navid .* or navila"):
        get_dataset_exporter("navi")


@pytest.mark.parametrize("name", FORMATS)
def test_exporter_keeps_the_protocol(name: str) -> None:
    check_dataset_exporter(
        lambda: get_dataset_exporter(name), toy_source_for(name, 1, longest=9), FAST
    )


@pytest.mark.parametrize("name", WITHOUT_PICTURES)
def test_six_trips_with_two_missions_of_a_path(name: str, tmp_path: Path) -> None:
    check_round_trip(get_dataset_exporter(name), toy_source(), tmp_path / "out", FAST)


@pytest.mark.parametrize("name", ["navid", "navila", "streamvln"])
def test_moves_come_back_when_every_decision_is_asked(name: str, tmp_path: Path) -> None:
    pairs = check_round_trip(
        get_dataset_exporter(name),
        toy_source_for(name, 1, longest=9),
        tmp_path / "out",
        ExportSettings(),
    )
    for trip, found in pairs:
        assert found.moves == tuple(trip.moves.tolist())


@pytest.mark.parametrize("name", FORMATS)
def test_changed_values_are_told_and_never_crash(
    name: str, exported: Callable[[str], Path], tmp_path: Path
) -> None:
    """JSON that is whole but says something else: faults or errors of ours, nothing foreign."""
    folder = shutil.copytree(exported(name), tmp_path / "mutant")
    exporter = get_dataset_exporter(name)
    rng = random_stream(7, "export mutants", name)
    files = [p for p in sorted(folder.rglob("*.json*")) if p.suffix in (".json", ".jsonl")]
    for number in range(12):
        path = files[number % len(files)]
        whole = path.read_bytes()
        path.write_bytes(mutate_json(whole, rng, lines=path.suffix == ".jsonl"))
        assert isinstance(exporter.check(folder), list)
        with contextlib.suppress(Gn0Error):
            exporter.load(folder)
        path.write_bytes(whole)


def test_card_says_source_licence_frame_and_reader(exported: Callable[[str], Path]) -> None:
    for name in FORMATS:
        card = (exported(name) / "README.md").read_text()
        exporter = get_dataset_exporter(name)
        for words in (exporter.title, exporter.frame, "CC0-1.0", "plan-0", "gn0 export check"):
            assert words.replace("|", "\\|") in card, (name, words)


def _json(path: Path) -> Any:
    return json.loads(path.read_bytes())


def test_streamvln_leaves_the_stop_to_its_loader(exported: Callable[[str], Path]) -> None:
    for entry in _json(exported("streamvln") / "annotations.json"):
        pictures = sorted((exported("streamvln") / entry["video"] / "rgb").iterdir())
        assert entry["actions"][0] == -1 and 0 not in entry["actions"]
        assert len(entry["actions"]) == len(pictures) == 9
        assert pictures[0].name == "001.jpg"
        assert list(entry) == ["id", "video", "instructions", "actions"]


def test_navila_answers_in_the_phrases_of_its_evaluator(exported: Callable[[str], Path]) -> None:
    """What its evaluator looks for: amounts after "is move forward", "is turn …", or "stop"."""
    import re

    forward, turn = re.compile(r"is move forward (\d+) cm"), r"is turn (left|right) (\d+) degree"
    for entry in _json(exported("navila") / "annotations.json"):
        answer = entry["a"]
        moved, turned = forward.search(answer), re.search(turn, answer)
        assert (moved is not None) + (turned is not None) + ("stop" in answer) == 1
        assert moved is None or int(moved[1]) in (25, 50, 75)
        assert turned is None or int(turned[2]) in (15, 30, 45)


def test_lerobot_counts_on_over_episodes_and_splits(exported: Callable[[str], Path]) -> None:
    import pyarrow.parquet as pq

    folder = exported("lerobot-v3")
    info = _json(folder / "meta/info.json")
    assert info["codebase_version"] == "v3.0" and info["total_frames"] == 18
    assert info["splits"] == {"test": "0:1", "train": "1:2"}
    table = pq.ParquetFile(folder / "data/chunk-000/file-000.parquet").read(use_threads=False)
    assert table.column("index").to_pylist() == list(range(18))
    actions = np.array(table.column("action").to_pylist())
    moves = np.array(table.column("label.discrete").to_pylist())
    assert np.allclose(actions[moves == 1], (0.25, 0, 0), atol=1e-5)
    assert np.allclose(actions[moves == 2][:, 2], np.radians(15), atol=1e-5)
    tasks = pq.ParquetFile(folder / "meta/tasks.parquet").read(use_threads=False)
    assert b'"index_columns": ["task"]' in tasks.schema.metadata[b"pandas"]
    assert not (folder / "parts").exists()


def test_a_limit_and_a_split_are_counted(short_source: ExportSource, tmp_path: Path) -> None:
    done = run_export(short_source, "vlnce-r2r", tmp_path / "one", ExportSettings(split="train"))
    assert done.written == 1 and done.skipped == {"not of the split 'train'": 1}
    done = run_export(short_source, "vlnce-r2r", tmp_path / "two", ExportSettings(limit=1))
    assert done.written == 1 and done.skipped == {"beyond the limit of 1 episodes": 1}
