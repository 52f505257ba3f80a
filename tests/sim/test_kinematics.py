"""Headings are exact; positions follow Eq. kinematics."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.errors import SimError
from gn0.sim.kinematics import Heading, heading_cycle, heading_yaw, step_forward

bases = st.floats(-math.pi, math.pi, exclude_max=True)


@given(bases, st.integers(-10_000, 10_000), st.sampled_from([1.0, 7.5, 10.0, 15.0, 30.0, 45.0]))
def test_full_circles_change_no_bit(base: float, turns: int, degrees: float) -> None:
    circle = round(360 / degrees)
    assert heading_yaw(base, turns, degrees) == heading_yaw(base, turns + circle, degrees)
    assert heading_yaw(base, circle, degrees) == base


@given(bases, st.integers(-500, 500), st.floats(0.1, 180.0))
def test_yaw_stays_in_range_and_means_the_sum(base: float, turns: int, degrees: float) -> None:
    yaw = heading_yaw(base, turns, degrees)
    assert -math.pi <= yaw < math.pi
    exact = base + turns * math.radians(degrees)
    assert math.cos(yaw - exact) == pytest.approx(1.0, abs=1e-9)


@given(bases, st.integers(-50, 50), st.integers(-50, 50))
def test_turns_add_up_in_any_order(base: float, a: int, b: int) -> None:
    heading = Heading(base, 0, 15.0)
    assert heading.turned(a).turned(b).yaw == heading.turned(b).turned(a).yaw
    assert heading.turned(a).turned(-a).yaw == base


@pytest.mark.parametrize(("degrees", "count"), [(15, 24), (30, 12), (7.5, 48), (50, 36), (180, 2)])
def test_a_cycle_visits_each_heading_once(degrees: float, count: int) -> None:
    cycle = heading_cycle(Heading(0.3, 5, degrees))
    assert len(cycle) == len(set(cycle)) == count
    assert cycle[0] == Heading(0.3, 5, degrees).yaw


def test_a_turn_that_never_closes_is_refused() -> None:
    with pytest.raises(SimError, match="never come full circle"):
        heading_cycle(Heading(0.0, 0, math.pi))


def test_forward_goes_along_the_heading() -> None:
    assert step_forward(1.0, 2.0, 0.0, 0.25) == (1.25, 2.0)
    x, y = step_forward(1.0, 2.0, math.pi / 2, 0.25)
    assert (x, y) == (pytest.approx(1.0), 2.25)
