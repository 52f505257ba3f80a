"""Depth pictures that a dataset stores: their values, hashes, repair; and nothing if it is off."""

from __future__ import annotations

import io
import json
import shutil
import sys
import tarfile
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from gn0.cli.main import main
from gn0.data.build import build_dataset
from gn0.data.cache_webdataset import ShardReader, sample_key
from gn0.data.dataset import Dataset, open_dataset
from gn0.data.episode_frames import read_frames
from gn0.data.picture_build import choose_cache, render_dataset
from gn0.data.picture_cache import decode_depth, encode_depth
from gn0.data.repair import repair_dataset
from gn0.data.sample_sheet import draw_sheet
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.data.verify import compare_part, verify_dataset
from gn0.errors import DataError, FormatError
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.render.depth import to_metres, to_millimetres
from gn0.scenes.folder import load_scene
from gn0.sim.presets import find_preset
from gn0.storage import content_hash
from gn0.suites import scene_drawing
from gn0.suites.suite import Suite, save_suite

CAMERA = "rgbd_224"
DEPTH = PictureSettings(depth=True)


def small_suite(data_suite: Suite, root: Path, camera: str, count: int = 2) -> Suite:
    """Short walks seen through another camera."""
    scene = load_scene(data_suite.scene_folder("example-flat"))
    agent = find_preset(camera).agent
    navigation = NavigationMap(scene.grid, agent.radius)
    episodes = sample_goal_episodes(scene, navigation, count, 0, maximum_length=5.0, agent=agent)
    episodes = [msgspec.structs.replace(e, split="train") for e in episodes]
    return save_suite(root / "suite", [scene], episodes, name="small", camera=camera)


@pytest.fixture(scope="module")
def suite(data_suite, tmp_path_factory) -> Suite:
    return small_suite(data_suite, tmp_path_factory.mktemp("small"), CAMERA)


@pytest.fixture(scope="module")
def plain(suite, tmp_path_factory) -> Dataset:
    """Without depth; do not write to it."""
    return build_dataset(suite, tmp_path_factory.mktemp("plain") / "d", BuildSettings(chunk=1))


@pytest.fixture(scope="module")
def deep(suite, tmp_path_factory) -> Dataset:
    """With depth; do not write to it."""
    settings = BuildSettings(chunk=1, pictures=DEPTH)
    return build_dataset(suite, tmp_path_factory.mktemp("deep") / "d", settings)


