"""Names of colours read from pictures of people in generated scenes, by a grey card's light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.light import LightProbes, find_probes
from gn0.avatars.posed_bank import NEARER
from gn0.avatars.poses import standing_pose
from gn0.geometry import view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.maps.ray import is_line_free
from gn0.missions.language.words_judge import Moment, PlacedPerson, read_people
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0.scenes.procedural.kinds import KindName
from gn0.seeds import random_stream
from gn0.viewer.avatar_check import score_colour
from gn0_figures.people_light import draw_places, light_scene

SCENES: tuple[tuple[KindName, int], ...] = (
    ("apartment", 21), ("apartment", 34), ("corridor", 12), ("office", 5),
)  # fmt: skip
FAR, EYE, TURN = 3.0, 1.3, 0.25  # m, m, rad: from where people are seen, as in even light
_CAMERA = Camera.from_vfov(480, 360, 70.0)
_PLACES = 200  # tried a scene


@dataclass(eq=False)
class ColourRoom:
    """A scene in which people are looked at, and what was read there.

    Attributes:
        name: its kind and seed.
        spots: (x, y, yaw) of people whom an eye `FAR` away sees, and that eye's (x, y) [S, 5].
        scores: of each garment that was read.
        misses: what was said and read where they differ.
        dark: garments that were left out for want of light.
    """

    name: str
    renderer: RendererCpu
    probes: LightProbes
    spots: list[tuple[float, float, float, float, float]]
    scores: list[float] = field(default_factory=list)
    misses: list[tuple[str, str, str]] = field(default_factory=list)
    dark: int = 0


def open_rooms() -> list[ColourRoom]:
    """Small generated scenes with places for people."""
    rooms = []
    for kind, seed in SCENES:
        scene = light_scene(kind, seed)
        rooms.append(
            ColourRoom(
                f"{kind} {seed}",
                RendererCpu(scene.cloud),
                find_probes(scene.cloud, scene.grid, cache=False),
                _find_spots(scene.grid, seed),
            )
        )
    return rooms


def _find_spots(grid: OccupancyGrid, seed: int) -> list[tuple[float, float, float, float, float]]:
    """Places where somebody may stand with free floor before him."""
    stream = random_stream(seed, "colour spots")
    wide = inflate(grid, 0.2)
    spots = []
    for x, y in draw_places(grid, _PLACES, seed):
        for turn in stream.permutation(16) * np.pi / 8:
            eye = (float(x + FAR * np.cos(turn)), float(y + FAR * np.sin(turn)))
            if is_line_free(wide, eye, (float(x), float(y))):
                spots.append((float(x), float(y), float(turn - TURN), *eye))
                break
    return spots


def read_garments(rooms: Sequence[ColourRoom], avatar: Avatar, number: int) -> None:
    """Read top and bottom of somebody in each room, and note the scores there."""
    cloud = avatar.pose(standing_pose())
    for room in rooms:
        x, y, yaw, ex, ey = room.spots[number % len(room.spots)]
        room.renderer.name_cloud("somebody", cloud)
        pose = np.eye(4)
        c, s = np.cos(yaw), np.sin(yaw)
        pose[:2, :2], pose[:2, 3] = ((c, -s), (s, c)), (x, y)
        view = view_from_pose(ex, ey, EYE, float(np.arctan2(y - ey, x - ex)))
        instance = Instance("somebody", pose, room.probes.gain_at(x, y), NEARER)
        person = PlacedPerson(instance, cloud, avatar.record)
        (seen,) = read_people(room.renderer, _CAMERA, Moment(view, [person]))
        for part in ("top", "bottom"):
            reading = seen.parts.get(part)
            if reading is None:
                continue
            room.dark += reading.doubt == "it is too dark"
            if reading.colour:
                said = avatar.record[f"{part}_colour"]
                score = score_colour(said, reading.colour)
                room.scores.append(score)
                if score < 1.0:
                    room.misses.append((part, said, reading.colour))
