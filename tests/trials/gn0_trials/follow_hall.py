"""A scene for follow missions: two rooms and a corridor that winds between them, 16 m by 12 m."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.maps.grid import OccupancyGrid
from gn0.missions.generate.scene_paths import ScenePaths, generate_paths
from gn0.missions.generate.settings import MissionSettings
from gn0.scenes.scene import Scene
from gn0.sim.presets import find_preset
from gn0.testing.scenes import build_room_scene

BODY = find_preset("follower").agent
SETTINGS = MissionSettings(per_scene=5, missions=("follow",), minimum_length=8.0)


def build_hall() -> Scene:
    """Nothing in it is labelled, so that paths lead from place to place."""
    cells = np.ones((240, 320), np.uint8)
    cells[10:130, 10:130] = 0  # a room
    cells[54:86, 130:220] = 0  # a corridor to the right
    cells[54:200, 188:220] = 0  # and up
    cells[110:230, 220:310] = 0  # another room
    grid = OccupancyGrid(cells, 0.05, (0.0, 0.0))
    return replace(build_room_scene(), id="hall", grid=grid, objects=(), rooms=())


def hall_paths(scene: Scene, seed: int = 0, settings: MissionSettings = SETTINGS) -> ScenePaths:
    """Paths of at least 8 m."""
    return generate_paths(scene, settings, seed, radius=BODY.radius)
