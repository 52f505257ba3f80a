"""`box_follower`: follows a person's box with two controllers, and looks for it when it is lost.

The controllers are proportional and derivative, one on the bearing and one on the distance. It
knows no map and no track: a baseline that a learned policy should beat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gn0.errors import PolicyError
from gn0.geometry import wrap_angle
from gn0.missions.episode import AgentSpec
from gn0.policies.person_boxes import PersonBox, PictureView, find_boxes
from gn0.sim.presets import find_preset
from gn0.sim.state import Action, Observation

TALL = 1.70  # m: how tall somebody is of whom no head and feet were seen at once
FRESH = 1.0  # s after the last sight in which somebody must be near where it was
STRANGE = 4.0  # of `unlikeness`: a box beyond it is somebody else
LEARN = 0.1  # share of a look or a height that is new
ROOM, AHEAD = 0.45, 35.0  # m, degrees: who is nearer ahead of its next step is let pass
PATIENCE = 10  # steps that it waits for them, then it goes round
GIVE_UP = 24  # turns that are looked round after a loss, a circle


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

    distance: float = 1.5
    turn: float = 1.0
    turn_rate: float = 0.15
    move: float = 1.0
    move_rate: float = 0.25
    far: float = 1.0
    ahead: float = 22.0


@dataclass(frozen=True)
class Sighting:
    """The person as it was last seen, in the agent's frame of now.

    Attributes:
        bearing, distance: [rad, left positive; m].
        look: of its clothes, averaged.
        tall: [m].
        age: seconds since.
        turning: rate of its bearing [rad/s] then.
        leaving: rate of its distance [m/s] then.
    """

    bearing: float
    distance: float
    look: tuple[float, ...]
    tall: float = TALL
    age: float = 0.0
    turning: float = 0.0
    leaving: float = 0.0

    def after(self, action: Action, moved: bool, agent: AgentSpec) -> Sighting:
        """The same place after an action of the agent's own, from where it then is."""
        x = self.distance * math.cos(self.bearing)
        y = self.distance * math.sin(self.bearing)
        x -= agent.forward_step if action == Action.FORWARD and moved else 0.0
        turns = (action == Action.LEFT) - (action == Action.RIGHT)
        return Sighting(
            wrap_angle(math.atan2(y, x) - turns * math.radians(agent.turn_degrees)),
            math.hypot(x, y), self.look, self.tall, self.age + agent.step_seconds,
            self.turning, self.leaving,
        )  # fmt: skip


def unlikeness(box: PersonBox, view: PictureView, last: Sighting) -> float:
    """How little a box is like the person last seen: by colours, and by place while it is fresh."""
    colours = math.dist(box.look, last.look) / 45.0
    if last.age > FRESH:
        return colours * 2.0
    off = abs(wrap_angle(view.bearing(box) - last.bearing)) / math.radians(12.0)
    away = abs(math.log(max(view.distance(box, last.tall), 0.1) / max(last.distance, 0.1))) / 0.5
    return colours + off + away


def choose_box(
    boxes: Sequence[PersonBox], view: PictureView, last: Sighting | None
) -> PersonBox | None:
    """The box of the person: before any sight the one nearest ahead, then the likest of all."""
    if not boxes:
        return None
    if last is None:
        return min(boxes, key=lambda b: abs(view.bearing(b)) + 0.1 * view.distance(b, TALL))
    best = min(boxes, key=lambda b: unlikeness(b, view, last))
    return best if unlikeness(best, view, last) <= STRANGE else None


def sight(box: PersonBox, view: PictureView, last: Sighting | None, seconds: float) -> Sighting:
    """The sighting that a box gives; `last` is the one before it, from where the agent is now."""
    tall = TALL if last is None else last.tall
    seen = view.tall(box)
    if seen is not None and 1.2 <= seen <= 2.2:
        tall = seen if last is None else tall + LEARN * (seen - tall)
    bearing, distance = view.bearing(box), view.distance(box, tall)
    if last is None or last.age > 2 * seconds:
        return Sighting(bearing, distance, box.look, tall)
    look = tuple(a + LEARN * (b - a) for a, b in zip(last.look, box.look, strict=True))
    return Sighting(
        bearing, distance, look, tall,
        turning=wrap_angle(bearing - last.bearing) / seconds,
        leaving=(distance - last.distance) / seconds,
    )  # fmt: skip


