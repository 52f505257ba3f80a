"""A path that no file system takes is refused in the house's words, wherever somebody gives it."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gn0 import avatars, bench, data, export, missions, scenes, sim
from gn0.avatars.bank import open_avatars
from gn0.errors import Gn0Error, StorageError
from gn0.maps.movingai import load_movingai_map, load_movingai_scenario
from gn0.maps.ros import load_ros_map
from gn0.missions.language.exchanges import ExchangeFolder, load_exchanges
from gn0.people.cast import Cast
from gn0.plugins import import_plugins
from gn0.remote import local_path, publish_folder
from gn0.scenes.corpus import CorpusPart, CorpusSpec, load_corpus, load_spec
from gn0.scenes.corpus_build import generate_corpus
from gn0.scenes.example import build_example_scene
from gn0.storage import (
    Journal,
    check_contained,
    check_replaceable,
    check_writable,
    folder_atomic,
    plain_path,
    read_bytes,
    safe_join,
    write_bytes,
)
from gn0.suites.scene_list import list_scenes
from gn0.yaml_file import load_yaml

BAD = {"a NUL": "a\0b", "half of a character": "a\ud800b"}
LOADERS: dict[str, Callable[[Any], Any]] = {
    "load_scene": scenes.load_scene,
    "load_spec": load_spec,
    "load_corpus": load_corpus,
    "open_simulator": sim.open_simulator,
    "AvatarBank": avatars.AvatarBank,
    "Cast": Cast,
    "open_avatars": open_avatars,
    "load_smplx_body": avatars.load_smplx_body,
    "compare_runs": lambda path: bench.compare_runs(path, path),
    "load_results": bench.load_results,
    "iterate_results": lambda path: list(bench.iterate_results(Path(path))),
    "load_run": bench.load_run,
    "load_suite": bench.load_suite,
    "load_summary": bench.load_summary,
    "load_traces": bench.load_traces,
    "open_suite": bench.open_suite,
    "replay_run": bench.replay_run,
    "write_report": bench.write_report,
    "open_dataset": data.open_dataset,
    "load_balance": data.load_balance,
    "load_selection": data.load_selection,
    "verify_dataset": data.verify_dataset,
    "repair_dataset": data.repair_dataset,
    "check_export": export.check_export,
    "check_export navid": lambda path: export.check_export(path, "navid"),
    "load_episodes": missions.load_episodes,
    "load_set": missions.load_set,
    "load_exchanges": load_exchanges,
    "ExchangeFolder": ExchangeFolder,
    "load_movingai_map": load_movingai_map,
    "load_movingai_scenario": load_movingai_scenario,
    "load_ros_map": load_ros_map,
    "load_yaml": load_yaml,
    "local_path": local_path,
    "publish_folder": lambda path: publish_folder(path, "memory://somewhere"),
    "import_plugins": lambda path: import_plugins([f"{path}.py"]),
    **{
        f"{name} of {kind.__name__}": lambda path, kind=kind, name=name: kind(**{name: path})
        for kind in (sim.GoalNavEnv, sim.VectorEnv)
        for name in ("scene", "suite", "episodes")
    },
    **{
        f"load_set as {form}": lambda path, form=form: missions.load_set(path, form)
        for form in ("vlnce", "objectnav", "gn_matrix")
    },
    **{
        f"{read.__name__} of {ending}": lambda path, read=read, ending=ending: read(path + ending)
        for read, endings in (
            (scenes.load_cloud, ("", ".ply", ".spz", ".splat", ".ksplat", ".sog")),
            (scenes.describe_cloud_file, ("", ".ply")),
            (avatars.load_avatar, ("", ".npz", ".glb", ".ply")),
            (avatars.load_motion, ("", ".npz", ".bvh", ".json", ".glb")),
        )
        for ending in endings
    },
}
WRITERS: dict[str, Callable[[Any, Path], Any]] = {
    "import_scene": scenes.import_scene,
    "import_scene .ply": lambda path, out: scenes.import_scene(f"{path}.ply", out),
    "import_scene out": lambda path, out: scenes.import_scene(out, path),
    "generate_corpus": lambda path, out: generate_corpus(
        CorpusSpec(parts=(CorpusPart(path=path),)), out
    ),
    "generate_scene": lambda path, _: scenes.generate_scene(scenes.GenerateSettings(), path),
    "save_scene": lambda path, _: scenes.save_scene(build_example_scene(), path),
    "generate_bank": lambda path, _: avatars.generate_bank(path, count=1),
    "build_suite": lambda path, out: bench.build_suite([path], out),
    "build_suite out": lambda path, _: bench.build_suite([], path),
    "generate_missions": lambda path, out: bench.generate_missions([path], out),
    "list_scenes": lambda path, _: list_scenes([path], "test"),
    "import_set": lambda path, out: bench.import_set(path, [], out),
    "write_report out": lambda path, out: bench.write_report([out], path),
    "build_dataset": data.build_dataset,
    "build_shard": lambda path, out: data.build_shard(path, out, "0-of-2"),
    "merge_shards": lambda path, out: data.merge_shards([path], out),
    "merge_shards out": lambda path, out: data.merge_shards([out], path),
    "pack_exchanges": missions.pack_exchanges,
    "save_episodes": lambda path, _: missions.save_episodes(path, [], {}),
    "write_bytes": lambda path, _: write_bytes(path, b""),
    "folder_atomic": lambda path, _: folder_atomic(path).__enter__(),
}


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name", LOADERS)
def test_reading_a_path_that_is_none(name: str, bad: str) -> None:
    with pytest.raises(Gn0Error) as found:
        LOADERS[name](BAD[bad])
    str(found.value).encode()  # can be printed


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name", WRITERS)
def test_working_with_a_path_that_is_none(name: str, bad: str, tmp_path: Path) -> None:
    with pytest.raises(Gn0Error) as found:
        WRITERS[name](BAD[bad], tmp_path / "out")
    str(found.value).encode()


def test_what_is_said_of_such_a_path_names_it_and_a_remedy() -> None:
    with pytest.raises(StorageError, match="holds a NUL") as found:
        bench.load_suite("suites/a\0b")
    assert found.value.code == "STORAGE" and found.value.remedy
    assert found.value.where == "'suites/a\\x00b'"


@pytest.mark.parametrize("bad", BAD.values())
def test_the_house_s_own_doors_refuse_it(bad: str, tmp_path: Path) -> None:
    for door in (plain_path, read_bytes, check_writable, check_contained, Journal):
        with pytest.raises(StorageError):
            door(bad)
    with pytest.raises(StorageError):
        check_replaceable(bad, overwrite=True, marker="suite.json")
    for root, name in ((bad, "a"), (str(tmp_path), bad)):
        with pytest.raises(StorageError):
            safe_join(root, name)


def test_names_that_are_odd_but_possible_pass(tmp_path: Path) -> None:
    for name in ("a b", "ünïcode", "\t", os.fsdecode(b"\xff")):
        write_bytes(tmp_path / name, b"1")
        assert plain_path(tmp_path / name) == tmp_path / name
        assert read_bytes(str(tmp_path / name)) == b"1"


def test_a_name_that_is_no_text_can_be_printed() -> None:
    error = StorageError("x", where=os.fsdecode(b"\xff"), remedy="ü")
    assert str(error).encode() == "\\udcff: x (ü)".encode()
