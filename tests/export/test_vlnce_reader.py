"""What VLN-CE's loaders and models make of our files, by their own rules.

The rules are written down from jacobkrantz/VLN-CE @729d141b2ee10628061ada74dd3a5b9f70faeba5
(`habitat_extensions/task.py`, `habitat_extensions/sensors.py`, `vlnce_baselines/config/default.py`,
`vlnce_baselines/models/encoders/instruction_encoder.py`) and facebookresearch/habitat-lab
(`habitat/datasets/utils.py`, `habitat/tasks/vln/vln.py`), and share nothing with the exporter. What
R2R itself looks like is measured on its own files.
"""

from __future__ import annotations

import gzip
import json
import math
import re
import shutil
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest

from gn0.cli.main import main
from gn0.errors import FormatError, Gn0Error, StorageError
from gn0.export.export_run import check_export, remark_export, run_export
from gn0.export.exporter import ExportSettings, get_dataset_exporter
from gn0.export.nodes import thin_path
from gn0.export.trips import ExportSource
from gn0.missions.sets.vocabulary import cut_words, load_r2r_words
from gn0.testing.toy_trips import toy_source

REAL = "vln/R2R_VLNCE_v1-2_preprocessed"
ROWS = 2504  # default.py 224: rows of embeddings.json.gz, in the order of R2R's word_list
FEATURE_ROWS = 512  # sensors.py 179
# keys that attrs would refuse elsewhere: habitat's Episode, NavigationEpisode and VLNEpisode,
# task.py 36 to 43; InstructionData; task.py 21 to 33
EPISODE = {"episode_id", "scene_id", "start_position", "start_rotation", "info", "start_room",
           "goals", "shortest_paths", "reference_path", "instruction",
           "trajectory_id"}  # fmt: skip
INSTRUCTION = {"instruction_text", "instruction_tokens"}
RXR_INSTRUCTION = {"instruction_text", "instruction_id", "language", "annotator_id",
                   "edit_distance", "timed_instruction", "instruction_tokens", "split"}  # fmt: skip


def habitat_words(text: str) -> list[str]:
    """`tokenize` of habitat/datasets/utils.py."""
    for mark in (",", "?"):
        text = text.lower().replace(mark, "")
    return [part.strip() for part in re.split(r"([^\w-]+)", text) if part.strip()]


def loaded_episodes(path: Path, instruction: set[str]) -> Iterator[dict[str, Any]]:
    """`from_json`, task.py 74 to 106 and 161 to 180."""
    with gzip.open(path, "rt") as stream:
        document = json.load(stream)
    if instruction is INSTRUCTION:
        assert document["instruction_vocab"]["word_list"]
    for episode in document["episodes"]:
        assert set(episode) <= EPISODE and set(episode["instruction"]) <= instruction
        assert all(set(goal) <= {"position", "radius"} for goal in episode["goals"])
        yield episode


def read_as(tokens: list[int], table: list[str]) -> list[str]:
    """`InstructionEncoder.forward`: zeros are no words, the others are rows of the table."""
    return [table[token] for token in tokens if token != 0]


@pytest.fixture(scope="module")
def r2r(shared_data: Path) -> Path:
    return shared_data / REAL / "val_seen/val_seen.json.gz"


@pytest.fixture(scope="module")
def table(r2r: Path) -> list[str]:
    """The words of the rows of R2R's embeddings."""
    with gzip.open(r2r, "rt") as stream:
        words: list[str] = json.load(stream)["instruction_vocab"]["word_list"]
    assert len(words) == ROWS
    return words


def _split(folder: Path, split: str = "train", role: str = "") -> Path:
    return folder / split / f"{split}{role}.json.gz"


def test_r2rs_own_texts_are_cut_into_r2rs_own_tokens(r2r: Path, table: list[str]) -> None:
    index = {word: number for number, word in enumerate(table)}
    for episode in loaded_episodes(r2r, INSTRUCTION):
        text = episode["instruction"]["instruction_text"]
        wanted = [token for token in episode["instruction"]["instruction_tokens"] if token]
        assert [index.get(word, 1) for word in cut_words(text)][:200] == wanted
        assert cut_words(text) == habitat_words(text)