def steer(seen: Sighting, gains: BoxGains, agent: AgentSpec) -> Action:
    """What the two controllers do: turn first, walk, or stand (STOP).

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

    After a loss it walks to where the person was last, then turns round to the side on which it
    went; after a circle it stands. A bump makes it turn aside and take two steps.

    Args:
        view: the camera.
        agent: the body.
        gains: of the controllers.
    """

    def __init__(self, view: PictureView, agent: AgentSpec, gains: BoxGains | None = None) -> None:
        self.view, self.agent, self.gains = view, agent, gains or BoxGains()
        self.last: Sighting | None = None
        self._action = Action.STOP
        self._queue: list[Action] = []
        self._turned = 0
        self._bumps = 0
        self._waited = 0
        self._side = Action.LEFT  # to which the person was last going

    def act(self, boxes: Sequence[PersonBox], collided: bool) -> Action:
        """The next action, from a picture's boxes and whether the last move was cut short."""
        if self.last is not None:
            self.last = self.last.after(self._action, not collided, self.agent)
        box = choose_box(boxes, self.view, self.last)
        bumped = collided and self._action == Action.FORWARD
        if box is not None:
            self.last = sight(box, self.view, self.last, self.agent.step_seconds)
            self._turned = 0
            going = self.last.bearing + self.last.turning * FRESH / 2
            self._side = Action.LEFT if going >= 0 else Action.RIGHT
        if bumped:
            self._queue = self._aside()
        if self._queue:
            action = self._queue.pop(0)
        elif box is not None and self.last is not None:
            action = steer(self.last, self.gains, self.agent)
            self._bumps = 0 if action == Action.FORWARD and not collided else self._bumps
        else:
            action = self._search()
        if action == Action.FORWARD and any(self._in_the_way(other) for other in boxes):
            self._waited += 1
            action = Action.STOP
            if self._waited >= PATIENCE:  # they stand there: round them
                self._queue, self._waited = self._aside(), 0
        elif action == Action.FORWARD:
            self._waited = 0
        self._action = action
        return action

    def _in_the_way(self, box: PersonBox) -> bool:
        """Whether somebody stands so near ahead that a step could touch."""
        tall = TALL if self.last is None else self.last.tall
        near = self.view.distance(box, tall) < self.agent.radius + self.agent.forward_step + ROOM
        return near and abs(self.view.bearing(box)) < math.radians(AHEAD)

    def _aside(self) -> list[Action]:
        """Away from the side of the person first, as a corner stands there; then the other side."""
        bearing = 0.0 if self.last is None else self.last.bearing
        away = Action.RIGHT if bearing > 0 else Action.LEFT
        back = Action.LEFT if away == Action.RIGHT else Action.RIGHT
        self._bumps += 1
        side = away if self._bumps % 2 else back
        return [side] * min(2 + self._bumps, 8) + [Action.FORWARD] * 2

    def _search(self) -> Action:
        last = self.last
        if last is None or self._turned >= GIVE_UP:
            return Action.STOP
        if self._turned == 0 and last.distance > self.agent.forward_step * 2:
            if abs(last.bearing) > math.radians(self.agent.turn_degrees) / 2:
                return Action.LEFT if last.bearing > 0 else Action.RIGHT
            return Action.FORWARD
        self._turned += 1
        return self._side


class PolicyBoxFollower:
    """Follows the person who is nearest ahead in the first view, by boxes of the person picture.

    It is given boxes and colours, and no numbers of people: who looks like the one that it follows
    can lead it astray.

    Args:
        preset: the camera and the body, by name.
        distance: to keep [m].
    """

    name = "box_follower"
    sensors: frozenset[str] = frozenset({"rgb", "who"})

    def __init__(self, preset: str = "follower", distance: float = BoxGains.distance) -> None:
        self._preset = find_preset(preset)
        self._gains = BoxGains(distance=distance)
        self._follower: BoxFollower | None = None

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._follower = None

    def act(self, observation: Observation) -> Action:
        """Keep the box ahead and at its distance.

        Raises:
            PolicyError: no person picture, one of another size than the colour picture, or one of
                another camera than its own.
        """
        people, rgb = observation.read("who"), observation.rgb
        if people is None or rgb is None or people.shape != rgb.shape[:2]:
            raise PolicyError(
                "box_follower needs a person picture of the size of the colour picture",
                remedy="give the suite a camera whose two pictures are of one size",
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
        return self._follower.act(find_boxes(people, rgb), observation.collided)


def _preset_of(width: int, height: int) -> str:
    """A following camera with pictures of that size, or a word for the suite's own."""
    for name in ("follower", "follower_small", "evt"):
        camera = find_preset(name).rgb
        if (camera.width, camera.height) == (width, height):
            return name
    return "THE_SUITE'S"
