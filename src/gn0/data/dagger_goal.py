"""DAgger to a goal among people: what the oracle would do at a state, six actions on.

It waits for people, goes round who stands, and steps on nobody; what people do while it does so is
played in a simulator of its own, which nobody sees.
"""

from __future__ import annotations

import copy
import dataclasses

from gn0.data.expert_labels import LabelSettings
from gn0.paper import ACTIONS_AHEAD
from gn0.plugins import build_plugin
from gn0.sim.policy import Policy
from gn0.sim.rollout import begin_episode
from gn0.sim.simulator import Simulator, action_code
from gn0.sim.state import Action

_ENDLESS = 2**31  # actions: what is thought does not end


class GoalExpert:
    """Labels one state after the other of an agent on its way among people.

    Args:
        simulator: the episode's, which has just begun; read anew at each state.
        labels: how near the goal it says STOP, and what a turn costs.

    Raises:
        PlanError: the goal cannot be reached.
    """

    def __init__(self, simulator: Simulator, labels: LabelSettings) -> None:
        self._simulator = simulator
        self._thought = Simulator(
            simulator.scene, navigation=simulator.navigation, agent=simulator.agent,
            max_steps=_ENDLESS, person_radius=simulator.company.radius,
        )  # fmt: skip
        options = {"stop_distance": labels.stop_distance, "turn_cost": labels.turn_cost}
        self._oracle: Policy = build_plugin("policy", "oracle", options)
        self._seen = begin_episode(self._thought, self._oracle, simulator.episode)
        self._first = Action.STOP

    @property
    def action(self) -> int:
        """What the expert itself does here."""
        return int(self._first)

    def actions(self) -> list[int]:
        """The label of where the agent is: six actions, or fewer up to the STOP.

        Raises:
            PlanError: the goal cannot be reached from there.
        """
        live, thought = self._simulator.save_state(), self._thought
        thought.restore_state(
            dataclasses.replace(live, wanted=frozenset(), tiles=(), explored=None, over=False)
        )
        oracle, found = self._oracle, list[int]()
        for _ in range(ACTIONS_AHEAD):
            code = action_code(oracle.act(self._seen))  # type: ignore[arg-type]
            if not found:  # what comes after is only thought
                self._first = Action(code)
                oracle = copy.deepcopy(oracle, {id(thought): thought})
            found.append(code)
            if code == Action.STOP:
                break
            thought.step(code)
        return found

    def follow(self, action: int) -> None:
        """Note what the agent does next: the oracle sees where it stands."""
