"""What a run recorded, walked again: a demonstration, by hand or by a policy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from gn0.bench.results import load_traces, recorded_actions
from gn0.errors import EpisodeError, PolicyError
from gn0.sim.state import Action, Observation, Teleport
from gn0.suites.run_files import digest_run

if TYPE_CHECKING:
    from gn0.sim.simulator import Simulator

SAME_START = 1e-6  # m or rad between the start of an episode and where its record begins


class PolicyRecorded:
    """Takes the actions that a run recorded, episode by episode.

    It is handed the simulator to know which episode it is, and so is named an oracle.

    Args:
        run: a run folder, of a policy or of walks by hand.
        digest: digest of its trajectories, where they must be the ones meant.

    Raises:
        StorageError, FormatError: no finished run there, or a damaged one.
        PolicyError: it is not the run of that digest.
    """

    name = "recorded"
    sensors: frozenset[str] = frozenset()

    def __init__(self, run: str, digest: str = "") -> None:
        self._run = run
        self._digest = digest_run(run)
        if digest and digest != self._digest:
            raise PolicyError(
                f"run {run} has other trajectories than those meant ({self._digest}, not {digest})",
                remedy="choose another --out, or restore the run",
            )
        self._traces = load_traces(run)
        self._said: Iterator[Action | Teleport] = iter(())

    def identity(self) -> dict[str, str]:
        """The trajectories that it walks."""
        return {"trajectories": self._digest}

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._said = iter(())

    def reset_privileged(self, simulator: Simulator) -> None:
        """Find what was recorded of the episode.

        Raises:
            EpisodeError: it was not recorded, or from another start.
        """
        name = simulator.episode.id
        trace = self._traces.get(name)
        if trace is None or not trace.actions:
            raise EpisodeError("the run has no walk of it", where=f"episode {name!r}")
        apart = np.abs(np.subtract(trace.poses[0], simulator.pose)) if trace.poses else np.ones(1)
        if not (apart <= SAME_START).all():
            raise EpisodeError(
                "the run recorded it from another start",
                where=f"episode {name!r}",
                remedy="give the suite that was run",
            )
        self._said = recorded_actions(trace)

    def act(self, observation: Observation) -> Action | Teleport:
        """The next recorded action.

        Raises:
            PolicyError: there is none, yet the episode goes on.
        """
        action = next(self._said, None)
        if action is None:
            raise PolicyError(
                f"run {self._run}: the episode goes on after its last recorded action",
                remedy="give the suite that was run, with its own --max-steps",
            )
        return action
