"""Whatever is damaged is named, and is the same bytes again after a repair."""

from __future__ import annotations

import shutil
import tarfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gn0.cli.main import main
from gn0.data.dataset import open_dataset
from gn0.data.repair import repair_dataset
from gn0.data.sample_table import (
    EpisodeRows,
    decode_rows,
    encode_rows,
    encode_table,
    load_sample_table,
)
from gn0.data.verify import verify_dataset
from gn0.errors import Gn0Error


def flip(path: Path, at: int, bits: int = 0x20) -> None:
    data = bytearray(path.read_bytes())
    data[at % len(data)] ^= bits
    path.unlink()  # scenes are hard links
    path.write_bytes(data)


def test_a_whole_dataset_is_whole(webdataset, lerobot, labels_only) -> None:
    for dataset in (webdataset, lerobot, labels_only):
        report = verify_dataset(dataset.folder)
        assert report.ok, report.damages
        assert report.samples == dataset.about.rows
    assert verify_dataset(labels_only.folder).layouts == ()
    report = verify_dataset(webdataset.folder, pixels=True)
    assert report.ok and report.pixels == webdataset.about.rows


def test_every_file_is_looked_at(webdataset) -> None:
    """All but dataset.json, which is read first, and the manifest, which names the others."""
    files = [p for p in webdataset.folder.rglob("*") if p.is_file() and p.name != ".lock"]
    assert verify_dataset(webdataset.folder).files == len(files) - 2


@pytest.mark.parametrize("fixture", ["webdataset", pytest.param("lerobot", marks=pytest.mark.slow)])
def test_damage_anywhere_is_named_and_repaired(
    fixture, request, copy_of, files_of, data_suite
) -> None:
    """One bit in each file, one file after the other; and each file gone."""
    dataset = request.getfixturevalue(fixture)
    folder = copy_of(dataset)
    before = files_of(folder)
    broken: set[str] = set()
    for number, name in enumerate(before):
        if name == "dataset.json":
            continue
        broken.add(name)
        path = folder / name
        if number % 3 == 0:
            path.unlink()
        else:
            flip(path, 7919 * number)
        report = verify_dataset(folder)
        if not any(own.endswith("manifest.json") for own in broken):  # it names the others
            assert {damage.path for damage in report.damages} == broken
        assert name in {damage.path for damage in report.damages}
        if name.startswith("pictures/") and number % 2:
            continue  # some damages are repaired together
        repaired = repair_dataset(folder, suite=data_suite.folder)
        assert repaired.ok, (name, repaired.left, repaired.reasons)
        assert files_of(folder) == before, name
        broken.clear()
    assert repair_dataset(folder, suite=data_suite.folder).ok
    assert files_of(folder) == before


def test_a_damaged_member_is_named_by_its_sample(webdataset, copy_of) -> None:
    folder = copy_of(webdataset)
    shard = folder / "pictures" / "webdataset" / f"{webdataset.about.parts[0].name}.tar"
    with tarfile.open(shard) as members:
        first = next(one for one in members if one.name.endswith("rgb.jpg"))
    flip(shard, first.offset_data + 100)
    (damage,) = verify_dataset(folder).damages
    name = webdataset.sampled[0]
    assert damage.rows == (f"rgb.jpg of row 1 (episode {name!r}, step 0)",)


def test_a_changed_label_is_named_by_its_row(labels_only, copy_of, files_of) -> None:
    folder = copy_of(labels_only)
    before = files_of(folder)
    part = labels_only.about.parts[1]
    path = folder / part.path
    blocks = list(decode_rows(load_sample_table(path)))
    actions = blocks[1].actions.copy()
    actions[2, 3] = 3 - actions[2, 3]
    fields = {name: getattr(blocks[1], name) for name in EpisodeRows.__dataclass_fields__}
    blocks[1] = EpisodeRows(**{**fields, "actions": actions})
    path.write_bytes(encode_table(encode_rows(blocks)))
    (damage,) = verify_dataset(folder).damages
    row = len(blocks[0]) + 3
    assert f"row {row} (episode {blocks[1].episode_id!r}, step 2), actions" in str(damage)
    assert repair_dataset(folder).ok
    assert files_of(folder) == before


