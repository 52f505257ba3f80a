"""A move cut into ticks: where the agent is while somebody else moves, and at which tick it stops.

People move in ticks of 0.1 s within an action, and so does the agent among them. The map's rule
(`gn0.sim.collision`) is asked of the way from the action's start each time, never of one tick after
another: the last tick is the uncut move itself, with the same bits, and every place before it is
one that the rule allows, also of a body that slides. Only + − × / decide, so that kernels can say
the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from gn0.errors import SimError
from gn0.sim.collision import Move, move_agent
from gn0.sim.kinematics import Journey

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap
    from gn0.missions.episode import AgentSpec

Places = tuple[tuple[float, float], ...]
Touches = Callable[[int, float, float], bool]


def cut_move(x0: float, y0: float, x1: float, y1: float, ticks: int) -> Places:
    """Where a move wants to be after each of its ticks, the end exactly.

    Args:
        x0: where it begins, x [m].
        y0: the same, y [m].
        x1: where it is to end, x [m].
        y1: the same, y [m].
        ticks: how many it takes.

    Raises:
        SimError: fewer than one tick.
    """
    if ticks < 1:
        raise SimError(f"a move of {ticks} ticks", remedy="give the ticks of an action or more")
    dx, dy = x1 - x0, y1 - y0
    before = ((x0 + dx * (k / ticks), y0 + dy * (k / ticks)) for k in range(1, ticks))
    return (*before, (x1, y1))


def cut_journey(journey: Journey, x0: float, y0: float, x1: float, y1: float) -> Places:
    """The same of a move that lasts several actions: it turns, goes, and turns again.

    Args:
        journey: the move.
        x0: where it begins, x [m].
        y0: the same, y [m].
        x1: where it is to end, x [m].
        y1: the same, y [m].
    """
    dx, dy, whole = x1 - x0, y1 - y0, journey.length
    places = []
    for tick in range(1, journey.steps * journey.agent.step_ticks):
        gone, _ = journey.part(tick / journey.agent.step_ticks)
        share = gone / whole if gone < whole else 1.0
        places.append((x1, y1) if share == 1.0 else (x0 + dx * share, y0 + dy * share))
    return (*places, (x1, y1))


def move_in_ticks(
    navigation: NavigationMap,
    x0: float,
    y0: float,
    places: Sequence[tuple[float, float]],
    agent: AgentSpec | None = None,
    touches: Touches | None = None,
) -> Move:
    """Go from (x0, y0) [m] through the ticks of a move, and stop before the one that would touch.

    With nobody in the way this is `move_agent` to the last place, bit for bit.

    Args:
        navigation: the map of the agent's radius.
        x0: where the action began, x [m].
        y0: the same, y [m].
        places: where the agent wants to be after each tick [(x, y) m], see `cut_move`.
        agent: the body; it slides if that does.
        touches: whether the agent would touch somebody after tick k (from 1) at (x, y) [m]; None
            where there is nobody.

    Returns:
        Where it ended: after the last tick, or after the one before it would touch, which is a
        collision.
    """
    whole = move_agent(navigation, x0, y0, *places[-1], agent)
    if touches is None:
        return whole
    last = Move(x0, y0, 0.0, False)
    for tick, (x, y) in enumerate(places, 1):
        now = whole if tick == len(places) else move_agent(navigation, x0, y0, x, y, agent)
        if touches(tick, now.x, now.y):
            return last._replace(collided=True)
        last = now
    return whole
