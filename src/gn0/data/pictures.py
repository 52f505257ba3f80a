"""The pictures of a sample, drawn from a pose: the very ones that the simulator shows.

A step has one new rendering, the view. The history mosaic is made of earlier views, the BEV is
rendered once a scene and light, and the occupancy picture is the map with two dots.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gn0.data.samples import PICTURES
from gn0.geometry import F64, U8, Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.render.light import LightCondition
from gn0.render.renderer import Renderer, visible_backend
from gn0.scenes.scene import Scene
from gn0.sim.history import History
from gn0.sim.open import open_simulator
from gn0.sim.presets import CameraPreset
from gn0.sim.sensors import SensorSuite
from gn0.sim.simulator import goal_record, goal_view
from gn0.storage import content_hash

BATCH = 32  # views a call of the renderer
SENSORS = frozenset({"rgb", "depth", "history", "bev", "occupancy"})


def build_eyes(
    scene: Scene,
    navigation: NavigationMap,
    preset: CameraPreset,
    agent: AgentSpec,
    light: LightCondition | None = None,
    *,
    visible_sets: bool = False,
    backend: str = "cpu",
    renderer: Renderer | None = None,
) -> SensorSuite:
    """The sensors of an agent in a scene, under a light that the views and the BEV share.

    Args:
        scene: where.
        navigation: its map, inflated for the agent.
        preset: the cameras.
        agent: the body.
        light: None as the scene was made.
        visible_sets: draw views from the splats that show near each place, see
            `gn0.render.visible`.
        backend: name of the renderer.
        renderer: draws instead; it must hold this scene in this light.
    """
    return open_simulator(
        scene,
        preset,
        visible_backend(backend) if visible_sets else backend,
        SENSORS,
        agent,
        navigation=navigation,
        light=light,
        renderer=renderer,
    ).suite


@dataclass(frozen=True, eq=False)
class StepPictures:
    """What the agent sees at a step.

    Attributes:
        rgb: uint8 [H, W, 3], the view.
        history: uint8 [480, 640, 3], the mosaic of earlier views.
        bev: uint8 [Hb, Wb, 3], the scene from above.
        occupancy: uint8 [Hb, Wb, 3], the map with start and agent.
    """

    rgb: U8
    history: U8
    bev: U8
    occupancy: U8

    def hashes(self, known: Mapping[str, str] | None = None) -> dict[str, str]:
        """Digest of each picture's raw pixels; `known` spares those that are known already."""
        known = known or {}
        return {
            name: known.get(name) or content_hash(np.asarray(getattr(self, name)))
            for name in PICTURES
        }


def draw_episode(
    eyes: SensorSuite,
    episode: Episode,
    poses: F64,
    views: Iterator[tuple[Pose2D, U8]] | None = None,
) -> Iterator[StepPictures]:
    """The pictures at each of the poses [T, 3] of an episode, from its first step on.

    `views` are its poses and views [H, W, 3] where they are drawn already.
    """
    history = History()
    start = Pose2D(*episode.start)
    bev = map_picture(eyes)
    for pose, rgb in draw_views(eyes, poses) if views is None else views:
        yield StepPictures(rgb, history.mosaic(), bev, eyes.occupancy_picture(start, pose))
        history.add(rgb)


def draw_views(eyes: SensorSuite, poses: F64) -> Iterator[tuple[Pose2D, U8]]:
    """The view at each of some poses [T, 3]; one rendering for equal neighbours."""
    for begin in range(0, len(poses), BATCH):
        batch = [Pose2D(*map(float, row)) for row in poses[begin : begin + BATCH]]
        distinct = list(dict.fromkeys(batch))
        rgb, _ = eyes.look_many(distinct, frozenset({"rgb"}))
        assert rgb is not None
        places = {pose: index for index, pose in enumerate(distinct)}
        for pose in batch:
            yield pose, rgb[places[pose]]


def goal_picture(eyes: SensorSuite, episode: Episode) -> U8:
    """What an episode's goal looks like [H, W, 3]: the simulator's sensor of that name."""
    record = goal_record(episode)
    if record is not None:
        return eyes.look_at_goal(record)
    rgb, _ = eyes.look(goal_view(episode), frozenset({"rgb"}))
    assert rgb is not None
    return rgb


def map_picture(eyes: SensorSuite) -> U8:
    """The BEV picture [H, W, 3] of a scene and light."""
    nowhere = Pose2D(0.0, 0.0, 0.0)
    picture: U8 = eyes.read_static(nowhere, nowhere, (0.0, 0.0), frozenset({"bev"}))["bev"]
    return picture