def test_with_r2rs_vocabulary_its_models_read_what_is_written(
    r2r: Path, table: list[str], tmp_path: Path
) -> None:
    source = toy_source()
    done = run_export(source, "vlnce-r2r", tmp_path / "out", ExportSettings(vocabulary=str(r2r)))
    lost = 0
    for split in ("train", "test"):
        for episode in loaded_episodes(_split(tmp_path / "out", split), INSTRUCTION):
            words = habitat_words(episode["instruction"]["instruction_text"])
            wanted = [word if word in table else "<unk>" for word in words]
            assert read_as(episode["instruction"]["instruction_tokens"], table) == wanted
            lost += wanted.count("<unk>")
    assert lost and done.notes == {"word that R2R's vocabulary lacks, read as <unk>": lost}
    assert check_export(tmp_path / "out") == []
    (told,) = remark_export(tmp_path / "out")
    assert "là 2" in told  # the odd word of two toy trips, by name
    assert done.settings.vocabulary == "R2R"  # and nobody's path
    assert str(r2r.parent) not in (tmp_path / "out/export.json").read_text()


def test_without_it_card_and_check_say_that_the_models_misread(
    table: list[str],
    exported: Callable[[str], Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = exported("vlnce-r2r")
    episode = next(loaded_episodes(_split(out), INSTRUCTION))
    words = habitat_words(episode["instruction"]["instruction_text"])
    assert read_as(episode["instruction"]["instruction_tokens"], table) != words
    assert main(["export", "check", str(out)]) == 0
    said = capsys.readouterr().out
    for text in (said, (out / "README.md").read_text()):
        assert "will misread the instructions" in text and "--vocabulary" in text
    assert "no faults" in said


def test_a_vocabulary_of_another_set_is_refused_before_anything_is_written(
    r2r: Path, exported: Callable[[str], Path], short_source: ExportSource, tmp_path: Path
) -> None:
    half = tmp_path / "half.json.gz"
    half.write_bytes(r2r.read_bytes()[:100_000])
    swapped = tmp_path / "swapped.json.gz"
    with gzip.open(r2r, "rt") as stream:
        words = json.load(stream)["instruction_vocab"]["word_list"]
    words[7], words[8] = words[8], words[7]
    swapped.write_bytes(
        gzip.compress(json.dumps({"instruction_vocab": {"word_list": words}}).encode())
    )
    ours = exported("vlnce-r2r")
    for path, kind, told in (
        (_split(ours), FormatError, "vocabulary of another set"),
        (swapped, FormatError, "vocabulary of another set"),
        (ours / "train/train_gt.json.gz", FormatError, "no vocabulary in it"),
        (_split(exported("vlnce-rxr"), role="_guide"), FormatError, "no vocabulary in it"),
        (half, FormatError, "not a whole gzip file"),
        (tmp_path / "absent.json.gz", StorageError, "No such file"),
        (tmp_path, Gn0Error, "is a directory"),
    ):
        with pytest.raises(kind, match=f"(?i){told}"):
            run_export(
                short_source, "vlnce-r2r", tmp_path / "out", ExportSettings(vocabulary=str(path))
            )
        assert not (tmp_path / "out").exists()


def test_the_same_words_from_another_file_are_the_same_export(
    r2r: Path, short_source: ExportSource, tmp_path: Path
) -> None:
    copy = shutil.copy(r2r, tmp_path / "copy.json.gz")
    one = run_export(
        short_source, "vlnce-r2r", tmp_path / "out", ExportSettings(vocabulary=str(r2r))
    )
    two = run_export(
        short_source, "vlnce-r2r", tmp_path / "out", ExportSettings(vocabulary=str(copy))
    )
    assert one == two
    assert len(load_r2r_words(copy)) == ROWS


def test_reference_paths_have_as_few_nodes_as_r2rs(shared_data: Path, r2r: Path) -> None:
    """R2R's own dense ways, thinned: as many nodes as R2R has, as far apart, as near the way."""
    with gzip.open(r2r.with_name("val_seen_gt.json.gz"), "rt") as stream:
        truth = json.load(stream)
    counts: dict[str, list[int]] = {"real": [], "ours": []}
    legs: dict[str, list[float]] = {"real": [], "ours": []}
    aside: dict[str, float] = {"real": 0.0, "ours": 0.0}
    for episode in loaded_episodes(r2r, INSTRUCTION):
        way = np.array(truth[str(episode["episode_id"])]["locations"])[:, [0, 2]]
        for name, nodes in (
            ("real", np.array(episode["reference_path"])[:, [0, 2]]),
            ("ours", thin_path(way)),
        ):
            counts[name].append(len(nodes))
            legs[name] += np.hypot(*np.diff(nodes, axis=0).T).tolist()
            apart = np.hypot(*(nodes[:, None] - way).transpose(2, 0, 1))
            aside[name] = max(aside[name], float(apart.min(axis=1).max()))
        assert np.array_equal(thin_path(way)[[0, -1]], way[[0, -1]])
    assert median(counts["real"]) == 6 and 5 <= median(counts["ours"]) <= 7
    low, high = np.percentile(legs["real"], [5, 95])
    assert low <= median(legs["ours"]) <= high
    assert aside["ours"] <= aside["real"] + 1e-9


def test_an_export_has_thin_paths_and_dense_truth(
    exported: Callable[[str], Path], tmp_path: Path
) -> None:
    source = toy_source()
    run_export(source, "vlnce-r2r", tmp_path / "out", ExportSettings())
    trips = sorted(source.trips(), key=lambda trip: trip.episode.split)
    episodes = [
        episode
        for split in ("test", "train")
        for episode in loaded_episodes(_split(tmp_path / "out", split), INSTRUCTION)
    ]
    for trip, episode in zip(trips, episodes, strict=True):
        nodes = np.array(episode["reference_path"])
        assert (nodes[:, 1] == 0).all()
        assert np.allclose(nodes[0, [0, 2]], [trip.episode.path[0][0], -trip.episode.path[0][1]])
        assert np.allclose(nodes[-1, [0, 2]], [trip.episode.path[-1][0], -trip.episode.path[-1][1]])
        way = sum(math.dist(a, b) for a, b in pairwise(trip.episode.path))
        assert len(nodes) <= 2 + way / 1.25


def test_the_truth_replays_step_by_step(tmp_path: Path) -> None:
    """habitat's v0 actions along `locations`, which NDTW and SDTW are measured against."""
    run_export(toy_source(), "vlnce-r2r", tmp_path / "out", ExportSettings())
    with gzip.open(tmp_path / "out/train/train_gt.json.gz", "rt") as stream:
        truth = json.load(stream)
    for episode in loaded_episodes(_split(tmp_path / "out"), INSTRUCTION):
        gt = truth[str(episode["episode_id"])]
        _, y, _, w = episode["start_rotation"]
        place, heading = np.array(episode["start_position"]), 2 * math.atan2(y, w)
        places = [place]
        for action in gt["actions"]:
            if action == 1:
                place = place - 0.25 * np.array([math.sin(heading), 0, math.cos(heading)])
                places.append(place)
            heading += {2: 1, 3: -1}.get(action, 0) * math.radians(15)
        assert np.abs(np.array(places) - gt["locations"]).max() < 1e-9


def test_rxr_says_that_its_text_features_are_not_there(
    exported: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    out = exported("vlnce-rxr")
    for episode in loaded_episodes(_split(out, role="_guide"), RXR_INSTRUCTION):
        instruction = episode["instruction"]
        named = "rxr_{split}/{id:06}_{lang}_text_features.npz".format(  # default.py 30
            split="train", id=int(instruction["instruction_id"]),
            lang=instruction["language"].split("-")[0],
        )  # fmt: skip
        assert re.fullmatch(r"rxr_train/\d{6}_en_text_features\.npz", named)
    assert not list(out.rglob("*text_features*"))
    assert main(["export", "check", str(out)]) == 0
    for text in (capsys.readouterr().out, (out / "README.md").read_text()):
        assert "text_features/rxr_{split}/{id:06}_en_text_features.npz" in text
        assert str(FEATURE_ROWS) in text


def test_the_check_still_names_tokens_of_no_word(
    r2r: Path, short_source: ExportSource, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run_export(short_source, "vlnce-r2r", out, ExportSettings(vocabulary=str(r2r)))
    path = _split(out)
    document = json.loads(gzip.decompress(path.read_bytes()))
    document["episodes"][0]["instruction"]["instruction_tokens"][0] = ROWS
    path.write_bytes(gzip.compress(json.dumps(document).encode()))
    faults = get_dataset_exporter("vlnce-r2r").check(out)
    assert any("not words and then zeros" in fault for fault in faults)
