"""One small dataset of the built-in flat, in every shape that the readers of others open."""

from __future__ import annotations

import datetime
import json
import os
import time
from importlib import metadata
from pathlib import Path

import msgspec
import pytest

from gn0.data.build import build_dataset
from gn0.data.dataset import Dataset
from gn0.data.picture_build import render_dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import MissionInstruction
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.presets import find_preset
from gn0.suites.suite import save_suite

CAMERA = "rgbd_224"
DEPTH = PictureSettings(depth=True, depth_as="both")


@pytest.fixture(scope="session")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two goal missions and an instruction on the path of the first, with depth; both caches."""
    root = tmp_path_factory.mktemp("walks")
    save_scene(build_example_scene(), root / "flat")
    scene = load_scene(root / "flat")
    agent = find_preset(CAMERA).agent
    navigation = NavigationMap(scene.grid, agent.radius)
    episodes = sample_goal_episodes(scene, navigation, 2, 0, maximum_length=5.0, agent=agent)
    episodes = [msgspec.structs.replace(e, path_id=e.id) for e in episodes]
    words = MissionInstruction(goal=episodes[0].goal, instruction='Là-bas, "past" the sofa.')
    episodes.append(msgspec.structs.replace(episodes[0], id="words", mission=words))
    episodes = [msgspec.structs.replace(e, split="train") for e in episodes]
    suite = save_suite(root / "suite", [scene], episodes, name="walks", camera=CAMERA)
    dataset = build_dataset(suite, root / "data", BuildSettings(chunk=2, pictures=DEPTH))
    render_dataset(dataset.folder, msgspec.structs.replace(DEPTH, layout="lerobot"))
    return dataset


@pytest.fixture
def shards(walks: Dataset) -> Path:
    """The folder of its WebDataset shards."""
    return walks.folder / "pictures/webdataset"


PACKAGES = ("lerobot", "webdataset", "datasets", "pandas", "torch", "av", "pyarrow")
_BEGUN = time.time()


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write what was tried and how it ended, for the board: `make readers` says where."""
    out = os.environ.get("GN0_READERS")
    terminal = session.config.pluginmanager.get_plugin("terminalreporter")
    if not out or terminal is None:
        return
    counts = {kind: len(terminal.stats.get(kind, ())) for kind in ("passed", "skipped")}
    counts["failed"] = len(terminal.stats.get("failed", ())) + len(terminal.stats.get("error", ()))
    said = {
        "date": datetime.date.today().isoformat(),
        "versions": {name: _version(name) for name in PACKAGES},
        **counts,
        "seconds": round(time.time() - _BEGUN, 1),
    }
    Path(out).write_text(json.dumps(said, indent=2) + "\n")


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""
