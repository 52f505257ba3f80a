"""Trips for tests of exporters: planned in a floor plan, seen by eyes that need no splats."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np
from msgspec.structs import replace

from gn0.data.codec import encode_waypoints
from gn0.data.expert_labels import label_along, plan_expert
from gn0.data.sample_table import EpisodeRows
from gn0.export.dataset_source import build_trip
from gn0.export.trips import ExportSource, Frame, MapView, SceneCard, Sensors, Trip
from gn0.geometry import F32, F64, U8, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import cast_rays
from gn0.missions.episode import Episode, MissionGoal, MissionInstruction
from gn0.render.camera import Camera
from gn0.sim.presets import CameraPreset
from gn0.sim.sensors import MapFrame, paint_grid
from gn0.storage import content_hash
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

TOY_CAMERA = CameraPreset(
    name="toy",
    rgb=Camera.from_hfov(96, 72, 90.0),
    depth=Camera.from_hfov(48, 36, 90.0),
)
_ROWS = (
    "poses", "executed", "actions", "waypoints", "pixels", "valid", "distance", "collided",
)  # fmt: skip
RING = 720  # rays around the eye
REACH = 10.0  # m


class ToyEyes:
    """Sees walls and floor of a map, coloured by where they stand."""

    def __init__(self, grids: dict[str, OccupancyGrid]) -> None:
        self._grids = grids

    def frames(self, trip: Trip, sensors: Sensors) -> Iterator[Frame]:
        """Through the toy camera, at the agent's height."""
        camera = replace(TOY_CAMERA, agent=trip.episode.agent)
        return self.look(trip, trip.poses, camera, sensors)

    def look(
        self, trip: Trip, poses: F64, preset: CameraPreset, sensors: Sensors
    ) -> Iterator[Frame]:
        """Through any camera."""
        blocked = self._grids[trip.episode.scene_id]
        height = preset.agent.camera_height
        for x, y, yaw in poses:
            view = view_from_pose(x, y, height, yaw, np.radians(preset.pitch_degrees))
            angles = 2 * np.pi * np.arange(RING) / RING
            ring = cast_rays(blocked, float(x), float(y), angles, REACH)
            rgb = depth = None
            if "rgb" in sensors:
                rgb = _colour(_depth(preset.rgb, view, height, ring))
                width, tall = preset.picture_size
                rgb = rgb[:tall, :width]
            if "depth" in sensors:
                depth = _depth(preset.depth, view, height, ring)
            yield Frame(rgb, depth)

    def maps(self, trip: Trip) -> MapView:
        """The floor plan, in colours from above."""
        grid = self._grids[trip.episode.scene_id]
        frame = MapFrame.of_grid(grid)
        bare = paint_grid(grid, frame)
        return MapView(frame, bare // np.array([1, 2, 3], np.uint8), bare)

    def goal(self, trip: Trip) -> U8 | None:
        """The view of a goal mission from where its path ends."""
        if not isinstance(trip.episode.mission, MissionGoal):
            return None
        camera = replace(TOY_CAMERA, agent=trip.episode.agent)
        return next(self.look(trip, trip.poses[-1:], camera, ("rgb",))).rgb


def _depth(camera: Camera, view: F64, height: float, ring: F32) -> F32:
    block = max(1, camera.width // 96)  # large pictures are seen in blocks
    u, v = np.meshgrid(
        (np.arange(camera.width // block) + 0.5) * block,
        (np.arange(camera.height // block) + 0.5) * block,
    )
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)])
    turned = view[:3, :3].T
    rays = [sum(turned[i, j] * local[j] for j in range(3)) for i in range(3)]
    level = np.hypot(rays[0], rays[1])
    turn = np.rint(np.arctan2(rays[1], rays[0]) / (2 * np.pi) * RING).astype(np.int64) % RING
    wall = ring[turn] / np.maximum(level, 1e-6)
    floor = np.where(rays[2] < -1e-6, -height / np.minimum(rays[2], -1e-6), np.inf)
    seen = np.clip(np.minimum(wall, floor), 0.0, REACH).astype(np.float32)
    large = seen.repeat(block, 0).repeat(block, 1)
    rest = (camera.height - large.shape[0], camera.width - large.shape[1])
    return np.pad(large, ((0, rest[0]), (0, rest[1])), "edge")


def _colour(depth: F32) -> U8:
    far = depth / REACH
    return (np.stack([1 - far, 0.5 + 0.4 * np.sin(4 * far), far], -1) * 255).astype(np.uint8)


def build_toy_trips(
    count: int = 3, seed: int = 0, scenes: int = 2, longest: int = 0, turn: float = 15.0
) -> tuple[list[Trip], dict[str, OccupancyGrid]]:
    """Trips in small floor plans: two splits, two missions on the first path of each plan.

    Args:
        count: trips a plan.
        seed: seed of plans and episodes.
        scenes: how many plans.
        longest: only the last so many poses of each trip; 0 means all.
        turn: angle of a turn [degrees].
    """
    trips: list[Trip] = []
    grids: dict[str, OccupancyGrid] = {}
    for number in range(scenes):
        name = f"plan-{number}"
        grid = build_floor_plan(seed + number + 1, width=5.0, depth=4.0, clutter=2)
        grids[name] = grid
        navigation = NavigationMap(grid)
        episodes = build_point_episodes(
            build_map_scene(grid, name), navigation, max(count - 1, 1), seed=seed, minimum=1.0
        )
        pair = replace(
            episodes[0],
            id=f"{episodes[0].id}-again",
            mission=MissionInstruction(
                goal=episodes[0].goal, instruction='Go on, "past" the post; stop at the wall – là.'
            ),
        )
        for episode in [*episodes, pair][:count]:
            split = "train" if number == 0 else "test"
            path = f"path-{episode.id.removesuffix('-again')}"
            body = replace(episode.agent, turn_degrees=turn)
            own = replace(episode, split=split, path_id=path, agent=body)
            trip = _walk(own, navigation)
            trips.append(_end_of(trip, longest) if 0 < longest < trip.frames else trip)
    return trips, grids


def _walk(episode: Episode, navigation: NavigationMap) -> Trip:
    poses, actions = plan_expert(navigation, episode)
    labels = label_along(navigation, episode, poses, actions)
    frame = MapFrame.of_grid(navigation.grid)
    rows = EpisodeRows(
        episode_id=episode.id,
        poses=poses[:-1],
        executed=actions,
        actions=labels.actions6,
        waypoints=labels.waypoints,
        pixels=encode_waypoints(frame, labels.waypoints, poses[:-1]),
        valid=labels.valid,
        distance=navigation.geodesic(episode.goal).distance(poses[:-1, :2]).astype(np.float32),
        collided=np.zeros(len(actions), bool),
    )
    return build_trip(episode, rows)


def _end_of(trip: Trip, frames: int) -> Trip:
    x, y, yaw = map(float, trip.poses[-frames])
    episode = replace(trip.episode, start=(x, y, yaw), path=((x, y), trip.episode.goal))
    rows = trip.rows
    assert rows is not None
    cut = {name: getattr(rows, name)[-frames:] for name in _ROWS}
    return build_trip(episode, dataclasses.replace(rows, **cut))


def build_toy_source(trips: Sequence[Trip], grids: dict[str, OccupancyGrid]) -> ExportSource:
    """A dataset of these trips."""
    return ExportSource(
        name="toy",
        digest=content_hash(*(repr(t.episode) + repr(t.moves.tolist()) for t in trips)),
        preset=replace(TOY_CAMERA, agent=trips[0].episode.agent),
        scenes={name: SceneCard(name, "toy", "CC0-1.0", "0" * 32) for name in grids},
        trips=lambda: iter(trips),
        grid=grids.__getitem__,
        eyes=ToyEyes(grids),
        step_seconds=trips[0].episode.agent.step_seconds,
    )


@cache
def toy_source(count: int = 3, seed: int = 0, longest: int = 0, turn: float = 15.0) -> ExportSource:
    """A small dataset of walks in floor plans; the same for the same arguments."""
    return build_toy_source(*build_toy_trips(count, seed, longest=longest, turn=turn))


TURNS_OF_30 = ("navid", "uninavid")  # formats of agents that turn by 30°


def toy_source_for(format: str, count: int = 3, seed: int = 0, longest: int = 0) -> ExportSource:
    """The same, walked by the body that a format is for."""
    return toy_source(count, seed, longest, turn=30.0 if format in TURNS_OF_30 else 15.0)
