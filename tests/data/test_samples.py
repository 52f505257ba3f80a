"""The sample table: what is written reads back, and what makes no sense is refused in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest

from gn0.data.sample_table import (
    COLUMNS,
    PICTURES,
    EpisodeRows,
    decode_rows,
    digest_labels,
    encode_rows,
    encode_table,
    load_sample_table,
)
from gn0.errors import FormatError


def make_rows(episode_id: str = "flat-1", steps: int = 4, seed: int = 0) -> EpisodeRows:
    rng = np.random.default_rng(seed)
    return EpisodeRows(
        episode_id=episode_id,
        poses=rng.uniform(-3, 3, (steps, 3)),
        executed=rng.integers(0, 4, steps).astype(np.int8),
        actions=rng.integers(0, 4, (steps, 6)).astype(np.int8),
        waypoints=rng.uniform(-3, 3, (steps, 13, 2)).astype(np.float32),
        pixels=rng.integers(0, 1000, (steps, 13, 2)).astype(np.int16),
        valid=rng.integers(1, 14, steps).astype(np.int8),
        distance=rng.uniform(0, 20, steps).astype(np.float32),
        collided=rng.integers(0, 2, steps).astype(bool),
    )


def dagger_rows() -> EpisodeRows:
    hashes = {name: tuple(f"{name}{i}" for i in range(3)) for name in PICTURES}
    rows = replace(make_rows("flat-2", 3, 1), source="dagger", policy_actions=((1, 2), (), (3,)))
    return rows.with_hashes(hashes)


@pytest.fixture
def table_path(tmp_path):
    path = tmp_path / "flat-0000.parquet"
    path.write_bytes(encode_table(encode_rows([make_rows(), dagger_rows()])))
    return path


def test_rows_read_back_as_they_were_written(table_path) -> None:
    written = [make_rows(), dagger_rows()]
    read = list(decode_rows(load_sample_table(table_path)))
    for before, after in zip(written, read, strict=True):
        for name in EpisodeRows.__dataclass_fields__:
            one, two = getattr(before, name), getattr(after, name)
            if isinstance(one, np.ndarray):
                assert one.dtype == two.dtype
                np.testing.assert_array_equal(one, two)
            else:
                assert one == two
    assert digest_labels(read) == digest_labels(written)


def test_the_same_rows_are_the_same_bytes() -> None:
    first, second = (encode_table(encode_rows([make_rows(), dagger_rows()])) for _ in range(2))
    assert first == second


def test_the_digest_sees_labels_and_not_pictures() -> None:
    rows = dagger_rows()
    bare = replace(rows, hashes={})
    assert digest_labels([rows]) == digest_labels([bare])
    moved = replace(rows, distance=rows.distance + np.float32(1e-3))
    assert digest_labels([rows]) != digest_labels([moved])


def test_a_dataset_without_samples_is_an_empty_table(tmp_path) -> None:
    path = tmp_path / "none.parquet"
    path.write_bytes(encode_table(encode_rows([])))
    assert list(decode_rows(load_sample_table(path))) == []


def _damage(table: pa.Table, name: str, values: list[object]) -> pa.Table:
    kind = dict(COLUMNS)[name]
    index = table.column_names.index(name)
    field = pa.field(name, kind, nullable=True)
    return table.set_column(index, field, pa.array(values, kind))


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("x", float("nan"), "NaN"),
        ("distance", -1.0, "not a distance"),
        ("executed", 4, "no action"),
        ("actions", [0, 0, 0, 0, 0, 9], "no action"),
        ("pixels", [1000] * 26, "outside 0 to 999"),
        ("valid", 0, "outside 1 to 13"),
        ("source", "human", "not one of expert, dagger, demonstration"),
        ("step", 7, "out of order"),
        ("episode_id", "flat-1", "belongs to an episode that was over"),
        ("yaw", None, "null"),
    ],
)
def test_a_value_without_meaning_names_its_column_and_row(tmp_path, name, value, words) -> None:
    table = encode_rows([make_rows("flat-1", 2), make_rows("flat-2", 2), make_rows("flat-3", 1)])
    values = table.column(name).to_pylist()
    values[4] = value
    path = tmp_path / "bad.parquet"
    import pyarrow.parquet as pq

    pq.write_table(_damage(table, name, values), path)
    with pytest.raises(FormatError, match=words) as caught:
        load_sample_table(path)
    assert name in str(caught.value) and "row 5" in str(caught.value)


@pytest.mark.parametrize(
    ("layout", "remedy"), [("0", "build the dataset again"), ("3", "newer gn0")]
)
def test_another_layout_says_what_to_do(tmp_path, layout, remedy) -> None:
    table = encode_rows([make_rows()]).replace_schema_metadata({"gn0.samples": layout})
    path = tmp_path / "old.parquet"
    import pyarrow.parquet as pq

    pq.write_table(table, path)
    with pytest.raises(FormatError, match="this version reads 1") as caught:
        load_sample_table(path)
    assert remedy in caught.value.remedy


def test_columns_are_all_there_and_of_their_types(tmp_path) -> None:
    import pyarrow.parquet as pq

    table, path = encode_rows([make_rows()]), tmp_path / "t.parquet"
    pq.write_table(table.drop_columns(["valid"]), path)
    with pytest.raises(FormatError, match="column is missing"):
        load_sample_table(path)
    index = table.column_names.index("valid")
    wide = table.set_column(index, "valid", table.column("valid").cast(pa.int64()))
    pq.write_table(wide, path)
    with pytest.raises(FormatError, match="column is int64, expected int8"):
        load_sample_table(path)
    pq.write_table(table.append_column("more", table.column("step")), path)
    with pytest.raises(FormatError, match="unknown or repeated"):
        load_sample_table(path)


def test_an_array_of_the_wrong_shape_is_refused() -> None:
    with pytest.raises(FormatError, match=r"waypoints has shape \[4, 12, 2\]"):
        rows = make_rows()
        encode_rows([replace(rows, waypoints=rows.waypoints[:, 1:])])
