"""Noise of a real robot's depth camera, odometry and wheels; none by default.

    noise = Noise(depth=1.0, pose=PoseNoise(place=0.02), actuation=find_actuation("locobot"))
    simulator = open_simulator(scene, sensors={"depth", "pose"}, noise=noise)

It belongs to one body, and to episode and step alone (`gn0.seeds`): the same seeds, the same noise,
whoever else is there and however the walk was resumed. What it is drawn from:

* depth: the Redwood model as habitat-sim has it (0586bec, redwood_depth_noise_model.py), but for
  the table of one camera's lens: pixels that jitter, every second one read, inverse depth with
  noise in steps of an eighth, nothing from 10 m on, which reads 0;
* pose: normal noise at each step, and a drift that grows with the steps;
* actuation: LoCoBot's table as habitat-sim has it (pyrobot_noisy_controls.py), cut at three sigma.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from gn0.config import Config
from gn0.errors import ConfigError
from gn0.geometry import F32, Pose2D, wrap_angle
from gn0.sim.sensor.sensor import Here, Sensor

BASELINE = 35.130  # focal length by baseline of the depth camera
INVERSE_SIGMA = 0.027778  # of inverse depth by BASELINE
INVERSE_STEPS = 8.0
JITTER = 0.25  # px
DEPTH_FAR = 10.0  # m
CUT = 3.0  # sigmas
LEAST = 0.95  # share of a commanded move that noise may take back


class Spread(Config, frozen=True):
    """A normal distribution, cut at three sigma: mean and variance, in metres or radians."""

    mean: float = 0.0
    variance: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mean) and 0 <= self.variance < math.inf):
            raise ConfigError(
                f"noise of mean {self.mean} and variance {self.variance}",
                remedy="give numbers, the variance 0 or more",
            )

    def draw(self, share: float, low: float = -math.inf) -> float:
        """The value below which this share of the distribution above `low` lies."""
        sigma = math.sqrt(self.variance)
        if sigma == 0.0:
            return max(self.mean, low)
        from scipy.special import ndtr, ndtri  # only where there is noise

        least = float(ndtr(max((low - self.mean) / sigma, -CUT)))
        most = float(ndtr(CUT))
        return self.mean + sigma * float(ndtri(least + share * (most - least)))


class MoveNoise(Config, frozen=True):
    """What one kind of command adds.

    Attributes:
        along: ahead [m].
        across: to the right [m].
        turn: to the left [rad]; of a turn, further to its own side.
    """

    along: Spread
    across: Spread
    turn: Spread


class ActuationNoise(Config, frozen=True):
    """The noise that a body's wheels add to commands.

    Attributes:
        forward, turn: to FORWARD, and to LEFT and RIGHT.
        multiplier: of all of it; 0 for none.
    """

    forward: MoveNoise
    turn: MoveNoise
    multiplier: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.multiplier < math.inf:
            raise ConfigError(f"noise times {self.multiplier}", remedy="give 0 or more")


class PoseNoise(Config, frozen=True):
    """The errors of odometry.

    Attributes:
        place: sigma of x and y at each step [m].
        heading: sigma of yaw at each step [rad].
        drift_place: sigma of what each step adds to x and y for good [m].
        drift_heading: sigma of what each step adds to yaw for good [rad].
    """

    place: float = 0.0
    heading: float = 0.0
    drift_place: float = 0.0
    drift_heading: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            if not 0 <= getattr(self, name) < math.inf:
                raise ConfigError(
                    f"pose noise {name} is {getattr(self, name)}", remedy="give 0 or more"
                )


class Noise(Config, frozen=True):
    """The noise of one body.

    Attributes:
        depth: multiplier of the depth camera's; 0 for none.
        pose: noise of the sensor `pose`.
        actuation: noise of FORWARD, LEFT and RIGHT.
    """

    depth: float = 0.0
    pose: PoseNoise = PoseNoise()
    actuation: ActuationNoise | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.depth < math.inf:
            raise ConfigError(f"depth noise times {self.depth}", remedy="give 0 or more")

    @property
    def moves(self) -> bool:
        """Whether moves are noisy."""
        return self.actuation is not None and self.actuation.multiplier > 0

    def wrap(self, sensor: Sensor, depth_range: tuple[float, float]) -> Sensor:
        """The sensor with its noise, depth within its range [m]; itself where it has none."""
        if sensor.name == "depth" and self.depth:
            low, high = map(np.float32, depth_range)
            return _with_noise(
                sensor, lambda depth, here: np.clip(self._blur(depth, here), low, high)
            )
        if sensor.name == "pose" and self.pose != PoseNoise():
            return _with_noise(sensor, self._shift)
        return sensor

    def _blur(self, depth: F32, here: Here) -> F32:
        return blur_depth(depth, self.depth, here.random("depth noise"))

    def _shift(self, pose: Pose2D, here: Here) -> Pose2D:
        noise = self.pose
        off = here.random("pose noise").normal(size=3) * (noise.place, noise.place, noise.heading)
        if here.steps and (noise.drift_place or noise.drift_heading):
            each = here.random_walk("pose drift").normal(size=(here.steps, 3)).sum(axis=0)
            off += each * (noise.drift_place, noise.drift_place, noise.drift_heading)
        x, y, yaw = off.tolist()
        return Pose2D(pose.x + x, pose.y + y, wrap_angle(pose.yaw + yaw))


class Move(NamedTuple):
    """What noise makes of a command: ahead, left [m] and turn [rad], left positive."""

    forward: float
    left: float
    turn: float


def sample_move(
    noise: ActuationNoise, forward: float, turn: float, rng: np.random.Generator
) -> Move:
    """The move that comes of going `forward` [m] or turning [rad], one of them 0."""
    kind = noise.turn if turn else noise.forward
    along, across, swing = rng.random(3).tolist()
    times = noise.multiplier
    ahead = kind.along.draw(along, -math.inf if turn else -LEAST * abs(forward)) * times
    aside = kind.across.draw(across) * times
    more = kind.turn.draw(swing, -LEAST * abs(turn) if turn else -math.inf) * times
    return Move(forward + ahead, -aside, turn + (-more if turn < 0 else more))


def blur_depth(depth: F32, multiplier: float, rng: np.random.Generator) -> F32:
    """Depth [H, W] m as a real camera gives it; 0 where it sees nothing."""
    height, width = depth.shape
    chance = rng.standard_normal((3, height, width), np.float32)
    rows = np.arange(height, dtype=np.float32)[:, None] + chance[0] * (JITTER * multiplier)
    cols = np.arange(width, dtype=np.float32)[None, :] + chance[1] * (JITTER * multiplier)
    y = (rows.clip(0, height - 1) + 0.5).astype(np.int64)
    x = (cols.clip(0, width - 1) + 0.5).astype(np.int64)
    seen = depth[y - y % 2, x - x % 2].astype(np.float64)
    with np.errstate(divide="ignore"):
        inverse = np.where(seen > 0, BASELINE / seen, 0.0)
    steps = np.rint((inverse + chance[2] * (INVERSE_SIGMA * multiplier)) * INVERSE_STEPS)
    steps[(seen >= DEPTH_FAR) | (seen <= 0)] = 0
    with np.errstate(divide="ignore"):
        found = np.where(steps > 0, BASELINE * INVERSE_STEPS / steps, 0.0)
    return found.astype(np.float32)


def _with_noise(sensor: Sensor, disturb: Callable[[Any, Here], Any]) -> Sensor:
    """A sensor that reads the same, disturbed: one agent at a time, on no device."""

    def read(here: Here) -> Any:
        value: Any = disturb(sensor.read(here), here)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        return value

    return replace(sensor, read=read, many=None, device=None)


def _row(*numbers: float) -> MoveNoise:
    """Means of along, across, turn, then their variances."""
    return MoveNoise(
        along=Spread(mean=numbers[0], variance=numbers[3]),
        across=Spread(mean=numbers[1], variance=numbers[4]),
        turn=Spread(mean=numbers[2], variance=numbers[5]),
    )


# habitat-sim 0586bec, habitat_sim/agent/controls/pyrobot_noisy_controls.py, lines 102 to 157:
# FORWARD, then LEFT and RIGHT
_TABLE = {
    ("locobot", "ilqr"): (
        _row(0.014, 0.009, 0.008, 0.006, 0.005, 0.004),
        _row(0.003, 0.003, 0.023, 0.002, 0.003, 0.012),
    ),
    ("locobot", "proportional"): (
        _row(0.017, 0.042, 0.031, 0.007, 0.023, 0.026),
        _row(0.001, 0.005, 0.043, 0.001, 0.004, 0.017),
    ),
    ("locobot", "movebase"): (
        _row(0.074, 0.036, 0.189, 0.019, 0.033, 0.038),
        _row(0.002, 0.003, 0.219, 0.0, 0.002, 0.019),
    ),
    ("locobot-lite", "ilqr"): (
        _row(0.142, 0.023, 0.031, 0.008, 0.008, 0.028),
        _row(0.002, 0.002, 0.122, 0.001, 0.002, 0.03),
    ),
    ("locobot-lite", "proportional"): (
        _row(0.135, 0.043, 0.049, 0.007, 0.009, 0.009),
        _row(0.002, 0.002, 0.054, 0.002, 0.001, 0.061),
    ),
    ("locobot-lite", "movebase"): (
        _row(0.192, 0.117, 0.128, 0.055, 0.144, 0.143),
        _row(0.002, 0.001, 0.173, 0.001, 0.001, 0.025),
    ),
}


def find_actuation(
    robot: str = "locobot", controller: str = "ilqr", multiplier: float = 1.0
) -> ActuationNoise:
    """The actuation noise of a robot (locobot, locobot-lite) under a controller.

    Raises:
        ConfigError: there are no numbers of that robot, or controller (ilqr, proportional,
            movebase).
    """
    try:
        forward, turn = _TABLE[robot.lower(), controller.lower()]
    except (KeyError, AttributeError):
        known = ", ".join(" ".join(names) for names in _TABLE)
        raise ConfigError(
            f"no actuation noise of {robot!r} under {controller!r}", remedy=f"known: {known}"
        ) from None
    return ActuationNoise(forward=forward, turn=turn, multiplier=multiplier)
