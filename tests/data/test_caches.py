"""Caches at their edges: nothing to draw, pictures drawn once, files that are cut or forged."""

from __future__ import annotations

import io
import json
import shutil
import tarfile

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gn0.data.build import build_dataset
from gn0.data.build_folder import read_done, write_journal
from gn0.data.cache_webdataset import ShardReader, draw_dots, sample_key
from gn0.data.dataset import compute_seal, file_digest, open_dataset
from gn0.data.episode_frames import read_frames
from gn0.data.lerobot_schema import PixelSums, describe_array, join_stats
from gn0.data.part_pictures import PartDrawer
from gn0.data.picture_build import choose_cache, render_dataset
from gn0.data.picture_cache import decode_picture, load_manifest
from gn0.data.repair import repair_dataset
from gn0.data.sample_table import PICTURES
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
from gn0.data.verify import verify_dataset
from gn0.errors import DataError, FormatError, StorageError
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.folder import load_scene
from gn0.sim.sensors import SensorSuite
from gn0.storage import write_json
from gn0.suites.suite import save_suite


@pytest.mark.parametrize("layout", ["webdataset", "lerobot"])
def test_a_part_whose_episodes_cannot_be_walked_is_empty_and_whole(
    data_suite, settings_of, tmp_path, layout
) -> None:
    scene = load_scene(data_suite.scene_folder("example-flat"))
    change = msgspec.structs.replace
    walled = [
        change(e, id=f"a{n}", path_id="", mission=change(e.mission, goal=(0.0, 0.0)))
        for n, e in enumerate(data_suite.episodes[:3])
    ]
    episodes = [*walled, data_suite.episodes[0]]
    suite = save_suite(tmp_path / "suite", [scene], episodes, name="w", keep_unfit=True)
    dataset = build_dataset(suite, tmp_path / "d", settings_of(layout))
    assert [part.rows > 0 for part in dataset.about.parts] == [False, True]
    assert [len(part.skipped) for part in dataset.about.parts] == [3, 0]
    assert verify_dataset(dataset.folder, pixels=True).ok
    frames = list(read_frames(dataset, dataset.sampled[0], ("rgb", "history")))
    assert len(frames) == dataset.about.rows


def test_missions_of_one_path_are_drawn_once(webdataset, monkeypatch) -> None:
    part = webdataset.part_of("zwilling")
    blocks = webdataset.part_rows(part)
    assert sum(block.episode_id == "zwilling" for block in blocks) == 1
    counted = []
    look_many = SensorSuite.look_many

    def count(self, poses, *more):
        counted.append(len(poses))
        return look_many(self, poses, *more)

    monkeypatch.setattr(SensorSuite, "look_many", count)
    steps = list(PartDrawer(webdataset, blocks, PictureSettings()).steps())
    assert [step.row for step in steps] == list(range(part.rows))
    goals = len(blocks)  # a goal picture each
    twin = len(webdataset.rows("zwilling"))
    assert sum(counted) <= part.rows - twin + goals


def test_visible_sets_are_part_of_what_a_dataset_is(data_suite, settings_of, tmp_path) -> None:
    scene = load_scene(data_suite.scene_folder("example-flat"))
    navigation = NavigationMap(scene.grid, 0.2)
    near = sample_goal_episodes(scene, navigation, 1, 0, minimum_length=0.5, maximum_length=1.0)
    suite = save_suite(tmp_path / "suite", [scene], near, name="near")  # few places: a set for each
    dataset = build_dataset(suite, tmp_path / "d", settings_of("webdataset", visible_sets=True))
    assert dataset.about.settings.pictures.visible_sets
    assert verify_dataset(dataset.folder, pixels=True).ok
    with pytest.raises(DataError, match="made to be drawn from visible sets"):
        render_dataset(dataset.folder, PictureSettings(layout="lerobot"))
    wanted = PictureSettings(layout="lerobot", visible_sets=True)
    assert choose_cache(dataset, wanted) == wanted
    with pytest.raises(DataError, match="no pictures"):
        choose_cache(dataset, PictureSettings(layout="none", visible_sets=True))


