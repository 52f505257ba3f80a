"""Shards: several machines build a dataset, none knows the others, and no byte tells."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.cli.main import main
from gn0.data import merge
from gn0.data.build import build_dataset, build_shard
from gn0.data.collect import build_dagger, check_dagger
from gn0.data.dataset import open_dataset
from gn0.data.merge import merge_shards
from gn0.data.part import PartPlan
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
from gn0.data.shard import ShardName, load_shard
from gn0.data.verify import verify_dataset
from gn0.errors import ConfigError, DataError, FormatError
from gn0.suites.suite import Suite, load_suite_scene, save_suite

LABELS = BuildSettings(chunk=1, pictures=PictureSettings(layout="none"))


@pytest.fixture(scope="module")
def two_scenes(data_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """Six episodes in one flat, and a second flat in which nobody walks."""
    about = data_suite.about.scenes[0]
    scene = load_suite_scene(data_suite.scene_folder(about.id), about.id, about.hash)
    folder = tmp_path_factory.mktemp("two")
    shutil.copytree(data_suite.scene_folder(about.id), folder / "attic")
    attic = msgspec.json.decode((folder / "attic" / "scene.json").read_bytes())
    (folder / "attic" / "scene.json").write_bytes(msgspec.json.encode({**attic, "id": "attic"}))
    from gn0.scenes.folder import load_scene

    scenes = [scene, load_scene(folder / "attic")]
    return save_suite(folder / "suite", scenes, data_suite.episodes, name="two", max_steps=60)


@pytest.fixture(scope="module")
def thirds(two_scenes: Suite, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Poses and labels of six parts, in three shards; do not write to them."""
    root = tmp_path_factory.mktemp("thirds")
    folders = [root / str(index) for index in (1, 2, 3)]
    for index, folder in enumerate(folders, 1):
        build_shard(two_scenes, folder, f"{index}/3", LABELS)
    return folders


@pytest.mark.parametrize("layout", ["webdataset_once", "lerobot"])
def test_merged_shards_are_the_bytes_of_one_build(
    request, layout, data_suite, settings_of, tmp_path, files_of
) -> None:
    whole = request.getfixturevalue(layout)
    more = {"maps": "once"} if layout == "webdataset_once" else {}
    settings = settings_of(layout.removesuffix("_once"), **more)
    folders = [tmp_path / "b", tmp_path / "a"]
    for folder, index in zip(folders, (2, 1), strict=True):  # the last first
        build_shard(data_suite, folder, f"{index}/2", settings)
    merged = merge_shards(folders, tmp_path / "data")
    assert files_of(merged.folder) == files_of(whole.folder)


def test_shards_without_parts_and_scenes_without_walks_are_no_trouble(
    two_scenes, thirds, tmp_path, files_of
) -> None:
    whole = build_dataset(two_scenes, tmp_path / "whole", LABELS)
    assert files_of(merge_shards(thirds, tmp_path / "3").folder) == files_of(whole.folder)
    many = [tmp_path / f"of8-{index}" for index in range(1, 9)]
    for index, folder in enumerate(many, 1):
        build_shard(two_scenes, folder, ShardName(index, 8), LABELS)
    assert any(not load_shard(folder).parts for folder in many)
    assert files_of(merge_shards(many, tmp_path / "8").folder) == files_of(whole.folder)
    assert verify_dataset(tmp_path / "8").ok


def test_what_a_policy_visits_is_sharded_alike(data_suite, tmp_path, files_of) -> None:
    dagger = DaggerSettings(policy="wall_follower", beta=0.3, max_steps=9, halting="none")
    settings = msgspec.structs.replace(LABELS, dagger=dagger)
    whole = build_dagger(data_suite, tmp_path / "whole", settings)
    folders = [tmp_path / "1", tmp_path / "2"]
    for index, folder in enumerate(folders, 1):
        build_shard(data_suite, folder, f"{index}/2", check_dagger(settings), agents=3)
    assert files_of(merge_shards(folders, tmp_path / "m").folder) == files_of(whole.folder)


@pytest.mark.slow
def test_lerobot_depth_waits_in_its_shard(data_suite, tmp_path, files_of, monkeypatch) -> None:
    """It is not drawn again by who merges."""
    pictures = PictureSettings(layout="lerobot", depth=True)
    settings = BuildSettings(chunk=3, pictures=pictures)
    whole = build_dataset(data_suite, tmp_path / "whole", settings)
    folders = [tmp_path / "1", tmp_path / "2"]
    for index, folder in enumerate(folders, 1):
        build_shard(data_suite, folder, f"{index}/2", settings)
    monkeypatch.setattr("gn0.data.cache_lerobot._draw_depth", None)
    assert files_of(merge_shards(folders, tmp_path / "m").folder) == files_of(whole.folder)


def test_a_shard_that_cannot_be_merged_says_why(
    two_scenes, data_suite, labels_only, thirds, tmp_path
) -> None:
    one, two, three = thirds
    out = tmp_path / "out"

    def refused(*folders: Path) -> str:
        with pytest.raises(DataError) as caught:
            merge_shards(folders, out)
        assert not out.exists(), "something was written"
        return str(caught.value)

    assert "shard 2 of 3 is missing" in refused(one, three)
    assert "--shard 2/3" in refused(one, three)
    assert "shards 1, 3 of 3 are missing" in refused(two)
    assert f"shard 2/3 is given twice; it is in {two}, too" in refused(one, two, two)
    assert "no shard to merge" in refused()
    assert "no shard of a dataset" in refused(one, tmp_path)
    assert "leave it out of the merge" in refused(one, labels_only.folder)
    other = build_shard(two_scenes, tmp_path / "2of2", "2/2", LABELS)
    assert other.count == 2
    assert "shard 2/2 of a dataset in 2 shards beside shard 1/3" in refused(one, tmp_path / "2of2")
    wide = msgspec.structs.replace(LABELS, chunk=2)
    build_shard(two_scenes, tmp_path / "wide", "2/3", wide)
    told = refused(one, tmp_path / "wide", three)
    assert "another plan" in told and "settings.chunk is 2 there and 1 here" in told
    build_shard(data_suite, tmp_path / "other", "2/3", LABELS)
    assert "suite.name is 'walks' there and 'two' here" in refused(one, tmp_path / "other", three)


