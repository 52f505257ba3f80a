"""A small furnished flat, and its paths."""

from __future__ import annotations

import pytest

from gn0.missions.generate.scene_paths import ScenePaths, generate_paths
from gn0.missions.generate.settings import MissionSettings
from gn0.scenes.scene import Scene
from gn0.testing.scenes import build_room_scene


@pytest.fixture(scope="session")
def flat() -> Scene:
    return build_room_scene()


@pytest.fixture(scope="session")
def measures() -> MissionSettings:
    return MissionSettings(per_scene=14, minimum_length=2.5, lights=3)


@pytest.fixture(scope="session")
def flat_paths(flat: Scene, measures: MissionSettings) -> ScenePaths:
    return generate_paths(flat, measures, 3, radius=0.2, split="train", held_out=0.4)
