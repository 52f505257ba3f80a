"""Balancing: shares within half a point, nothing touched, the same bytes, and plain refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.cli.main import main
from gn0.data.balance import (
    BALANCE_FILE,
    NAMES,
    PAPER,
    SELECTION_FILE,
    BalanceSettings,
    balance_dataset,
    describe_balance,
    draw_rows,
    load_balance,
    load_selection,
    plan_selection,
    plan_weights,
)
from gn0.data.dataset import Dataset, open_dataset, save_dataset_file
from gn0.errors import DataError, FormatError, StorageError

TARGET = BalanceSettings().target
counts_of = st.lists(st.integers(1, 100_000), min_size=4, max_size=4).map(np.array)


def classes_of(dataset: Dataset) -> np.ndarray:
    return np.concatenate(
        [rows.actions[:, 0] for part in dataset.about.parts for rows in dataset.part_rows(part)]
    )


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in (BALANCE_FILE, SELECTION_FILE, ".lock")
    }


def test_the_target_is_the_paper_s_table() -> None:
    assert dict(zip(NAMES, (100 * TARGET).round(6).tolist(), strict=True)) == PAPER
    with pytest.raises(DataError, match="sum to"):
        _ = BalanceSettings(forward=50.0).target


@given(counts_of)
def test_weights_give_exactly_the_shares(counts: np.ndarray) -> None:
    weights = plan_weights(counts, TARGET)
    np.testing.assert_allclose(weights * counts / counts.sum(), TARGET)


@settings(max_examples=60)
@given(counts_of)
def test_a_selection_is_within_half_a_point_and_as_large_as_can_be(counts: np.ndarray) -> None:
    try:
        kept = plan_selection(counts, TARGET, 0.005)
    except DataError:
        assert counts.min() < 100  # only where whole samples are too coarse
        return
    size = int(kept.sum())
    assert (kept <= counts).all()
    assert (np.abs(kept / size - TARGET) <= 0.005 + 1e-9).all()
    larger = max(size + max(size // 100, 40), 1)  # no size clearly above it fits
    most = np.minimum(counts, (TARGET + 0.005) * larger).sum()
    assert most < larger or (counts < (TARGET - 0.005) * larger).any() or larger > counts.sum()


def test_samples_that_fit_already_are_all_kept() -> None:
    counts = np.array([3, 67, 15, 15])
    assert plan_selection(counts, TARGET, 0.005).tolist() == counts.tolist()
    assert plan_weights(counts, TARGET).tolist() == pytest.approx([1.0] * 4)


@pytest.mark.parametrize("method", ["weights", "selection"])
def test_a_dataset_is_balanced_and_its_samples_are_not_touched(
    labels_only: Dataset, copy_of: Callable[[Dataset], Path], method: str
) -> None:
    folder = copy_of(labels_only)
    before = files_of(folder)
    about = balance_dataset(
        open_dataset(folder),
        BalanceSettings(method=method, tolerance=0.8),  # type: ignore[arg-type]
    )
    assert files_of(folder) == before
    assert about == load_balance(folder)
    table = load_selection(folder)
    classes = classes_of(labels_only)
    rows = {
        (part.name, row): (block.episode_id, step)
        for part in labels_only.about.parts
        for row, (block, step) in enumerate(
            (block, step) for block in labels_only.part_rows(part) for step in range(len(block))
        )
    }
    names = list(rows)
    drawn = np.zeros(4)
    for item in table.to_pylist():
        key = (item["part"], item["row"])
        assert rows[key] == (item["episode_id"], item["step"])
        drawn[classes[names.index(key)]] += item["weight"]
    assert np.abs(100 * drawn / drawn.sum() - 100 * TARGET).max() <= 0.8 + 1e-3
    found = {name: about.after[name].percent for name in NAMES}
    assert found == pytest.approx(
        dict(zip(NAMES, 100 * drawn / drawn.sum(), strict=True)), abs=0.01
    )
    counts = np.bincount(classes, minlength=4)
    assert [about.before[name].count for name in NAMES] == counts.tolist()
    assert about.samples == len(classes)
    if method == "weights":
        w = table["weight"].to_numpy().astype(np.float64)
        kish = 1.0 / ((w / w.sum()) ** 2).sum()  # Kish 1965: n_eff = (Σw)² / Σw²
        assert about.kept == len(classes) and about.effective == pytest.approx(kish, abs=0.06)
        assert about.effective < len(classes)
        picked = classes[draw_rows(table["weight"].to_numpy(), 40_000, 1)]
        assert np.abs(np.bincount(picked, minlength=4) / 40_000 - TARGET).max() < 0.01


@pytest.mark.parametrize("method", ["weights", "selection"])
def test_the_same_settings_give_the_same_bytes(
    labels_only: Dataset, copy_of: Callable[[Dataset], Path], method: str
) -> None:
    folder = copy_of(labels_only)
    asked = BalanceSettings(method=method, tolerance=1.0, seed=4)  # type: ignore[arg-type]
    balance_dataset(open_dataset(folder), asked)
    first = (folder / BALANCE_FILE).read_bytes(), (folder / SELECTION_FILE).read_bytes()
    balance_dataset(open_dataset(folder), asked)
    assert first == ((folder / BALANCE_FILE).read_bytes(), (folder / SELECTION_FILE).read_bytes())
    other = BalanceSettings(method="selection", tolerance=1.0, seed=5)
    balance_dataset(open_dataset(folder), other)
    assert (folder / SELECTION_FILE).read_bytes() != first[1]


def test_what_cannot_be_reached_is_said() -> None:
    with pytest.raises(DataError) as caught:
        plan_weights(np.array([0, 80, 10, 10]), TARGET)
    assert "STOP" in caught.value.what and "--stop 0" in caught.value.remedy
    with pytest.raises(DataError, match="no samples"):
        plan_weights(np.zeros(4, int), TARGET)
    with pytest.raises(DataError, match="no selection"):
        plan_selection(np.array([1, 5, 1, 1]), TARGET, 0.0)
    assert (
        plan_selection(np.array([0, 67, 15, 15]), np.array([0, 0.7, 0.15, 0.15]), 0.02).sum() > 90
    )


def test_scarce_actions_are_named(labels_only: Dataset, copy_of: Callable[[Dataset], Path]) -> None:
    folder = copy_of(labels_only)
    asked = BalanceSettings(forward=9.0, left=1.0, right=80.0, stop=10.0, tolerance=3.0)
    about = balance_dataset(open_dataset(folder), asked)
    assert about.weights["RIGHT"] > 3
    text = describe_balance(about)
    assert "independent" in text and "80.0%" in text
    kept = balance_dataset(
        open_dataset(folder),
        BalanceSettings(
            method="selection", forward=9.0, left=1.0, right=80.0, stop=10.0, tolerance=3.0
        ),
    )
    assert any("RIGHT is scarce" in note for note in kept.notes)


def test_a_damaged_selection_is_noticed(
    labels_only: Dataset, copy_of: Callable[[Dataset], Path]
) -> None:
    folder = copy_of(labels_only)
    with pytest.raises(StorageError):
        load_balance(folder)
    balance_dataset(open_dataset(folder), BalanceSettings(method="selection", tolerance=1.0))
    other = (folder / SELECTION_FILE).read_bytes()
    balance_dataset(
        open_dataset(folder), BalanceSettings(method="selection", tolerance=1.0, seed=1)
    )
    (folder / SELECTION_FILE).write_bytes(other)
    with pytest.raises(FormatError, match="damaged"):
        load_selection(folder)
    (folder / SELECTION_FILE).write_bytes(other[:100])
    with pytest.raises(FormatError):
        load_selection(folder)


def test_a_selection_of_other_labels_is_refused(
    labels_only: Dataset, copy_of: Callable[[Dataset], Path]
) -> None:
    folder = copy_of(labels_only)
    balance_dataset(open_dataset(folder))
    about = labels_only.about
    other = msgspec.structs.replace(about.parts[0], labels=about.parts[0].labels[::-1])
    save_dataset_file(folder, msgspec.structs.replace(about, parts=(other, *about.parts[1:])))
    with pytest.raises(DataError, match="other labels"):
        load_selection(folder)


def test_the_command_prints_before_and_after(
    labels_only: Dataset, copy_of: Callable[[Dataset], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(labels_only)
    assert main(["data", "balance", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "FORWARD" in said and "67.0%" in said and BALANCE_FILE in said
    assert main(["data", "balance", str(folder), "--forward", "10"]) == 2
    assert "sum to" in capsys.readouterr().err