def test_scenes_come_back_from_the_suite_alone(webdataset, copy_of, data_suite, files_of) -> None:
    folder = copy_of(webdataset)
    before = files_of(folder)
    flip(folder / "scenes" / "example-flat" / "labels.json", 100)
    shard = folder / "pictures" / "webdataset" / f"{webdataset.about.parts[0].name}.tar"
    shard.unlink()
    report = repair_dataset(folder)
    assert {damage.path for damage in report.left} == {
        "scenes/example-flat/labels.json",
        f"pictures/webdataset/{shard.name}",
    }
    assert "--suite" in report.reasons["scenes/example-flat/labels.json"]
    assert "what it is made from" in report.reasons[f"pictures/webdataset/{shard.name}"]
    assert repair_dataset(folder, suite=data_suite.folder).ok
    assert files_of(folder) == before


def test_an_unfinished_cache_is_named_and_finished(webdataset, copy_of, files_of) -> None:
    folder = copy_of(webdataset)
    before = files_of(folder)
    cache = folder / "pictures" / "webdataset"
    (cache / "manifest.json").unlink()
    (cache / f"{webdataset.about.parts[1].name}.tar").unlink()
    (damage,) = verify_dataset(folder).damages
    assert "not whole" in str(damage)
    assert repair_dataset(folder).ok
    assert files_of(folder) == before


def test_pixels_that_are_drawn_otherwise_are_named(webdataset, copy_of) -> None:
    """A table that claims other pixels, as one would that another renderer had made."""
    folder = copy_of(webdataset)
    part = webdataset.about.parts[0]
    blocks = list(decode_rows(load_sample_table(folder / part.path)))
    hashes = {name: list(values) for name, values in blocks[0].hashes.items()}
    hashes["history"][4] = "0" * 32
    blocks[0] = blocks[0].with_hashes(hashes)
    data = encode_table(encode_rows(blocks))
    (folder / part.path).write_bytes(data)
    from gn0.data.verify import compare_part

    (row,) = compare_part({"folder": str(folder), "part": part.name})["rows"]
    assert row == f"history of row 5 (episode {blocks[0].episode_id!r}, step 4)"


def test_the_verbs_say_what_is_damaged(webdataset, copy_of, capsys) -> None:
    folder = copy_of(webdataset)
    assert main(["data", "verify", str(folder)]) == 0
    assert "whole: " in capsys.readouterr().out
    (folder / "episodes.parquet").unlink()
    assert main(["data", "verify", str(folder)]) == 1
    out = capsys.readouterr().out
    assert "episodes.parquet: missing" in out and f"gn0 data repair {folder}" in out
    assert main(["data", "repair", str(folder)]) == 1
    assert "still damaged: episodes.parquet" in capsys.readouterr().out


@pytest.fixture(scope="module")
def victim(labels_only, tmp_path_factory) -> Path:
    return Path(shutil.copytree(labels_only.folder, tmp_path_factory.mktemp("victim") / "d"))


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(at=st.integers(0, 2**20), byte=st.integers(1, 255), cut=st.booleans())
def test_no_damage_to_a_table_or_to_the_description_goes_up_as_a_foreign_error(
    victim, at, byte, cut
) -> None:
    """Readers raise GN0's own errors or read what is there, and a verify never misses a table."""
    for name in ("dataset.json", "samples/example-flat-0000.parquet"):
        path = victim / name
        whole = path.read_bytes()
        bad = bytearray(whole)
        bad[at % len(bad)] ^= byte
        path.write_bytes(bytes(bad[: at % len(bad)] if cut else bad))
        try:
            dataset = open_dataset(victim)
            list(map(len, dataset.sample_tables()))
            if name != "dataset.json":
                assert not verify_dataset(victim, workers=1).ok
        except Gn0Error as error:
            assert error.what
        finally:
            path.write_bytes(whole)
