"""A bare stage for followers: a map, people on tracks, and an agent that says what it does.

People are drawn as upright boxes in two colours, behind walls not at all; they walk their tracks
whatever happens. Ticks of 0.1 s: everybody moves, and a move of the agent that would bring it
nearer to somebody than their discs allow is cut there, which is a touch. Who walks into it passes
through it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gn0.bench.follow_record import FollowRecord
from gn0.bench.follow_recorder import FollowRecorder, count_pixels
from gn0.data.follow import TargetTrack
from gn0.geometry import Pose2D
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import cast_rays
from gn0.missions.episode import AgentSpec
from gn0.sim.kinematics import Heading, step_forward
from gn0.sim.state import Action

WIDTH, HEIGHT, HFOV = 160, 120, 86.07
FOCAL = WIDTH / 2 / math.tan(math.radians(HFOV) / 2)
BODY = AgentSpec(radius=0.25, step_seconds=0.2)
TICK, HALF = 0.1, 0.22  # s; m: half the width of somebody

Colours = tuple[tuple[int, int, int], tuple[int, int, int]]


def flat_map() -> NavigationMap:
    """Two rooms of 6 m and a corridor that winds between them, 1.6 m wide."""
    cells = np.ones((240, 320), np.uint8)
    cells[10:130, 10:130] = 0  # a room
    cells[54:86, 130:220] = 0  # a corridor to the right
    cells[54:200, 188:220] = 0  # and up
    cells[110:230, 220:310] = 0  # another room
    cells[180:200, 200:240] = 0
    return NavigationMap(OccupancyGrid(cells, 0.05, (0.0, 0.0)), BODY.radius)


def walked(points: list[tuple[float, float]], speed: float, begin: float = 0.0) -> TargetTrack:
    """A track along points, from `begin` [s] on at a speed [m/s]."""
    places = np.array(points)
    arcs = np.r_[0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T))]
    return TargetTrack(begin + arcs / speed, places)


CORRIDOR = [(3.0, 3.5), (9.0, 3.5), (10.2, 3.9), (10.2, 9.0), (10.6, 9.5), (14.0, 9.4), (14.5, 8.0)]


def corridor_stage(speed: float, others: int = 0, *, alike: bool = False, seed: int = 0) -> Stage:
    """Somebody walks from the one room to the other, others about them, dressed alike or not."""
    rng = np.random.default_rng(seed)
    red, green = ((200, 40, 40), (40, 40, 120)), ((40, 150, 60), (90, 80, 70))
    tracks, looks = [walked(CORRIDOR, speed)], [red]
    for k in range(others):
        at = rng.uniform(2.5, 6.0)  # walks off somewhere, from beside the way of the first
        side = 1.0 if (k + seed) % 2 else -1.0
        a = (3.0 + at * 0.7, 3.5 + side * 0.9)
        b = (5.9, 5.8) if side > 0 else (5.9, 1.2)
        crossing = [a, (5.4, 3.5 - side * 0.3), (b[0], 7.0 - b[1])]
        tracks.append(walked(crossing, rng.uniform(0.5, 0.9), begin=rng.uniform(0.0, 2.0)))
        looks.append(red if alike else green)
    return Stage(flat_map(), tracks, Pose2D(1.5, 3.5, 0.0), looks)


@dataclass
class Stage:
    """What is on the stage; `tracks[0]` is of the person to follow."""

    navigation: NavigationMap
    tracks: list[TargetTrack]
    start: Pose2D
    looks: list[Colours]
    tall: float = 1.7
    preferred: float = 1.5
    sight: OccupancyGrid | None = None  # what hides people; None: whatever the map has
    pose: Pose2D = field(init=False)
    time: float = 0.0
    collided: bool = False

    def places(self, time: float) -> list[tuple[float, float]]:
        return [track.place_at(time) for track in self.tracks]

    def look(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Pictures of person numbers [H, W] and colours [H, W, 3]."""
        numbers = np.zeros((HEIGHT, WIDTH), np.uint8)
        rgb = np.full((HEIGHT, WIDTH, 3), 150, np.uint8)
        columns = np.arctan2(WIDTH / 2 - np.arange(WIDTH) - 0.5, FOCAL)
        x, y, yaw = self.pose
        walls = cast_rays(self.sight or self.navigation.grid, x, y, yaw + columns, 15.0)
        order = sorted(enumerate(self.places(self.time)), key=lambda p: -self._away(p[1]))
        for k, (x, y) in order:
            dx, dy = x - self.pose.x, y - self.pose.y
            c, s = math.cos(self.pose.yaw), math.sin(self.pose.yaw)
            ahead, left = c * dx + s * dy, c * dy - s * dx
            if ahead < 0.15:
                continue
            middle, half = WIDTH / 2 - FOCAL * left / ahead, FOCAL * HALF / ahead
            a = min(max(round(middle - half), 0), WIDTH)
            b = min(max(round(middle + half), a), WIDTH)  # off to the left: nothing
            top = max(round(HEIGHT / 2 - FOCAL * (self.tall - BODY.camera_height) / ahead), 0)
            foot = min(round(HEIGHT / 2 + FOCAL * BODY.camera_height / ahead), HEIGHT)
            waist = HEIGHT / 2 + FOCAL * (BODY.camera_height - 0.9) / ahead
            shown = np.zeros(WIDTH, np.bool_)
            shown[a:b] = walls[a:b] * np.cos(columns[a:b]) > ahead - 0.1
            rows = np.arange(HEIGHT)
            mask = ((rows >= top) & (rows < foot))[:, None] & shown[None]
            numbers[mask] = k + 1
            upper, lower = self.looks[k]
            rgb[mask & (rows < waist)[:, None]] = upper
            rgb[mask & (rows >= waist)[:, None]] = lower
        return numbers, rgb

    def ranges(self) -> NDArray[np.float64]:
        """The range ring [72] m: to walls, and to discs of people, as far as the agent can go."""
        x, y, yaw = self.pose
        angles = yaw + 2 * np.pi * np.arange(72) / 72
        free = cast_rays(self.navigation.inflated, x, y, angles, 10.0).astype(np.float64)
        for px, py in self.places(self.time):
            along = (px - x) * np.cos(angles) + (py - y) * np.sin(angles)
            aside = (px - x) * np.sin(angles) - (py - y) * np.cos(angles)
            chord = np.sqrt(np.maximum((BODY.radius + 0.25) ** 2 - aside**2, 0.0))
            met = (chord > 0) & (along > 0)
            free = np.where(met, np.minimum(free, np.maximum(along - chord, 0.0)), free)
        return free

    def _away(self, place: tuple[float, float]) -> float:
        return math.dist(place, (self.pose.x, self.pose.y))

    def play(self, choose: Callable[[Stage], Action], steps: int = 300) -> FollowRecord:
        """Play until the last person has arrived and 3 s are over, a touch, or the last step."""
        self.pose, self.time, self.collided = self.start, 0.0, False
        heading = Heading(self.start.yaw, 0, BODY.turn_degrees)
        over = float(self.tracks[0].times[-1])
        recorder = FollowRecorder(
            1, step_seconds=BODY.step_seconds, preferred=self.preferred, picture=WIDTH * HEIGHT,
            reference_steps=math.ceil((over + 3.0) / BODY.step_seconds - 1e-9),
        )  # fmt: skip
        numbers = range(1, len(self.tracks) + 1)

        def people() -> dict[int, tuple[float, float]]:
            return dict(zip(numbers, self.places(self.time), strict=True))

        def pixels() -> dict[int, int]:
            return count_pixels(self.look()[0], numbers)

        recorder.begin(self.pose, people(), pixels=pixels())
        for _ in range(steps):
            action = choose(self)
            hit = None
            self.collided = False
            if action in (Action.LEFT, Action.RIGHT):
                heading = heading.turned(1 if action == Action.LEFT else -1)
                self.pose = Pose2D(self.pose.x, self.pose.y, heading.yaw)
            for _ in range(round(BODY.step_seconds / TICK)):
                self.time = round(self.time + TICK, 6)
                if action == Action.FORWARD and not self.collided:
                    hit = self._advance()
            recorder.step(
                self.pose, people(), action, hit=hit, arrived=self.time >= over, pixels=pixels()
            )
            if hit is not None or self.time >= over + 3.0 + BODY.step_seconds:
                break
        return recorder.record()

    def _advance(self) -> int | None:
        """One tick of FORWARD; the number of who cut it short."""
        x, y, yaw = self.pose
        wanted = step_forward(x, y, yaw, BODY.forward_step * TICK / BODY.step_seconds)
        nx, ny, wall = self.navigation.move(x, y, *wanted)
        for k, place in enumerate(self.places(self.time)):
            near = math.dist((nx, ny), place)
            if near < BODY.radius + 0.25 and near < math.dist((x, y), place):
                self.collided = True
                return k + 1
        self.pose, self.collided = Pose2D(nx, ny, yaw), wall
        return None
