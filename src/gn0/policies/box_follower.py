"""`box_follower`: follows a person's box with two controllers, and looks for it when it is lost.

The controllers are proportional and derivative, one on the bearing and one on the distance. It
knows no map and no track: a baseline that a learned policy should beat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PolicyError
from gn0.geometry import Pose2D, wrap_angle
from gn0.missions.episode import AgentSpec
from gn0.policies.person_boxes import PersonBox, PictureView, find_boxes
from gn0.policies.person_tracker import FRESH, PersonTracker, Sighting, seen_from
from gn0.sim.presets import find_preset
from gn0.sim.state import Action, Observation

ROOM, AHEAD, NEAR = 0.30, 35.0, 1.4  # m, degrees, m: who is so near ahead is let pass
PATIENT = 0.15  # m too far off from which on a way round is gone
PATIENCE = 10  # steps that it waits for them, then it goes round
LOOK_AHEAD = 0.9  # m that must be free of walls in a direction that is walked
ENOUGH = 0.5  # m that must be free along a way round something, where any way has so much
SPARE = 0.03  # m that stay free ahead after a step: who leans on a wall gets stuck
WIDE = 38.0  # degrees off the axis that a person may come by a detour
REACHED = 0.3  # m from a place that is looked for
BEYOND = 1.6  # m that it walks on from the last place, where the person went
CIRCLE = 24  # turns of 15 degrees
_KEPT = (0.5, 5.0)  # m that may be asked for; two bodies touch at 0.5


@dataclass(frozen=True)
class BoxGains:
    """What the controllers do.

    Attributes:
        distance: to keep [m].
        turn, turn_rate: of the bearing [rad a rad, s].
        move, move_rate: of the distance's error [m a m, s].
        far: an error of the distance [m] from which walking comes before turning …
        ahead: … while the person is within this of the axis [degrees].
    """

    distance: float = 1.2
    turn: float = 1.0
    turn_rate: float = 0.15
    move: float = 1.0
    move_rate: float = 0.25
    far: float = 1.0
    ahead: float = 22.0


@dataclass(frozen=True, eq=False)
class RangeRing:
    """What is free around the agent.

    Attributes:
        ranges: [R] m to the first thing that its disc would touch; ray 0 straight ahead, then
            counter-clockwise.
    """

    ranges: NDArray[np.floating]

    def free(self, angle: float) -> float:
        """How far the agent can walk [m] at an angle from its heading [rad, left positive]."""
        step = 2 * math.pi / len(self.ranges)
        return float(self.ranges[round(angle / step) % len(self.ranges)])

    def reach(self, angle: float) -> float:
        """The same by the better one of the two rays beside the angle."""
        at = angle * len(self.ranges) / (2 * math.pi)
        low, high = math.floor(at) % len(self.ranges), math.ceil(at) % len(self.ranges)
        return float(max(self.ranges[low], self.ranges[high]))


def steer(seen: Sighting, gains: BoxGains, agent: AgentSpec) -> Action:
    """What the two controllers do in the open: turn first, walk, or stand (STOP).

    Each says how much is wanted; half a turn or half a step of that is acted upon.
    """
    turn = gains.turn * seen.bearing + gains.turn_rate * seen.turning
    move = gains.move * (seen.distance - gains.distance) + gains.move_rate * seen.leaving
    half_turn = math.radians(agent.turn_degrees) / 2
    walk_first = move > gains.far and abs(seen.bearing) <= math.radians(gains.ahead)
    if abs(turn) > half_turn and not walk_first:
        return Action.LEFT if turn > 0 else Action.RIGHT
    return Action.FORWARD if move > agent.forward_step / 2 else Action.STOP


class BoxFollower:
    """Follows boxes step by step, and searches when there is none.

    Walls that its range ring shows are gone round. After a loss it walks the way on which it saw
    the person go, on where that way led, and turns round to the side on which the person went.

    Args:
        view: the camera.
        agent: the body.
        gains: of the controllers.
    """

    def __init__(self, view: PictureView, agent: AgentSpec, gains: BoxGains | None = None) -> None:
        self.agent, self.gains = agent, gains or BoxGains()
        self.tracker = PersonTracker(view)
        self._queue: list[Action] = []
        self._turned = 0
        self._waited = 0
        self._end: tuple[float, float] | None = None  # where a search has led
        self._went = 0.0  # the direction in which the person was going [rad]
        self._side = Action.LEFT

    def act(
        self,
        boxes: Sequence[PersonBox],
        pose: Pose2D,
        time: float,
        ranges: NDArray[np.floating],
        collided: bool = False,
    ) -> Action:
        """The next action.

        Args:
            boxes: of a picture.
            pose: of the agent by its odometry.
            time: since the episode began [s].
            ranges: its range ring.
            collided: whether the last move was cut short.
        """
        ring = RangeRing(ranges)
        box = self.tracker.look(boxes, pose, time)
        last = self.tracker.last
        if last is None:
            return Action.STOP
        if box is not None:
            self._turned, self._end = 0, None
            self._note_way(last, pose)
        if collided:  # away from what it leans on
            turn = math.radians(self.agent.turn_degrees)
            turns = max((k for k in range(-6, 7) if k), key=lambda k: (ring.free(k * turn), k))
            back = Action.LEFT if turns > 0 else Action.RIGHT
            self._queue = [*[back] * abs(turns), Action.FORWARD]
        elif self._queue and self._queue[0] == Action.FORWARD and not self._may_step(ring):
            self._queue = []
        if self._queue:
            action = self._queue.pop(0)
        elif box is not None:
            action = self._keep_to(last, pose, ring)
        else:
            action = self._search(last, pose, ring)
        if action != Action.FORWARD:
            return action
        if any(self._in_the_way(other, last.tall, ring) for other in boxes):
            self._waited += 1
            if self._waited <= PATIENCE:
                return Action.STOP
            return self._side  # they stand there: round them
        self._waited = 0
        return action

    def _note_way(self, last: Sighting, pose: Pose2D) -> None:
        """Where the person is going, and to which side of the agent."""
        going = last.bearing + last.turning * FRESH / 2
        if math.hypot(*last.velocity) > 0.2:
            self._went = math.atan2(last.velocity[1], last.velocity[0])
            if abs(going) < math.radians(5.0):
                going = wrap_angle(self._went - pose.yaw)
        self._side = Action.LEFT if going >= 0 else Action.RIGHT

    def _keep_to(self, last: Sighting, pose: Pose2D, ring: RangeRing) -> Action:
        """The controllers; by the person's own way where the straight one is not free."""
        action = steer(last, self.gains, self.agent)
        error = last.distance - self.gains.distance
        if error <= self.agent.forward_step / 2:
            return action if action != Action.FORWARD or self._may_step(ring) else Action.STOP
        free = ring.reach(last.bearing) >= min(error, LOOK_AHEAD)
        if free and (action != Action.FORWARD or self._may_step(ring)):
            return action
        if error < PATIENT:  # rather keep it in view
            return action if action != Action.FORWARD else Action.STOP
        return self._go_along(self._waypoint(last, pose, ring), pose, ring)

    def _may_step(self, ring: RangeRing) -> bool:
        return ring.free(0.0) >= self.agent.forward_step + SPARE

    def _open_way(self, wanted: float, need: float, ring: RangeRing, wide: float) -> float | None:
        """The heading [rad from now] nearest to the wanted one in which so much is free."""
        turn = math.radians(self.agent.turn_degrees)
        most = int(wide / turn) + 1
        near = round(wanted / turn)
        ways = [k * turn for k in range(near - most, near + most + 1)]
        free = [way for way in ways if ring.free(way) >= max(need, self.agent.forward_step + SPARE)]
        if not free:
            return None
        return min(free, key=lambda way: abs(way - wanted) + 0.1 * abs(way))

    def _go(self, way: float, ring: RangeRing) -> Action:
        """A turn towards a heading, or a step once it is ahead."""
        if abs(way) > math.radians(self.agent.turn_degrees) / 2:
            return Action.LEFT if way > 0 else Action.RIGHT
        return Action.FORWARD if self._may_step(ring) else self._side

    def _in_the_way(self, box: PersonBox, tall: float, ring: RangeRing) -> bool:
        """Whether somebody stands so near ahead that a step could touch.

        The ring shows it first, as a box that is half hidden seems nearer than it is.
        """
        bearing = self.tracker.view.bearing(box)
        near = ring.free(bearing) < self.agent.forward_step + ROOM
        near = near and self.tracker.view.distance(box, tall) < NEAR
        return near and abs(bearing) < math.radians(AHEAD)

    def _search(self, last: Sighting, pose: Pose2D, ring: RangeRing) -> Action:
        """To where the person would be, on from there, then round and round."""
        if self._turned == 0:
            if self._end is None and self._arrived(last, pose, ring):
                self._end = (pose.x, pose.y)
            if self._end is None:
                return self._go_along(self._waypoint(last, pose, ring), pose, ring)
            gone = math.dist((pose.x, pose.y), self._end)
            way = self._open_way(wrap_angle(self._went - pose.yaw), 0.5, ring, math.radians(60.0))
            if gone < BEYOND and way is not None:
                return self._go(way, ring)
        self._turned += 1
        if self._turned > CIRCLE:  # on to somewhere else, and look round again
            self._turned, self._end = 0, (pose.x, pose.y)
            self._went = pose.yaw + self._widest(ring)
        return self._side

    def _arrived(self, last: Sighting, pose: Pose2D, ring: RangeRing) -> bool:
        near = math.dist((pose.x, pose.y), last.place) < REACHED
        bearing, distance = seen_from(pose, last.place)
        return near or (distance < 1.0 and ring.free(bearing) < 0.1)

    def _waypoint(self, last: Sighting, pose: Pose2D, ring: RangeRing) -> tuple[float, float]:
        """The latest place of the person's trail that can be walked to straight away."""
        trail = [(x, y) for _, x, y in self.tracker.trail]
        away = [math.dist(place, (pose.x, pose.y)) for place in trail]
        ahead = trail[int(np.argmin(away)) :]  # what lies behind was walked
        for place in reversed(ahead):
            bearing, distance = seen_from(pose, place)
            if distance > REACHED and ring.reach(bearing) >= distance - 0.05:
                return place
        onward = (place for place in ahead if seen_from(pose, place)[1] > 2 * REACHED)
        return next(onward, last.place)

    def _go_along(self, place: tuple[float, float], pose: Pose2D, ring: RangeRing) -> Action:
        """A step towards a place, or the first of the turns that lead there."""
        bearing, distance = seen_from(pose, place)
        if abs(bearing) <= math.radians(self.agent.turn_degrees) / 2 and ring.free(0.0) >= min(
            distance, ENOUGH
        ):
            return Action.FORWARD
        wide = math.radians(75.0)
        way = self._open_way(bearing, min(distance, ENOUGH), ring, wide)
        if way is None:
            way = self._open_way(bearing, 0.0, ring, math.radians(120.0))
        if way is None:
            return self._go(bearing, ring)
        turns = round(way / math.radians(self.agent.turn_degrees))
        side = Action.LEFT if turns > 0 else Action.RIGHT
        # once begun it is gone through with: two headings would be tried in turns for ever
        self._queue = [*[side] * abs(turns), Action.FORWARD, Action.FORWARD]
        return self._queue.pop(0)

    def _widest(self, ring: RangeRing) -> float:
        """The heading [rad from now] in which most is free."""
        return wrap_angle(2 * math.pi * int(np.argmax(ring.ranges)) / len(ring.ranges))


