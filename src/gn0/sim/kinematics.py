"""How an action moves the agent (paper, Eq. kinematics), with headings that never drift.

A heading is a base angle plus a whole number of turns. The number of turns is what is stored, so
24 turns of 15 degrees give back the very same float, and equal headings are equal bytes.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

from gn0.errors import SimError
from gn0.geometry import Pose2D, wrap_angle
from gn0.missions.episode import AgentSpec

STILL = 1e-9  # m; a shorter move has no bearing
_WHOLE = 1e-9  # of a step or turn: rounding does not cost another one


class Heading(NamedTuple):
    """A heading: base [rad] plus `turns` times `turn_degrees`, counter-clockwise."""

    base: float
    turns: int
    turn_degrees: float

    @property
    def yaw(self) -> float:
        """The heading as an angle [rad] in −π..π."""
        return heading_yaw(self.base, self.turns, self.turn_degrees)

    def turned(self, turns: int) -> Heading:
        """The heading after more turns (positive: left)."""
        return Heading(self.base, self.turns + turns, self.turn_degrees)


def heading_yaw(base: float, turns: int, turn_degrees: float) -> float:
    """Yaw [rad] in −π..π of `base` [rad] plus whole turns of `turn_degrees`.

    The sum of turns is reduced modulo 360 degrees before it meets the base, so any two numbers
    of turns that differ by full circles give the same float.
    """
    degrees = (turns * turn_degrees) % 360.0
    if degrees == 0.0:
        return wrap_angle(base)
    if degrees >= 180.0:
        degrees -= 360.0  # exact: halves the rounding error of the conversion
    return wrap_angle(base + math.radians(degrees))


def heading_cycle(heading: Heading) -> list[float]:
    """The yaws [rad] that LEFT leads through before the first comes again, that first one first.

    Raises:
        SimError: the angle of a turn does not divide any small number of full circles.
    """
    circle = (Fraction(heading.turn_degrees).limit_denominator(10_000) / 360).denominator
    if circle > 3600 or abs((circle * heading.turn_degrees) % 360.0) > 1e-6:
        raise SimError(
            f"turns of {heading.turn_degrees} degrees never come full circle",
            remedy="choose an angle that divides 360 degrees",
        )
    return [heading.turned(k).yaw for k in range(circle)]


def step_forward(x: float, y: float, yaw: float, distance: float) -> tuple[float, float]:
    """Where FORWARD wants to end: p + Δd · (cos θ, sin θ) [m] (paper, Eq. kinematics)."""
    return x + distance * math.cos(yaw), y + distance * math.sin(yaw)


class Journey(NamedTuple):
    """A move of any length as the steps that a body takes: turn, go, turn.

    Attributes:
        bearing: direction of travel [rad].
        length: metres to go.
        before: turn to the bearing [rad, −π..π].
        after: turn at the end [rad, −π..π].
        agent: the body, whose step and turn are counted.
    """

    bearing: float
    length: float
    before: float
    after: float
    agent: AgentSpec

    @property
    def steps(self) -> int:
        """max(1, ⌈length / step⌉ + ⌈(|before| + |after|) / turn⌉)."""
        return max(1, self._strides(self.length) + self._turns(abs(self.before) + abs(self.after)))

    def steps_until(self, walked: float) -> int:
        """The same where an obstacle cuts the move after `walked` m: the last stride hits it."""
        strides = math.floor(walked / self.agent.forward_step + _WHOLE) + 1
        turns = self._turns(abs(self.before) + abs(self.after))
        return max(1, min(strides, self._strides(self.length)) + turns)

    def part(self, steps: float) -> tuple[float, float]:
        """How far it comes in fewer steps than it needs: metres gone, yaw there [rad].

        It turns to its bearing, goes as far as the steps last, and turns with what is left. Parts
        of a step are as much of a turn or a stride.
        """
        turn = math.radians(self.agent.turn_degrees)
        first = self._turns(abs(self.before))
        if steps <= first:
            turned = math.copysign(min(abs(self.before), steps * turn), self.before)
            return 0.0, wrap_angle(self.bearing - self.before + turned)
        strides = min(steps - first, self._strides(self.length))
        gone = min(self.length, strides * self.agent.forward_step)
        left = steps - first - strides
        turned = math.copysign(min(abs(self.after), left * turn), self.after)
        return gone, wrap_angle(self.bearing + turned)

    def _strides(self, length: float) -> int:
        return math.ceil(length / self.agent.forward_step - _WHOLE)

    def _turns(self, angle: float) -> int:
        return math.ceil(math.degrees(angle) / self.agent.turn_degrees - _WHOLE)


def plan_journey(pose: Pose2D, x: float, y: float, yaw: float, agent: AgentSpec) -> Journey:
    """What it takes a body to go from a pose to (x, y) [m] and look along `yaw` [rad] there."""
    length = math.hypot(x - pose.x, y - pose.y)
    if length < STILL:
        return Journey(pose.yaw, 0.0, 0.0, wrap_angle(yaw - pose.yaw), agent)
    bearing = math.atan2(y - pose.y, x - pose.x)
    before, after = wrap_angle(bearing - pose.yaw), wrap_angle(yaw - bearing)
    return Journey(bearing, length, before, after, agent)
