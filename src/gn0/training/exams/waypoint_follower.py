"""Actions along the waypoints of many agents' answers; `waypoint_plan.plan_along` on a card.

Before an agent there is open ground, so the poses that its next six actions can lead to are the
same 239 sequences for everybody: all are priced at once, instead of searched agent by agent.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gn0.maps.lattice import LatticeCosts
from gn0.paper import ACTIONS_AHEAD, FORWARD, FORWARD_STEP, LEFT, RIGHT, STOP, TURN_DEGREES
from gn0.policies.bae.waypoint_plan import ROUNDABOUT, STOP_DISTANCE

LOOK_AHEAD = 0.5  # m along the way: what the last pose should face
BEYOND = 0.5  # m of the way behind what can be reached: so far it is looked at
AT_ONCE = 1024  # agents: what is priced at a time takes some 500 MB


class WaypointFollower:
    """Plans six actions along waypoints.

    Args:
        device: of the waypoints.
        costs: of a plan.
    """

    def __init__(self, device: torch.device | str, costs: LatticeCosts | None = None) -> None:
        self.costs, self._turn = costs or LatticeCosts(), math.radians(TURN_DEGREES)
        actions = np.array([
            one for one in itertools.product((FORWARD, LEFT, RIGHT), repeat=ACTIONS_AHEAD)
            if all(a + b != LEFT + RIGHT or a == b for a, b in itertools.pairwise(one))
        ])  # fmt: skip
        left, right = actions == LEFT, actions == RIGHT
        yaw = np.cumsum((left.astype(int) - right) * self._turn, 1)
        ahead = (actions == FORWARD) * FORWARD_STEP
        places = np.cumsum(np.stack([ahead * np.cos(yaw), ahead * np.sin(yaw)], -1), 1)
        self._actions = torch.from_numpy(actions).to(device)
        self._places = torch.from_numpy(places).float().to(device)  # [S, 6, 2]
        self._yaw = torch.from_numpy(yaw[:, -1]).float().to(device)
        cost = self.costs.step + self.costs.turn * (actions != FORWARD)
        self._each = torch.from_numpy(cost).float().to(device)

    def plan(self, waypoints: Tensor) -> Tensor:
        """Actions int64 [N, 6] along waypoints [N, K, 2] m of each agent's frame.

        STOP stands from the end of a way on. Waits for nothing.
        """
        return torch.cat([self._plan(some) for some in waypoints.float().split(AT_ONCE)])

    def _plan(self, waypoints: Tensor) -> Tensor:
        own, way = self.costs, _Way(waypoints)
        arc, off = way.project(self._places.flatten(0, 1))
        arc, off = (one.view(len(waypoints), *self._actions.shape) for one in (arc, off))
        gone = torch.linalg.vector_norm(self._places - waypoints[:, None, None, -1], dim=-1)
        landed = (gone <= STOP_DISTANCE) & (self._actions == FORWARD)
        over = landed.cumsum(-1) > landed  # who has landed does nothing more
        back = functional.pad(arc, (1, 0))[..., :-1] - arc
        cost = self._each + own.lateral * (off - own.slack).clamp(min=0) ** 2
        cost = (cost + own.backward * back.clamp(min=0) ** 2).masked_fill(over, 0).sum(-1)
        rest = own.remaining * (way.length - arc[..., -1])
        rest = rest + own.heading * self._turn_away(way.at(arc[..., -1] + LOOK_AHEAD))
        best = (cost + rest.masked_fill(landed.any(-1), 0)).argmin(1)
        stopped = over[torch.arange(len(best), device=best.device), best]
        near = torch.linalg.vector_norm(waypoints[:, -1], dim=-1) <= STOP_DISTANCE
        there = near & (way.length[:, 0] <= ROUNDABOUT * STOP_DISTANCE)
        return self._actions[best].masked_fill(stopped | there[:, None], STOP)

    def _turn_away(self, seen: Tensor) -> Tensor:
        """Turns [N, S] that the last poses would need to face places [N, S, 2]."""
        way = seen - self._places[:, -1]
        error = torch.atan2(way[..., 1], way[..., 0]) - self._yaw
        error = torch.remainder(error + math.pi, 2 * math.pi) - math.pi
        return (error.abs() - self._turn / 2).clamp(min=0) / self._turn


class _Way:
    """Ways from the agents on: legs [N, K, 2] m that begin at arcs [N, K] m, of a length [N, 1]."""

    def __init__(self, points: Tensor) -> None:
        self.begins = functional.pad(points, (0, 0, 1, 0))[:, :-1]
        self.legs = points - self.begins
        self.sizes = torch.linalg.vector_norm(self.legs, dim=-1)
        ends = self.sizes.cumsum(1)
        self.arcs, self.length = functional.pad(ends, (1, 0))[:, :-1].contiguous(), ends[:, -1:]

    def project(self, places: Tensor) -> tuple[Tensor, Tensor]:
        """Arc and distance [N, P] of the nearest points that can be reached of places [P, 2]."""
        apart = places[:, None] - self.begins[:, None]
        share = (apart * self.legs[:, None]).sum(-1) / self.sizes.clamp(min=1e-6)[:, None] ** 2
        share = share.clamp(0, 1)
        off = torch.linalg.vector_norm(apart - share[..., None] * self.legs[:, None], dim=-1)
        far = self.arcs >= ACTIONS_AHEAD * FORWARD_STEP + BEYOND
        far[:, 0] = False
        least, leg = off.masked_fill(far[:, None], torch.inf).min(-1)
        share = share.gather(2, leg[..., None])[..., 0]
        return self.arcs.gather(1, leg) + share * self.sizes.gather(1, leg), least

    def at(self, arc: Tensor) -> Tensor:
        """The points [N, S, 2] at arcs [N, S]; the end behind it."""
        leg = (torch.searchsorted(self.arcs, arc.contiguous()) - 1).clamp(min=0)
        share = (arc - self.arcs.gather(1, leg)) / self.sizes.gather(1, leg).clamp(min=1e-6)
        pair, share = leg[..., None].expand(-1, -1, 2), share.clamp(0, 1)[..., None]
        return self.begins.gather(1, pair) + share * self.legs.gather(1, pair)
