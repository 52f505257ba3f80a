"""People in front of an agent in generated rooms: one who walks ahead on a path, others about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.light import LightProbes, find_probes
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.motion.library import ClipLibrary
from gn0.avatars.posed_bank import NEARER
from gn0.avatars.poses import standing_pose
from gn0.geometry import F64, view_from_pose
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import is_line_free
from gn0.missions.language.describe import describe_route
from gn0.missions.language.follow_words import FollowScene, scene_of_route
from gn0.missions.language.words_judge import Moment, PlacedPerson
from gn0.missions.paths import densify_path, plan_reference
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0.scenes.procedural.generate import GenerateSettings, generate_scene
from gn0.scenes.procedural.kinds import KindName
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream

CAMERA = Camera.from_vfov(480, 360, 70.0)
EYE = 1.3  # m
_VIEW = 0.55  # of a person off the middle of the view at most [rad]
_APART, _FROM, _TO = 0.7, 1.6, 5.5  # people from each other and from the agent [m]
_WIDE = 0.7  # of a person, so that nobody hides another [m]
_TRIES = 400


@dataclass(frozen=True, eq=False)
class PeopleScene:
    """A generated scene in which people are placed."""

    scene: Scene
    navigation: NavigationMap
    probes: LightProbes
    renderer: RendererCpu


def open_people_scene(kind: KindName, seed: int, folder: Path) -> PeopleScene:
    """The small scene of a kind and seed, in draft light."""
    settings = GenerateSettings(kind=kind, seed=seed, size="small", light="draft", density=3000.0)
    scene = generate_scene(settings, folder / f"{kind}-{seed}", overwrite=True)
    return PeopleScene(
        scene,
        NavigationMap(scene.grid, 0.30),
        find_probes(scene.gaussians, scene.grid, cache=False),
        RendererCpu(scene.gaussians),
    )


@dataclass(frozen=True, eq=False)
class Meeting:
    """An agent at the start of a path, the person ahead on it, others in view.

    Attributes:
        eye: (x, y, yaw) of the agent.
        places: (x, y, yaw) of the person, then of the others [K, 3].
        scene: what the person does.
    """

    eye: tuple[float, float, float]
    places: F64
    scene: FollowScene


def place_meeting(place: PeopleScene, others: int, seed: int) -> Meeting | None:
    """A meeting at random; None where there is no room for it."""
    stream = random_stream(seed, "meeting")
    navigation = place.navigation
    grid = navigation.inflated
    free = grid.centres_of(np.argwhere(~grid.blocked))
    for _ in range(_TRIES):
        start, goal = free[stream.integers(len(free), size=2)]
        if navigation.region_of(*start) != navigation.region_of(*goal):
            continue
        path = densify_path(plan_reference(navigation, _xy(start), _xy(goal)), 0.05)
        way = np.r_[0.0, np.cumsum(np.hypot(*np.diff(path, axis=0).T))]
        if way[-1] < 3.0:
            continue
        ahead = float(stream.uniform(1.2, 2.2))
        at = int(np.searchsorted(way, ahead))
        person, onward = path[at], path[min(at + 6, len(path) - 1)] - path[at]
        yaw = _angle(person - start)
        if not is_line_free(place.scene.grid, _xy(start), _xy(person)):
            continue
        found = [(person[0], person[1], _angle(onward))]
        for spot in free[stream.permutation(len(free))[:2500]]:
            if len(found) == others + 1:
                break
            if _fits_beside(spot, start, yaw, found) and is_line_free(
                place.scene.grid, _xy(start), _xy(spot)
            ):
                found.append((spot[0], spot[1], float(stream.uniform(-np.pi, np.pi))))
        if len(found) == others + 1:
            route = describe_route(place.scene, navigation, path[at:], found[0][2])
            scene = scene_of_route(
                route, ahead=True, distance=float(stream.uniform(1.0, 2.0)),
                lateral=float(stream.uniform(-0.5, 0.5)), speed=float(stream.uniform(0.4, 1.0)),
            )  # fmt: skip
            return Meeting((start[0], start[1], yaw), np.array(found), scene)
    return None


def _fits_beside(
    spot: F64, start: F64, yaw: float, found: Sequence[tuple[float, float, float]]
) -> bool:
    """Whether somebody at a spot is in view and hides none of those who are there."""
    distance, bearing = float(np.hypot(*(spot - start))), _turn(_angle(spot - start) - yaw)
    if not _FROM < distance < _TO or abs(bearing) > _VIEW:
        return False
    for x, y, _ in found:
        there = np.array((x, y)) - start
        clear = _WIDE / min(distance, float(np.hypot(*there)))
        if np.hypot(*(spot - (x, y))) < _APART or abs(_turn(_angle(there) - yaw) - bearing) < clear:
            return False
    return True


def _xy(point: F64) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _angle(along: F64) -> float:
    return float(np.arctan2(along[1], along[0]))


def _turn(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def show_meeting(
    place: PeopleScene, meeting: Meeting, avatars: Sequence[Avatar], seconds: float = 0.0
) -> Moment:
    """A moment of a meeting; the person has walked on since, the others stand.

    Args:
        place: the scene; its renderer learns the posed clouds.
        meeting: who is where.
        avatars: the person, then the others.
        seconds: since the meeting began.
    """
    people = []
    for k, (avatar, (x, y, yaw)) in enumerate(zip(avatars, meeting.places, strict=True)):
        pose, shift = standing_pose(), np.zeros(3)
        if k == 0:
            library = ClipLibrary(measure_build(avatar.joints, avatar.points, avatar.weights))
            gone = meeting.scene.speed * seconds
            phase = gone / library.clip("walk", meeting.scene.speed).stride % 1.0
            pose, shift = library.pose_at("walk", phase, meeting.scene.speed)
            x, y = x + gone * np.cos(yaw), y + gone * np.sin(yaw)
        cloud = avatar.pose(pose, shift)
        name = f"{avatar.name} {k}"
        place.renderer.name_cloud(name, cloud)
        stand = np.eye(4)
        c, s = np.cos(yaw), np.sin(yaw)
        stand[:2, :2], stand[:2, 3] = ((c, -s), (s, c)), (x, y)
        gain = place.probes.gain_at(x, y)
        people.append(PlacedPerson(Instance(name, stand, gain, NEARER), cloud, avatar.record))
    x, y, yaw = meeting.eye
    return Moment(view_from_pose(x, y, EYE, yaw), people)
