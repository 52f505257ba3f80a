"""Continuous actions: a Displacement that the body can do in one step, or STOP.

An action is (forward, left, turn, stop), each −1..1; values outside are cut to that. The first
three are a `Displacement` in units of what the body does in one step: `forward_step` metres ahead
and to the left, `turn_degrees` to the left (0.25 m and 15° for most bodies). What it does of it is
exactly one step of `gn0.sim.kinematics.Journey`, so `max_steps`, rewards and collision rates
mean what they mean for discrete actions. Such a body goes or turns in a step, and never sideways:

* stop > 0.5: it says STOP;
* else forward is the largest: it goes `forward` steps straight ahead (under 1 cm: none);
* else turn or left is: it turns by that share of a turn, for `left` towards that side.

Largest means forward ≥ |turn| and forward ≥ |left|, then |turn| ≥ |left|; nobody goes backwards.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gn0.errors import ConfigError, SimError
from gn0.geometry import F64
from gn0.missions.episode import AgentSpec
from gn0.sim.state import Action, Displacement

SIZE = 4  # forward, left, turn, stop
STOP_ABOVE = 0.5
SHORTEST_STRIDE = 0.01  # m; of a shorter one rounding would make a bearing
STAND, STRIDE, TURN, STOP = range(4)


def build_action_space(name: str) -> spaces.Space[Any]:
    """The action space of one agent by name: `discrete` or `continuous`.

    Raises:
        ConfigError: there is no such action space.
    """
    if name == "discrete":
        return spaces.Discrete(4)
    if name == "continuous":
        return spaces.Box(-1.0, 1.0, (SIZE,), np.float32)
    raise ConfigError(
        f"no action space {name!r}", remedy="give action_space='discrete' or 'continuous'"
    )


def read_actions(actions: Any, count: int, agent: AgentSpec) -> tuple[NDArray[np.int64], F64]:
    """What each agent does: STAND, STRIDE, TURN or STOP [N], and by how much [N] (m or rad).

    Raises:
        SimError: another shape than [N, 4], no numbers, or NaN or infinity among them.
    """
    try:
        given = np.asarray(actions)
    except ValueError:  # ragged
        given = np.empty(0)
    if given.shape != (count, SIZE) or given.dtype.kind not in "iuf":
        raise SimError(
            f"actions are {given.dtype} {given.shape}",
            remedy=f"give {count} rows of {SIZE} numbers: forward, left, turn, stop",
        )
    bad = np.flatnonzero(~np.isfinite(given).all(axis=1))
    if len(bad):
        raise SimError(
            f"action {given[bad[0]].tolist()} holds NaN or infinity",
            where=f"agent {int(bad[0])}",
            remedy="give finite numbers in -1..1",
        )
    forward, left, turn, stop = np.clip(given.astype(np.float64), -1.0, 1.0).T
    going = (forward >= np.abs(left)) & (forward >= np.abs(turn))
    length = forward * agent.forward_step
    angle = np.where(np.abs(turn) >= np.abs(left), turn, left) * math.radians(agent.turn_degrees)
    codes = np.where(going, np.where(length >= SHORTEST_STRIDE, STRIDE, STAND), TURN)
    codes[stop > STOP_ABOVE] = STOP
    return codes, np.where(codes == STRIDE, length, np.where(codes == TURN, angle, 0.0))


def read_action(action: Any, agent: AgentSpec) -> Action | Displacement:
    """One continuous action as what a `Simulator` understands.

    Raises:
        SimError: not four finite numbers.
    """
    codes, amounts = read_actions(np.asarray(action)[None], 1, agent)
    code, amount = int(codes[0]), float(amounts[0])
    if code == STOP:
        return Action.STOP
    return Displacement(amount if code == STRIDE else 0.0, 0.0, amount if code == TURN else 0.0)