def members(dataset: Dataset) -> dict[str, bytes]:
    found = {}
    for shard in sorted((dataset.folder / "pictures" / "webdataset").glob("*.tar")):
        with tarfile.open(shard) as tar:
            found |= {info.name: tar.extractfile(info).read() for info in tar}  # type: ignore[union-attr]
    return found


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (48, 36), (7, 480)])
def test_a_16_bit_png_reads_back_here_and_elsewhere(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    for picture in (
        rng.integers(0, 65536, size).astype(np.uint16),
        np.zeros(size, np.uint16),
        np.full(size, 65535, np.uint16),
        (np.arange(size[0])[:, None] * 300 + np.arange(size[1])).astype(np.uint16),
    ):
        data = encode_depth(picture)
        assert data == encode_depth(picture[::1].copy())
        np.testing.assert_array_equal(decode_depth(data, "f", "depth"), picture)
        with Image.open(io.BytesIO(data)) as image:
            image.verify()  # checksums of all chunks
        with Image.open(io.BytesIO(data)) as image:
            assert (image.mode, image.size) == ("I;16", size[::-1])
    stream = io.BytesIO()
    Image.new("RGB", (4, 4)).save(stream, "PNG")
    for bad in (stream.getvalue(), data[:-30], b""):
        with pytest.raises(FormatError, match="depth cannot be decoded"):
            decode_depth(bad, "f", "depth")


def test_what_is_stored_is_the_renderers_depth_and_is_hashed(deep) -> None:
    for name in deep.sampled:
        drawn = list(read_frames(deep, name, ("depth",), exact=True))
        part, rows = deep.part_of(name), deep.rows(name)
        reader = ShardReader(deep.folder, part.name, DEPTH)  # a part is an episode here
        assert len(rows.hashes["depth"]) == len(drawn) == part.rows
        for step, frame in enumerate(drawn):
            stored = reader.depth(step)
            assert stored.dtype == np.uint16 and stored.shape == (224, 224)
            assert rows.hashes["depth"][step] == content_hash(stored)
            seen = (stored > 0) & (stored < 10_000)
            assert seen.any()
            np.testing.assert_array_equal(stored[seen], to_millimetres(frame["depth"])[seen])
            np.testing.assert_array_equal(frame["depth"][~seen], np.float32(10.0))
            about = json.loads(reader.read(step, "json"))
            assert about["hashes"]["depth"] == rows.hashes["depth"][step]


def test_frames_read_what_is_stored_unless_exact_metres_are_asked_for(deep, plain) -> None:
    name = deep.sampled[0]
    stored = list(read_frames(deep, name, ("rgb", "depth")))
    exact = list(read_frames(deep, name, ("depth",), exact=True))
    drawn = list(read_frames(plain, name, ("depth",)))  # nothing is stored there
    for one, other, third in zip(stored, exact, drawn, strict=True):
        assert one["depth"].dtype == np.float32
        np.testing.assert_array_equal(other["depth"], third["depth"])
        assert 0 < np.abs(one["depth"] - other["depth"]).max() < 0.0005 + 1e-5
        np.testing.assert_array_equal(
            one["depth"], to_metres(to_millimetres(one["depth"]), (0.0, 10.0))
        )


def test_all_but_depth_is_as_it_is_without(deep, plain) -> None:
    """Tables, shards and dataset.json without depth say nothing of it."""
    one, other = members(deep), members(plain)
    assert {name for name in one if name not in other} == {
        f"{sample_key(part.name, row)}.depth.png"
        for part in deep.about.parts
        for row in range(part.rows)
    }
    for name, data in other.items():
        if not name.endswith(".json"):
            assert one[name] == data, name
    assert b"depth" not in (plain.folder / "dataset.json").read_bytes()
    assert b'"depth": true' in (deep.folder / "dataset.json").read_bytes()
    for mine, theirs in zip(deep.about.parts, plain.about.parts, strict=True):
        assert mine.labels == theirs.labels
        tables = [pq.read_table(d.folder / mine.path) for d in (deep, plain)]
        assert tables[0].column_names == [*tables[1].column_names, "hash_depth"]
        assert tables[0].drop_columns(["hash_depth"]).equals(tables[1])
        assert tables[0].schema.metadata == tables[1].schema.metadata


def test_off_is_said_in_one_way() -> None:
    off = PictureSettings(depth=False)
    assert off == PictureSettings() and not off.depth
    assert "depth" not in msgspec.to_builtins(off)
    assert msgspec.convert({"depth": False}, PictureSettings) == off
    assert msgspec.convert(msgspec.to_builtins(DEPTH), PictureSettings) == DEPTH


def test_pictures_are_drawn_again_to_the_same_bytes(deep, copy_of, files_of) -> None:
    folder = copy_of(deep)
    shutil.rmtree(folder / "pictures")
    assert main(["data", "render", str(folder)]) == 0
    assert files_of(folder) == files_of(deep.folder)
    assert verify_dataset(folder, pixels=True).ok


def test_damage_to_a_depth_picture_is_named_and_repaired(deep, copy_of, files_of) -> None:
    folder = copy_of(deep)
    part = deep.about.parts[1]
    shard = folder / "pictures" / "webdataset" / f"{part.name}.tar"
    with tarfile.open(shard) as tar:
        info = tar.getmember(f"{sample_key(part.name, 2)}.depth.png")
    data = bytearray(shard.read_bytes())
    data[info.offset_data + info.size // 2] ^= 4
    shard.write_bytes(data)
    (damage,) = verify_dataset(folder).damages
    name = part.episodes[0]
    assert damage.rows == (f"depth.png of row 3 (episode {name!r}, step 2)",)
    with pytest.raises(FormatError, match="member is damaged"):
        list(read_frames(open_dataset(folder), name, ("depth",)))
    (folder / deep.about.parts[0].path).unlink()
    assert repair_dataset(folder).ok
    assert files_of(folder) == files_of(deep.folder)


def test_a_depth_that_is_drawn_otherwise_is_named(deep, copy_of) -> None:
    from gn0.data.sample_table import decode_rows, encode_rows, encode_table, load_sample_table

    folder = copy_of(deep)
    part = deep.about.parts[0]
    (block,) = decode_rows(load_sample_table(folder / part.path))
    hashes = {name: list(values) for name, values in block.hashes.items()}
    hashes["depth"][1] = "0" * 32
    table = encode_table(encode_rows([block.with_hashes(hashes)]))
    (folder / part.path).write_bytes(table)
    (row,) = compare_part({"folder": str(folder), "part": part.name})["rows"]
    assert row == f"depth of row 2 (episode {block.episode_id!r}, step 1)"
    shutil.rmtree(folder / "pictures")
    with pytest.raises(DataError, match="the depth picture differs from the one drawn"):
        render_dataset(folder)


@pytest.mark.skipif(sys.platform == "win32", reason="Unix sockets")
@pytest.mark.parametrize("batch", [0, pytest.param(3, marks=pytest.mark.slow)])
def test_one_process_that_draws_gives_the_same_bytes(
    suite, deep, tmp_path, files_of, monkeypatch, batch
) -> None:
    monkeypatch.setattr(scene_drawing, "SHARED", frozenset({"cpu", "cuda"}))
    settings = BuildSettings(chunk=1, pictures=DEPTH)
    build_dataset(suite, tmp_path / "d", settings, workers=2, batch=batch)
    assert files_of(tmp_path / "d") == files_of(deep.folder)


def test_poses_and_labels_get_depth_when_they_are_drawn(suite, deep, tmp_path, files_of) -> None:
    """Asked for at the build, or at the first rendering."""
    png = ["--depth", "--depth-as", "png"]
    told = ["data", "build", str(suite.folder), "--chunk", "1", "--layout", "none", "--out"]
    said, later = tmp_path / "said", tmp_path / "later"
    assert main([*told, str(said), *png]) == 0
    assert main([*told, str(later)]) == 0
    assert b"depth" not in (later / "dataset.json").read_bytes()
    assert main(["data", "render", str(said)]) == 0
    assert main(["data", "render", str(later), *png]) == 0
    tables = [path.name for path in (deep.folder / "samples").iterdir()]
    for folder in (said, later):
        for name in tables:
            path = Path("samples") / name
            assert (folder / path).read_bytes() == (deep.folder / path).read_bytes()
        assert members(open_dataset(folder)) == members(deep)
    assert files_of(said) == files_of(later)
    assert main([*told, str(later)]) == 0  # what was drawn since changes nothing
    assert main([*told, str(said), *png]) == 0


def test_what_makes_no_sense_is_refused_in_words(suite, plain, deep):
    with pytest.raises(DataError, match="made without depth") as refused:
        choose_cache(plain, DEPTH)
    assert "build another dataset with --depth" in refused.value.remedy
    with pytest.raises(DataError, match="depth is unset there and True here"):
        build_dataset(suite, plain.folder, BuildSettings(chunk=1, pictures=DEPTH))
    assert choose_cache(deep, None) == DEPTH


@pytest.mark.slow
def test_a_lerobot_cache_of_a_dataset_with_depth_keeps_it(deep, copy_of) -> None:
    folder = copy_of(deep)
    assert main(["data", "render", str(folder), "--layout", "lerobot"]) == 0
    assert verify_dataset(folder, pixels=True).ok
    shutil.rmtree(folder / "pictures" / "webdataset")
    data = folder / "pictures/lerobot/data/chunk-000/file-000.parquet"
    whole = data.read_bytes()
    data.unlink()  # the labels of all parts and the depth of this one, which is drawn again
    assert repair_dataset(folder).ok
    assert data.read_bytes() == whole
    name, kinds = deep.sampled[0], ("rgb", "depth")
    stored, drawn = (list(read_frames(open_dataset(folder), name, kinds, exact=e)) for e in (0, 1))
    for one, other in zip(stored, drawn, strict=True):
        assert np.abs(one["depth"] - other["depth"]).max() <= 0.00051
        assert not np.array_equal(one["rgb"], other["rgb"])  # from the video


def test_depth_lies_in_the_shard_as_it_was_asked_for(deep, copy_of) -> None:
    folder = copy_of(deep)
    part = deep.about.parts[0]
    wanted = ShardReader(folder, part.name, DEPTH).depth(1)
    for kind, endings in (("npy", {"npy"}), ("both", {"npy", "png"})):
        shutil.rmtree(folder / "pictures")
        assert main(["data", "render", str(folder), "--depth-as", kind]) == 0
        with tarfile.open(folder / "pictures/webdataset" / f"{part.name}.tar") as shard:
            names = [n for n in shard.getnames() if ".depth." in n]
            assert {n.rpartition(".")[2] for n in names} == endings
            stream = shard.extractfile(next(n for n in names if n.endswith("1.depth.npy")))
            assert stream is not None
            array = np.load(io.BytesIO(stream.read()), allow_pickle=False)
        assert array.dtype == np.uint16 and np.array_equal(array, wanted)
        reader = ShardReader(folder, part.name, DEPTH)
        assert np.array_equal(reader.depth(1), wanted)


def test_a_depth_camera_of_its_own_is_stored_in_its_own_size(data_suite, tmp_path) -> None:
    small = small_suite(data_suite, tmp_path, "vlnce_r2r", 1)
    dataset = build_dataset(small, tmp_path / "d", BuildSettings(pictures=DEPTH))
    name = dataset.sampled[0]
    frame = next(read_frames(dataset, name, ("rgb", "depth")))
    assert frame["rgb"].shape == (224, 224, 3) and frame["depth"].shape == (256, 256)
    exact = next(read_frames(dataset, name, ("depth",), exact=True))
    assert np.abs(frame["depth"] - exact["depth"]).max() < 0.0005 + 1e-5
    assert verify_dataset(dataset.folder, pixels=True).ok


def test_a_sample_sheet_shows_it(deep, plain) -> None:
    wide, narrow = draw_sheet(deep, steps=2), draw_sheet(plain, steps=2)
    assert wide.width > narrow.width and wide.height == narrow.height
