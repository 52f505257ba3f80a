"""No name in a stranger's file leads out of its folder, through whichever door it comes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import msgspec
import pytest

from gn0.bench.scene_archive import MAGIC, unpack_scene
from gn0.bench.worker_messages import Lease
from gn0.cli.main import main
from gn0.errors import ConfigError, FormatError, Gn0Error, StorageError
from gn0.gaussians.splat_files import load_cloud
from gn0.missions.episode_files import load_episodes, save_episodes
from gn0.plugins import get_plugin
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import check_scene_id, load_scene, save_scene
from gn0.sim.tasks import load_tasks
from gn0.storage import safe_join
from gn0.suites.suite import build_suite, load_suite
from gn0_trials.path_corpus import CLIMBING, HARMLESS, climbing_paths

pytestmark = pytest.mark.usefixtures("workers_here")

PATHS = climbing_paths()
# what a JSON file can hold: lone surrogates cannot be written as UTF-8
WRITABLE = [p for p in PATHS if p.encode("utf-8", "replace").decode() == p]
# one of each trick and all that climb: for doors that are slow to open
SOME = [paths[0] for paths in CLIMBING.values()] + list(CLIMBING["parent"][:4])


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene and a suite of three episodes."""
    root = tmp_path_factory.mktemp("home")
    save_scene(build_example_scene(), root / "flat")
    build_suite([root / "flat"], root / "suite", 3)
    return root