def test_what_a_policy_visited_is_repaired_too(data_suite, tmp_path, files_of) -> None:
    """A policy of ours drives the same way again; one of a stranger's is not run from here."""
    settings = BuildSettings(
        chunk=3,
        pictures=PictureSettings(layout="none"),
        dagger=DaggerSettings(policy="random", beta=0.5, max_steps=12),
    )
    dataset = build_dataset(data_suite, tmp_path / "d", settings)
    before = files_of(dataset.folder)
    table = dataset.folder / dataset.about.parts[0].path
    table.unlink()
    assert repair_dataset(dataset.folder).ok
    assert files_of(dataset.folder) == before
    shutil.rmtree(dataset.folder)
    assert settings.dagger is not None
    strange = msgspec.structs.replace(settings.dagger, plugins=("json",))
    dataset = build_dataset(
        data_suite, tmp_path / "d", msgspec.structs.replace(settings, dagger=strange)
    )
    table.unlink()
    report = repair_dataset(dataset.folder)
    assert not report.ok
    assert "it is not run" in next(iter(report.reasons.values()))


def test_a_cut_or_forged_shard_is_refused_in_words(webdataset, copy_of) -> None:
    folder = copy_of(webdataset)
    part = webdataset.about.parts[0]
    settings = webdataset.about.settings.pictures
    cache = folder / "pictures" / "webdataset"
    shard = cache / f"{part.name}.tar"
    data = shard.read_bytes()
    shard.write_bytes(data[:2000])
    reader = ShardReader(folder, part.name, settings)
    with pytest.raises(FormatError, match="member is damaged") as caught:
        reader.picture(part.rows - 1, "rgb")
    assert "gn0 data repair" in caught.value.remedy
    with pytest.raises(FormatError, match="no such member"):
        reader.read(part.rows, "json")
    shard.unlink()
    with pytest.raises(FormatError, match="cannot be read"):
        reader.read(0, "json")
    index = cache / f"{part.name}.index.parquet"
    index.write_bytes((folder / part.path).read_bytes())
    with pytest.raises(FormatError, match="not the index of a shard"):
        ShardReader(folder, part.name, settings)
    index.unlink()
    with pytest.raises(StorageError):
        ShardReader(folder, part.name, settings)
    with pytest.raises(FormatError, match="cannot be decoded"):
        decode_picture(b"\xff\xd8 no picture", shard, "rgb")


def test_shards_of_version_1_are_read(data_suite, settings_of, tmp_path) -> None:
    """Goal pictures beside, places as (row, column), no goal in the tar."""
    dataset = build_dataset(data_suite, tmp_path / "d", settings_of(maps="once"))
    part, cache = dataset.about.parts[0], dataset.folder / "pictures/webdataset"
    goals = cache / "goals"
    goals.mkdir()
    index: dict[str, list] = {"name": [], "offset": [], "size": [], "digest": []}
    out = io.BytesIO()
    with tarfile.open(cache / f"{part.name}.tar") as shard:
        members = [(m.name, shard.extractfile(m).read()) for m in shard]
    for name, data in members:
        if ".goal." in name:
            (goals / name).write_bytes(data)
            continue
        if name.endswith(".json"):
            about = json.loads(data)
            spots = about["occupancy"]
            del spots["size_xy"]
            for key in ("start", "current"):
                spots[key] = spots.pop(f"{key}_xy")[::-1]
            about["pixels"] = about.pop("tokens_xy")
            about["goal_picture"] = "goals/" + name.replace(".json", ".goal.jpg")
            data = json.dumps(about).encode()
        info = tarfile.TarInfo(name)
        info.size = len(data)
        out.write(info.tobuf(tarfile.USTAR_FORMAT))
        for column, value in zip(
            index, (name, out.tell(), len(data), file_digest(data)), strict=True
        ):
            index[column].append(value)
        out.write(data + bytes(-len(data) % 512))
    (cache / f"{part.name}.tar").write_bytes(out.getvalue())
    path = cache / f"{part.name}.index.parquet"
    pq.write_table(pa.table(index, schema=pq.read_schema(path)), path)
    manifest = load_manifest(dataset.folder, "webdataset")
    assert manifest is not None
    old = msgspec.structs.replace(manifest, layout=1)
    old = msgspec.structs.replace(old, seal=compute_seal(old))
    write_json(cache / "manifest.json", msgspec.to_builtins(old))
    name, kinds = part.episodes[0], ("rgb", "bev", "occupancy", "goal_picture")
    frames = zip(
        read_frames(dataset, name, kinds),
        read_frames(dataset, name, kinds, exact=True),
        strict=True,
    )
    for one, other in frames:
        for kind in ("bev", "occupancy"):
            assert np.array_equal(one[kind], other[kind])
        for kind in ("rgb", "goal_picture"):
            assert np.abs(one[kind].astype(int) - other[kind]).mean() < 8


