"""A flat, a suite of six episodes in it, and the datasets that come of them, built once."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from gn0.data.build import build_dataset
from gn0.data.dataset import Dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.render.light import LightCondition
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.suites.suite import Suite, save_suite

CHUNK = 3  # episodes a part
EVENING = LightCondition(name="evening", exposure=-1.0, kelvin=3200.0)


@pytest.fixture(scope="session")
def data_suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """Six episodes: two in evening light, two missions of one path."""
    root = tmp_path_factory.mktemp("walks")
    save_scene(build_example_scene(), root / "flat")
    scene = load_scene(root / "flat")
    navigation = NavigationMap(scene.grid, 0.2)
    short = {
        "minimum_length": 1.5,
        "maximum_length": 2.5,
    }  # m: each state is drawn, again and again
    episodes = sample_goal_episodes(scene, navigation, 5, 0, **short)
    change = msgspec.structs.replace
    episodes = [change(e, path_id=f"p{n}", split="train") for n, e in enumerate(episodes)]
    episodes[1] = change(episodes[1], light=EVENING)
    episodes[2] = change(episodes[2], light=EVENING)
    episodes.append(change(episodes[3], id="zwilling"))
    return save_suite(
        root / "suite", [scene], episodes, name="walks", camera="tiny_128", max_steps=60
    )


@pytest.fixture(scope="session")
def settings_of() -> Callable[..., BuildSettings]:
    """Build settings of a cache layout, in small parts."""

    def make(layout: str = "webdataset", **pictures: object) -> BuildSettings:
        return BuildSettings(
            chunk=CHUNK,
            pictures=PictureSettings(layout=layout, **pictures),  # type: ignore[arg-type]
        )

    return make


@pytest.fixture(scope="session")
def labels_only(
    data_suite: Suite, settings_of: Callable[..., BuildSettings], tmp_path_factory
) -> Dataset:
    """Poses and labels; do not write to it."""
    return build_dataset(data_suite, tmp_path_factory.mktemp("l") / "data", settings_of("none"))


@pytest.fixture(scope="session")
def webdataset(
    data_suite: Suite, settings_of: Callable[..., BuildSettings], tmp_path_factory
) -> Dataset:
    """With a WebDataset cache; do not write to it."""
    return build_dataset(data_suite, tmp_path_factory.mktemp("w") / "data", settings_of())


@pytest.fixture(scope="session")
def webdataset_once(
    data_suite: Suite, settings_of: Callable[..., BuildSettings], tmp_path_factory
) -> Dataset:
    """With maps and goal pictures once, beside the shards; do not write to it."""
    out = tmp_path_factory.mktemp("o") / "data"
    return build_dataset(data_suite, out, settings_of(maps="once"))


@pytest.fixture(scope="session")
def lerobot(
    data_suite: Suite, settings_of: Callable[..., BuildSettings], tmp_path_factory
) -> Dataset:
    """With a LeRobot cache; do not write to it."""
    return build_dataset(data_suite, tmp_path_factory.mktemp("r") / "data", settings_of("lerobot"))


@pytest.fixture
def copy_of(tmp_path: Path) -> Callable[[Dataset], Path]:
    """A copy of a dataset that may be damaged."""

    def copy(dataset: Dataset) -> Path:
        return Path(shutil.copytree(dataset.folder, tmp_path / "copy"))

    return copy


@pytest.fixture(scope="session")
def files_of() -> Callable[[Path], dict[str, bytes]]:
    """Every file of a folder but the lock, by path."""

    def read(folder: Path) -> dict[str, bytes]:
        return {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file() and path.name != ".lock"
        }

    return read


@pytest.fixture(scope="package", autouse=True)
def scratch_cache(own_cache: Path) -> Iterator[None]:
    """Pictures cached by these tests go away with them; compiled kernels stay where they are."""
    with pytest.MonkeyPatch.context() as patch:
        if "NUMBA_CACHE_DIR" in os.environ:
            patch.setenv("NUMBA_CACHE_DIR", os.environ["NUMBA_CACHE_DIR"])  # as gn0.jit left it
        patch.setenv("GN0_CACHE", str(own_cache))
        yield