def tree(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*")}


def test_the_corpus_is_as_large_as_promised() -> None:
    assert len(set(PATHS)) == len(PATHS) >= 60
    assert all(len(paths) >= 4 for paths in CLIMBING.values())


@pytest.mark.parametrize("path", PATHS, ids=lambda p: ascii(p)[:40])
def test_every_path_of_the_corpus_is_refused(tmp_path: Path, path: str) -> None:
    with pytest.raises(StorageError) as caught:
        safe_join(tmp_path, path)
    assert caught.value.remedy and len(str(caught.value)) < 600


@pytest.mark.parametrize("path", HARMLESS)
def test_a_plain_name_is_not(tmp_path: Path, path: str) -> None:
    assert safe_join(tmp_path, path).resolve().is_relative_to(tmp_path.resolve())


def test_links_are_followed_and_then_judged(tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    (tmp_path / "secret").write_text("x")
    (root / "inside").write_text("x")
    for name, target in (
        ("absolute", tmp_path / "secret"), ("relative", Path("../secret")),
        ("folder", tmp_path), ("chain", root / "folder"), ("loop", root / "loop"),
    ):  # fmt: skip
        (root / name).symlink_to(target)
    for bad in ("absolute", "relative", "folder/secret", "chain/secret", "folder/root/inside/.."):
        with pytest.raises(StorageError):
            safe_join(root, bad)
    (root / "good").symlink_to("inside")
    assert safe_join(root, "good").read_text() == "x"
    try:
        looped = safe_join(root, "loop")
    except StorageError:
        return
    with pytest.raises(OSError, match="symbolic links"):
        looped.read_text()


@pytest.mark.parametrize("path", PATHS, ids=lambda p: ascii(p)[:40])
def test_no_such_path_is_a_scene_id(path: str) -> None:
    with pytest.raises(Gn0Error, match="not a plain name"):
        check_scene_id(path)


@pytest.mark.parametrize("path", WRITABLE, ids=lambda p: ascii(p)[:40])
def test_no_suite_reaches_out_through_a_scene_folder(home: Path, tmp_path: Path, path: str) -> None:
    suite = Path(shutil.copytree(home / "suite", tmp_path / "suite"))
    about = json.loads((suite / "suite.json").read_text())
    about["scenes"][0]["folder"] = path
    (suite / "suite.json").write_text(json.dumps(about))
    with pytest.raises(StorageError, match="path"):
        load_suite(suite)


@pytest.mark.parametrize("path", SOME, ids=lambda p: ascii(p)[:40])
def test_no_suite_of_an_environment_reaches_out(home: Path, tmp_path: Path, path: str) -> None:
    """Gym's `suite=` reads suite.json on its own: it must keep the same door shut."""
    (tmp_path / "suite").mkdir()
    about = json.loads((home / "suite/suite.json").read_text())
    about["scenes"][0]["folder"] = path
    shutil.copy(home / "suite/episodes.parquet", tmp_path / "suite")
    (tmp_path / "suite/suite.json").write_text(json.dumps(about))
    with pytest.raises(StorageError, match="path"):
        load_tasks(suite=tmp_path / "suite")


@pytest.mark.parametrize("path", WRITABLE, ids=lambda p: ascii(p)[:40])
def test_no_scene_names_splats_elsewhere(home: Path, tmp_path: Path, path: str) -> None:
    scene = Path(shutil.copytree(home / "flat", tmp_path / "flat"))
    about = json.loads((scene / "scene.json").read_text())
    about["cloud"] = path
    (scene / "scene.json").write_text(json.dumps(about))
    with pytest.raises(Gn0Error):
        load_scene(scene).gaussians  # noqa: B018 (it loads on demand)


@pytest.mark.parametrize("path", SOME, ids=lambda p: ascii(p)[:40])
def test_an_episode_may_be_called_anything_and_still_writes_nowhere_else(
    home: Path, tmp_path: Path, path: str
) -> None:
    suite = load_suite(home / "suite")
    scene = load_scene(home / "flat")
    odd = [msgspec.structs.replace(suite.episodes[0], id=path or "empty", split=path)]
    file = tmp_path / "inside" / "episodes.parquet"
    try:
        save_episodes(file, odd, {scene.id: scene.grid})
        assert load_episodes(file)[0].id == odd[0].id
    except Gn0Error:
        assert not file.exists()
    assert tree(tmp_path) <= {"inside", "inside/episodes.parquet"}


@pytest.mark.parametrize("path", SOME, ids=lambda p: ascii(p)[:40])
def test_an_episode_of_a_scene_called_so_finds_no_scene(home: Path, path: str) -> None:
    suite = load_suite(home / "suite")
    with pytest.raises(Gn0Error):
        suite.scene_folder(path)
    stray = msgspec.structs.replace(suite.episodes[0], scene_id=path)
    lease = Lease(episode=stray, folder=str(home / "flat"), hash="0")
    assert lease.folder == str(home / "flat"), "the folder never comes from the episode"


@pytest.mark.parametrize(
    "path", [p for p in WRITABLE if len(p.encode()) <= 4096], ids=lambda p: ascii(p)[:40]
)
def test_no_parcel_unpacks_outside_its_folder(tmp_path: Path, path: str) -> None:
    name = path.encode()
    parcel = MAGIC + (1).to_bytes(8, "little")
    parcel += len(name).to_bytes(8, "little") + (1).to_bytes(8, "little") + name + b"x"
    with pytest.raises((StorageError, FormatError)):
        unpack_scene(parcel, "abc", tmp_path / "cache")
    assert tree(tmp_path) == {"cache"}


@pytest.mark.parametrize("path", WRITABLE, ids=lambda p: ascii(p)[:40])
def test_no_gltf_opens_a_buffer_elsewhere(tmp_path: Path, path: str) -> None:
    attributes = {"POSITION": 0, "KHR_gaussian_splatting:ROTATION": 0}
    asset = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "buffers": [{"uri": path, "byteLength": 12}],
        "bufferViews": [{"buffer": 0, "byteLength": 12}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 1, "type": "VEC3"}],
        "meshes": [
            {"primitives": [{"attributes": attributes, "mode": 0,
                             "extensions": {"KHR_gaussian_splatting": {}}}]}
        ],
        "nodes": [{"mesh": 0}],
    }  # fmt: skip
    (tmp_path / "x.gltf").write_text(json.dumps(asset))
    with pytest.raises(Gn0Error):
        load_cloud(tmp_path / "x.gltf")


@pytest.mark.parametrize("path", WRITABLE, ids=lambda p: ascii(p)[:40])
def test_no_sog_folder_opens_a_plane_elsewhere(tmp_path: Path, path: str) -> None:
    plane = {"shape": [1, 3], "dtype": "float32", "mins": [0] * 3, "maxs": [1] * 3, "files": [path]}
    meta = {
        "version": 2, "count": 1,
        "means": {**plane, "files": [path, path]}, "scales": {"codebook": [0] * 256, **plane},
        "quats": plane, "sh0": {"codebook": [0] * 256, **plane},
    }  # fmt: skip
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    with pytest.raises(Gn0Error):
        load_cloud(tmp_path / "meta.json")


@pytest.mark.parametrize("path", PATHS, ids=lambda p: ascii(p)[:40])
def test_no_plugin_is_found_by_a_path(path: str) -> None:
    with pytest.raises(ConfigError, match="no policy named"):
        get_plugin("policy", path)


@pytest.mark.parametrize("path", [*SOME, ".x", "os/../x", "../conftest"])
def test_no_plugin_module_is_a_path(home: Path, tmp_path: Path, path: str) -> None:
    arguments = ["bench", "run", str(home / "suite"), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--plugin", path]) == 2
    assert not (tmp_path / "out").exists()
