"""The shape of VLN-CE files: ours, the real ones, and what the check knows, held together."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.export.export_run import run_export
from gn0.export.exporter import ExportSettings, get_dataset_exporter
from gn0.export.schema import describe_shape, shape_differences
from gn0.export.vlnce import MAPS, R2R_SHAPE, TRUTH_SHAPE
from gn0.missions.sets.json_file import load_exact
from gn0.testing.toy_trips import toy_source

REAL = "vln/R2R_VLNCE_v1-2_preprocessed"


def _shapes(document: Any, truth: Any) -> tuple[Any, Any]:
    return describe_shape(document, MAPS), describe_shape({"truth": truth}, MAPS)["truth"]


def test_what_the_check_knows_is_the_real_shape(shared_data: Path) -> None:
    folder = shared_data / REAL / "val_seen"
    found = _shapes(
        load_exact(folder / "val_seen.json.gz"), load_exact(folder / "val_seen_gt.json.gz")
    )
    assert shape_differences(found[0], R2R_SHAPE) == []
    assert shape_differences(found[1], TRUTH_SHAPE) == []


def test_ours_has_the_shape_of_the_real_files(shared_data: Path, tmp_path: Path) -> None:
    """Field by field, types and order of keys; tokens, vocabulary and ground truth as they are."""
    run_export(toy_source(), "vlnce-r2r", tmp_path / "out", ExportSettings())
    real = shared_data / REAL / "val_seen"
    wanted = _shapes(
        load_exact(real / "val_seen.json.gz"), load_exact(real / "val_seen_gt.json.gz")
    )
    for split in ("train", "test"):
        document = load_exact(tmp_path / f"out/{split}/{split}.json.gz")
        truth = load_exact(tmp_path / f"out/{split}/{split}_gt.json.gz")
        found = _shapes(document, truth)
        for ours, theirs in zip(found, wanted, strict=True):
            assert shape_differences(ours, theirs) == []
        vocab = document["instruction_vocab"]
        assert vocab["word_list"][:2] == ["<pad>", "<unk>"]
        for episode in document["episodes"]:
            tokens = episode["instruction"]["instruction_tokens"]
            assert len(tokens) == 200 and max(tokens) < vocab["num_vocab"]
            gt = truth[str(episode["episode_id"])]
            assert gt["actions"][-1] == 0 and gt["actions"].count(0) == 1
            assert gt["forward_steps"] == gt["actions"].count(1) == len(gt["locations"]) - 1
            assert gt["locations"][0] == pytest.approx(episode["start_position"])


def test_splits_share_their_words_and_paths_their_number(
    exported: Callable[[str], Path], tmp_path: Path
) -> None:
    run_export(toy_source(), "vlnce-r2r", tmp_path / "out", ExportSettings())
    documents = [load_exact(tmp_path / f"out/{s}/{s}.json.gz") for s in ("train", "test")]
    assert documents[0]["instruction_vocab"] == documents[1]["instruction_vocab"]
    numbers = [e["trajectory_id"] for e in documents[0]["episodes"]]
    assert len(numbers) == 3 and len(set(numbers)) == 2


def test_rxr_names_language_and_annotator(exported: Callable[[str], Path]) -> None:
    document = load_exact(exported("vlnce-rxr") / "train/train_guide.json.gz")
    assert list(document) == ["episodes"]
    instruction = document["episodes"][0]["instruction"]
    assert set(instruction) == {
        "instruction_id", "instruction_text", "language", "annotator_id", "edit_distance",
        "timed_instruction",
    }  # fmt: skip
    assert instruction["language"] == "en-US"
    assert (exported("vlnce-rxr") / "train/train_guide_gt.json.gz").is_file()
    card = (exported("vlnce-rxr") / "README.md").read_text()
    assert "2 × ground truth in turns other than the 30°" in card and "turns of 15°" in card


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d, t: d["episodes"][0].update(scan="x"), "unknown"),
        (lambda d, t: d["episodes"][0].pop("trajectory_id"), "missing"),
        (lambda d, t: d["episodes"][0]["instruction"].update(instruction_text=3), "str"),
        (lambda d, t: d["episodes"][0]["instruction"]["instruction_tokens"].pop(), "200 in all"),
        (lambda d, t: d["instruction_vocab"]["itos"].pop(), "do not agree"),
        (lambda d, t: t.popitem(), "ground truth"),
        (lambda d, t: next(iter(t.values()))["locations"].pop(), "locations for"),
        (lambda d, t: next(iter(t.values()))["actions"].pop(), "STOP at the end"),
    ],
)
def test_the_check_names_what_a_loader_would_stumble_over(
    exported: Callable[[str], Path], tmp_path: Path, change: Callable[..., Any], told: str
) -> None:
    import shutil

    folder = shutil.copytree(exported("vlnce-r2r"), tmp_path / "out")
    paths = [folder / "train/train.json.gz", folder / "train/train_gt.json.gz"]
    document, truth = map(load_exact, paths)
    change(document, truth)
    for path, value in zip(paths, (document, truth), strict=True):
        path.write_bytes(gzip.compress(json.dumps(value).encode()))
    faults = get_dataset_exporter("vlnce-r2r").check(folder)
    assert any(told in fault for fault in faults), faults


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=2), inner),
    max_leaves=12,
)


@given(_JSON, _JSON)
def test_a_shape_equals_itself_and_never_crashes(one: Any, other: Any) -> None:
    assert shape_differences(describe_shape(one), describe_shape(one)) == []
    assert isinstance(shape_differences(describe_shape(one), describe_shape(other)), list)
    assert isinstance(describe_shape([one, other]), list)