def test_an_unfinished_shard_is_neither_merged_nor_opened(thirds, tmp_path) -> None:
    half = Path(shutil.copytree(thirds[1], tmp_path / "half"))
    (half / "shard.json").unlink()
    with pytest.raises(DataError, match="shard 2/3 has not been built to its end"):
        merge_shards([thirds[0], half, thirds[2]], tmp_path / "out")
    with pytest.raises(DataError, match=r"shard 2/3 of a dataset \(join all shards with"):
        open_dataset(half)


def test_damage_is_found_named_and_mended(two_scenes, thirds, tmp_path, files_of) -> None:
    bad = Path(shutil.copytree(thirds[1], tmp_path / "bad"))
    table = next((bad / "samples").glob("*.parquet"))
    good = table.read_bytes()
    table.unlink()  # not written through: scenes and copies may share files
    table.write_bytes(good[:-9] + bytes(9))
    folders = [thirds[0], bad, thirds[2]]
    with pytest.raises(DataError, match="bytes are not those that were built") as caught:
        merge_shards(folders, tmp_path / "out")
    assert str(table) in str(caught.value) and "--shard" in str(caught.value)
    with pytest.raises(DataError, match="has not ended"):
        open_dataset(tmp_path / "out")
    table.unlink()
    with pytest.raises(DataError, match="a file of the shard is missing"):
        merge_shards(folders, tmp_path / "out")
    build_shard(two_scenes, bad, "2/3", LABELS)
    assert table.read_bytes() == good
    merged = merge_shards(folders, tmp_path / "out")
    assert files_of(merged.folder) == files_of(merge_shards(thirds, tmp_path / "same").folder)
    seal = json.loads((bad / "shard.json").read_bytes())
    (bad / "shard.json").unlink()
    (bad / "shard.json").write_text(json.dumps({**seal, "total": 7}))
    with pytest.raises(FormatError, match="changed after it was written"):
        merge_shards(folders, tmp_path / "other")


def test_a_merge_that_is_stopped_anywhere_goes_on(thirds, tmp_path, files_of, monkeypatch) -> None:
    whole = files_of(merge_shards(thirds, tmp_path / "whole").folder)
    copy, left = merge._copy, [0]

    def stop(*args: object) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        copy(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(merge, "_copy", stop)
    tries = 0
    while True:
        left[0] = 4  # files a try
        try:
            merge_shards(thirds, tmp_path / "out")
            break
        except KeyboardInterrupt:
            tries += 1
            assert tries < 50
    assert tries > 2
    assert files_of(tmp_path / "out") == whole
    merge_shards(thirds, tmp_path / "out")  # nothing is left to do
    assert files_of(tmp_path / "out") == whole


def test_a_folder_of_one_shard_takes_no_other(two_scenes, thirds, tmp_path) -> None:
    for shard, words in (("1/3", "shard is '2/3' there and '1/3' here"), ("2/4", "'2/4' here")):
        with pytest.raises(DataError, match=words):
            build_shard(two_scenes, thirds[1], shard, LABELS)
    with pytest.raises(DataError, match="shard is '2/3' there and unset here"):
        build_dataset(two_scenes, thirds[1], LABELS)


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "1/0", "-1/3", "1/3/4", "a/b", "1/9999999"])
def test_what_names_no_shard_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="shard"):
        ShardName.parse(text)


@given(st.lists(st.integers(1, 40), max_size=60), st.integers(1, 30))
def test_shards_share_the_episodes_out(sizes: list[int], count: int) -> None:
    """Each part is in one shard, runs follow each other, and no shard has a part too many."""
    plans = [
        PartPlan("", f"p{n}", n, "s", tuple(f"{n}-{k}" for k in range(size)))
        for n, size in enumerate(sizes)
    ]
    shards = [ShardName(index, count).choose(plans) for index in range(1, count + 1)]
    assert [plan for shard in shards for plan in shard] == plans
    fair = sum(sizes) / count
    for shard in shards:
        assert sum(len(plan.episodes) for plan in shard) <= fair + max(sizes, default=0)


def test_the_verbs_build_and_merge(two_scenes, tmp_path, capsys) -> None:
    folders = [str(tmp_path / f"s{index}") for index in (1, 2)]
    for index, folder in enumerate(folders, 1):
        told = ["--layout", "none", "--shard", f"{index}/2", "--out", folder]
        assert main(["data", "build", str(two_scenes.folder), *told]) == 0
    text = capsys.readouterr().out
    assert "shard 2/2: " in text and "gn0 data merge" in text
    out = str(tmp_path / "data")
    assert main(["data", "merge", *folders, "--balance", "weights", "--out", out]) == 0
    text = capsys.readouterr().out
    assert f"samples of 6 episodes in 2 scenes, joined from 2 shards in {out}" in text
    assert (tmp_path / "data" / "balance.json").is_file()
    assert main(["data", "merge", folders[0], "--out", str(tmp_path / "x")]) == 2
    assert "shard 2 of 2 is missing" in capsys.readouterr().err