def test_a_damaged_video_is_refused_in_words(lerobot, copy_of) -> None:
    folder = copy_of(lerobot)
    dataset = open_dataset(folder)
    video = folder / "pictures/lerobot/videos/observation.images.rgb/chunk-000/file-000.mp4"
    data = video.read_bytes()
    for bad in (b"", data[: len(data) // 2], b"\0" * len(data)):
        video.write_bytes(bad)
        with pytest.raises(FormatError, match="video") as caught:
            list(read_frames(dataset, dataset.sampled[0], ("rgb",)))
        assert "gn0 data repair" in caught.value.remedy
    assert len(list(read_frames(dataset, dataset.sampled[0], ("rgb",), exact=True)))


def test_another_cache_layout_version_is_refused(webdataset, copy_of) -> None:
    folder = copy_of(webdataset)
    path = folder / "pictures" / "webdataset" / "manifest.json"
    path.write_text(path.read_text().replace('"layout": 2', '"layout": 7'))
    with pytest.raises(FormatError, match="cache layout 7, this version reads 2"):
        load_manifest(folder, "webdataset")
    assert not verify_dataset(folder).ok


def test_a_cache_of_other_settings_is_kept(webdataset, copy_of) -> None:
    folder = copy_of(webdataset)
    with pytest.raises(DataError, match="cache of other settings"):
        render_dataset(folder, PictureSettings(quality=50))
    (folder / "pictures" / "webdataset" / "manifest.json").unlink()
    with pytest.raises(DataError, match="other settings was begun"):
        render_dataset(folder, PictureSettings(quality=50))


def test_pictures_that_come_out_otherwise_stop_a_rendering(labels_only, webdataset, copy_of):
    """As they would with a renderer that draws other pixels."""
    block = webdataset.part_rows(webdataset.about.parts[0])[0]
    hashes = {name: list(values) for name, values in block.hashes.items()}
    hashes["bev"][2] = "0" * 32
    drawer = PartDrawer(webdataset, [block.with_hashes(hashes)], PictureSettings())
    with pytest.raises(DataError, match="bev picture differs from the one drawn") as caught:
        list(drawer.steps())
    assert "step 2" in caught.value.where


def test_keys_have_no_dots_and_dots_are_drawn_as_the_sensor_draws_them() -> None:
    assert sample_key("house.v2-0001", 7) == "house_v2-0001-000007"
    picture = draw_dots(np.full((9, 9, 3), 255, np.uint8), (4, 1), (4, 7), 1)
    assert picture[4, 1].tolist() == [0, 255, 0] and picture[4, 7].tolist() == [255, 0, 0]
    assert (picture == 255).all(axis=-1).sum() == 81 - 10


def test_statistics_are_those_of_numpy() -> None:
    rng = np.random.default_rng(0)
    array = rng.normal(size=(50, 3))
    found = describe_array(array)
    np.testing.assert_allclose(found["mean"], array.mean(axis=0))
    np.testing.assert_allclose(found["std"], array.std(axis=0))
    assert found["count"] == [50]
    sums = []
    for value in (10, 30):
        own = PixelSums()
        own.add(np.full((8, 8, 3), value, np.uint8), 2)
        sums.append({"picture": own.describe()})
    found = join_stats(sums)["picture"]
    np.testing.assert_allclose(np.ravel(found["mean"]), 20 / 255)
    np.testing.assert_allclose(np.ravel(found["std"]), 10 / 255)
    assert np.ravel(found["min"])[0] == 10 / 255 and np.ravel(found["max"])[0] == 30 / 255
    assert found["count"] == [4]


def test_journals_forgive_what_they_do_not_know(webdataset, tmp_path) -> None:
    from gn0.storage import journal_line

    path = tmp_path / "journal.jsonl"
    part = msgspec.to_builtins(webdataset.about.parts[0])
    write_journal(
        path, b"".join(map(journal_line, [{"settings": {}}, {"part": part}, {"part": 3}]))
    )
    assert list(read_done(path)) == [part["name"]]
    path.write_bytes(path.read_bytes()[:-4])
    assert list(read_done(path)) == [part["name"]]
    assert read_done(tmp_path / "none.jsonl") == {}


def test_every_sample_is_hashed_once_drawn(webdataset, labels_only) -> None:
    for name in webdataset.sampled:
        rows = webdataset.rows(name)
        assert set(rows.hashes) == set(PICTURES) and rows.rendered
        assert all(len(h) == 32 for values in rows.hashes.values() for h in values)
        assert not labels_only.rows(name).rendered