class PolicyBoxFollower:
    """Follows the person who is nearest ahead in the first view, by boxes of the person picture.

    It is given boxes and colours, and no numbers of people: who looks like the one that it follows
    can lead it astray.

    Args:
        preset: the camera and the body, by name.
        distance: to keep [m], 0.5 to 5.

    Raises:
        PolicyError: no such camera, or a distance out of range.
    """

    name = "box_follower"
    sensors: frozenset[str] = frozenset({"rgb", "who", "pose", "ranges"})

    def __init__(self, preset: str = "follower", distance: float = BoxGains.distance) -> None:
        self._preset = find_preset(preset)
        low, high = _KEPT
        number = isinstance(distance, int | float) and not isinstance(distance, bool)
        if not number or not low <= distance <= high:
            raise PolicyError(
                f"keeps a distance of {distance!r}",
                where="box_follower, distance",
                remedy=f"give metres, {low:g} to {high:g}",
            )
        self._gains = BoxGains(distance=float(distance))
        self._follower: BoxFollower | None = None

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._follower = None

    def act(self, observation: Observation) -> Action:
        """Keep the box ahead and at its distance.

        Raises:
            PolicyError: no person picture, one of another size than the colour picture, or one of
                another camera than its own; or no odometry or range ring.
        """
        people, rgb = observation.read("who"), observation.rgb
        if people is None or rgb is None or people.shape != rgb.shape[:2]:
            raise PolicyError(
                "box_follower needs a person picture of the size of the colour picture",
                remedy="give the suite a camera whose two pictures are of one size",
            )
        if observation.pose is None or observation.ranges is None:
            raise PolicyError(
                "box_follower needs the sensors pose and ranges",
                remedy="run it with `gn0 bench run`, which gives a policy what it asks for",
            )
        if self._follower is None:
            camera, body = self._preset.rgb, self._preset.agent
            height, width = people.shape
            if (height, width) != (camera.height, camera.width):
                raise PolicyError(
                    f"box_follower has the camera {self._preset.name!r} of {camera.width}×"
                    f"{camera.height}, and is shown {width}×{height}: give it the suite's, "
                    f"--policy-option preset={_preset_of(width, height)}",
                    where="box_follower, preset",
                    remedy="the camera of a suite stands in its suite.json",
                )
            view = PictureView(width, height, camera.hfov, body.camera_height)
            self._follower = BoxFollower(view, body, self._gains)
        return self._follower.act(
            find_boxes(people, rgb), observation.pose, observation.time,
            observation.ranges, observation.collided,
        )  # fmt: skip


def _preset_of(width: int, height: int) -> str:
    """A following camera with pictures of that size, or a word for the suite's own."""
    for name in ("follower", "follower_small", "evt"):
        camera = find_preset(name).rgb
        if (camera.width, camera.height) == (width, height):
            return name
    return "THE_SUITE'S"
