"""Many episodes at once: a batch policy and a `VectorEnv`, the trajectories of one at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gn0.errors import PolicyError, SimError
from gn0.geometry import Pose2D
from gn0.missions.episode import Episode
from gn0.progress import Progress, no_progress
from gn0.seeds import random_stream
from gn0.sim.policy import PolicyBatch, check_answers
from gn0.sim.sensor.table import carry_sensors
from gn0.sim.simulator import action_code
from gn0.sim.standpoint import Standpoint
from gn0.sim.state import (
    OBSERVED,
    STEP_SECONDS,
    Displacement,
    Observation,
    Teleport,
    Trajectory,
)
from gn0.sim.vector import VectorEnv

_WAIT = 2  # LEFT: what agents without an episode do, unseen


@dataclass
class _Record:
    """An episode in progress: its place in the list, and what has happened in it."""

    index: int
    episode: Episode
    poses: list[Pose2D]
    actions: list[int] = field(default_factory=list)
    collided: list[bool] = field(default_factory=list)


def run_episodes(
    vector: VectorEnv,
    policy: PolicyBatch,
    episodes: Sequence[Episode],
    *,
    progress: Progress = no_progress,
) -> list[Trajectory]:
    """Let a batch policy act until every episode has ended; trajectories in the order given.

    Agent i is slot i of the policy; whoever is done takes the next episode. Each trajectory is
    the one that `run_episode` makes of that episode alone. Afterwards the environment must be
    reset.

    Raises:
        PolicyError: the policy wants a sensor that is not carried, or returns no local action.
        EpisodeError: see `Simulator.reset`.
    """
    wanted = frozenset(policy.sensors)
    if wanted - vector.sensors:
        raise PolicyError(
            f"policy {policy.name!r} reads {sorted(wanted - vector.sensors)}, which the agents do "
            "not carry",
            remedy="open the VectorEnv with sensors=policy.sensors",
        )
    if not episodes:
        return []
    batch = vector.claim()
    numbers = batch.table.add(episodes)
    everyone = np.arange(batch.count)
    batch.place(everyone, numbers[everyone % len(episodes)])
    done: list[Trajectory | None] = [None] * len(episodes)
    waiting = iter(range(len(episodes)))
    records: dict[int, _Record] = {}
    finished = 0

    def begin(slots: Sequence[int]) -> None:
        """Give these agents the next episodes."""
        fresh = []
        for slot, index in zip(slots, waiting, strict=False):
            records[slot] = _Record(index, episodes[index], [])
            fresh.append(slot)
        if not fresh:
            return
        batch.place(np.array(fresh), numbers[[records[slot].index for slot in fresh]])
        for slot, pose in zip(fresh, batch.poses(np.array(fresh)).tolist(), strict=True):
            records[slot].poses.append(Pose2D(*pose))
        begun = [records[slot].episode for slot in fresh]
        policy.reset_batch(
            fresh,
            [episode.instruction for episode in begun],
            [random_stream(e.seed, "policy", policy.name, e.id) for e in begun],
        )

    begin(range(batch.count))
    while records:
        slots = sorted(records)
        seen = _observe(vector, np.array(slots), wanted)
        answers = check_answers(policy.name, policy.act_batch(slots, seen), len(slots))
        actions = np.full(batch.count, _WAIT)
        for slot, answer in zip(slots, answers, strict=True):
            actions[slot] = _code(policy.name, answer, records[slot])
        _, stopped, truncated = batch.step(actions)
        poses = batch.poses(np.array(slots)).tolist()
        free = []
        for slot, pose in zip(slots, poses, strict=True):
            record = records[slot]
            record.poses.append(Pose2D(*pose))
            record.actions.append(int(actions[slot]))
            record.collided.append(bool(batch.state.collided[slot]))
            if stopped[slot] or truncated[slot]:
                done[record.index] = Trajectory(
                    tuple(record.poses),
                    tuple(record.actions),
                    tuple(record.collided),
                    bool(stopped[slot]),
                )
                del records[slot]
                free.append(slot)
                finished += 1
                progress("episodes", finished, len(episodes))
        begin(free)
    return [trajectory for trajectory in done if trajectory is not None]


def _code(name: str, action: Any, record: _Record) -> int:
    try:
        if isinstance(action, Teleport | Displacement):
            raise SimError(
                "many agents at once take local actions only",
                remedy="run this policy with run_episode",
            )
        return action_code(action)
    except SimError as error:
        raise PolicyError(
            f"policy {name!r} returned no valid action: {error.what}",
            where=f"episode {record.episode.id!r}, step {len(record.actions)}",
            remedy=error.remedy,
        ) from error


def _observe(
    vector: VectorEnv, which: np.ndarray[Any, np.dtype[np.int64]], wanted: frozenset[str]
) -> list[Observation]:
    """What agents `which` see, each as a `Simulator` of its own would say it."""
    batch = vector.batch
    spelt = [s for s in carry_sensors(wanted).sensors if s.array is not None]
    found = batch.observe(which)
    snapshot = batch.snapshot(which)
    if snapshot is not None:
        found |= batch.draw([snapshot])[0]
    scale, maps = found.pop("bev_metres_per_pixel", None), carry_sensors(wanted).maps
    observations = []
    for k, agent in enumerate(which.tolist()):
        fields = {name: values[k] for name, values in found.items() if name in wanted}
        for value in fields.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        steps = int(batch.state.steps[agent])
        episode = batch.table.episodes[int(batch.state.episode[agent])]
        here = Standpoint(None)
        here.pose, here.episode, here.steps = batch.pose(agent), episode, steps
        fields |= {sensor.name: sensor.read(here) for sensor in spelt if sensor.many is not None}
        more = {name: fields.pop(name) for name in [*fields] if name not in OBSERVED}
        if scale is not None and maps:
            fields["bev_metres_per_pixel"] = scale[k]
        observations.append(
            Observation(
                step=steps,
                time=steps * STEP_SECONDS,
                instruction=episode.instruction,
                collided=bool(batch.state.collided[agent]),
                more=more,
                **fields,
            )
        )
    return observations
