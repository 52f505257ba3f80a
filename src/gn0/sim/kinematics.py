"""How an action moves the agent (paper, Eq. kinematics), with headings that never drift.

A heading is a base angle plus a whole number of turns. The number of turns is what is stored, so
24 turns of 15 degrees give back the very same float, and equal headings are equal bytes.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

from gn0.errors import SimError
from gn0.geometry import wrap_angle


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
