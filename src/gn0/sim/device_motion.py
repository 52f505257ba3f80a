"""What moves before agents on a device: where parts stand at every step, laid down beforehand.

A motion is a function of the time since an episode began, and time is counted in steps. So a table
of poses by step goes to the device once; a kernel takes each agent's rows from it, and nobody waits
for the host to know how far an agent is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device
from gn0.errors import SimError
from gn0.gaussians.cloud import GaussianCloud
from gn0.missions.episode import AgentSpec
from gn0.render.instance import Instance, PartsDevice, digest_part
from gn0.sim.device_records import MotionTables, MotionTargets
from gn0.sim.motion import Moment, Motion, take_moment

NO_MOTION = -1
NO_PART = -1
TABLE_BYTES = 2**30  # of all tables


class MotionDevice:
    """The motions of some scenes, by step.

    Args:
        device: where agents are.
        motions: scene id → what moves there.
        scene_ids: scenes by number.
        count: agents.
        agent: the body, which says how long a step takes.
        max_steps: of an episode.

    Attributes:
        clouds: the parts' splats, by names that are theirs alone.

    Raises:
        SimError: the tables would be too large.
        RenderError: a part that has no meaning.
    """

    def __init__(
        self,
        device: Device,
        motions: Mapping[str, Motion],
        scene_ids: Sequence[str],
        count: int,
        agent: AgentSpec,
        max_steps: int,
    ) -> None:
        self._motions, self._agent = dict(motions), agent
        self.clouds: dict[str, GaussianCloud] = {}
        self._names: dict[tuple[int, str], str] = {}  # of a motion's cloud, here
        different = list({id(motion): motion for motion in self._motions.values()}.values())
        for motion in different:
            for name, cloud in motion.clouds.items():
                digest = digest_part(cloud)
                self._names[id(motion), name] = digest
                self.clouds[digest] = cloud
        times = max_steps + 1
        moments = [
            [take_moment(motion, agent.time_after(step)) for step in range(times)]
            for motion in different
        ]
        self._parts = max((len(m.parts) for rows in moments for m in rows), default=0)
        rows = len(different) * times * self._parts
        if rows * 180 > TABLE_BYTES:
            raise SimError(
                f"tables of {len(different)} motions, {times} steps and {self._parts} parts",
                remedy="allow fewer steps, or let fewer parts move",
            )
        poses = np.tile(np.eye(4), (len(different), times, self._parts, 1, 1))
        chosen = np.full((len(different), times, self._parts), NO_PART, np.int32)
        gains = np.zeros((*chosen.shape, 4, 3), np.float32)
        gains[..., 0, :] = 1.0
        nearer = np.zeros(chosen.shape, np.float32)
        numbers = {name: n for n, name in enumerate(self.clouds)}
        lit = False
        for m, motion in enumerate(different):
            for t, moment in enumerate(moments[m]):
                for p, part in enumerate(moment.parts):
                    poses[m, t, p] = part.pose
                    chosen[m, t, p] = numbers[self._names[id(motion), part.cloud]]
                    gains[m, t, p] = part.whole_gain
                    nearer[m, t, p] = part.nearer
                    lit = lit or part.gain is not None
        number = {id(motion): m for m, motion in enumerate(different)}
        found = [self._motions.get(scene_id) for scene_id in scene_ids]
        of_scene = [NO_MOTION if one is None else number[id(one)] for one in found]
        self.tables = MotionTables(
            motion_of=device.upload(np.array(of_scene, np.int32)),
            poses=device.upload(poses),
            chosen=device.upload(chosen),
            gains=device.upload(gains) if lit else None,
            nearer=device.upload(nearer) if nearer.any() else None,
            times=np.int32(times),
            parts=np.int32(self._parts),
        )
        held = count * self._parts
        self._now = PartsDevice(
            names=list(self.clouds),
            poses=device.zeros((held, 4, 4), np.float64),
            chosen=device.zeros(held, np.int32),
            firsts=self._parts,
            gains=device.zeros((held, 4, 3), np.float32) if lit else None,
            nearer=device.zeros(held, np.float32) if nearer.any() else None,
        )
        self.steps = device.zeros(count, np.int32)  # that agents had taken when they last looked

    @property
    def now(self) -> PartsDevice | None:
        """What stands before each agent, to be filled by `place_parts`; None if nothing ever."""
        return self._now if self._parts else None

    @property
    def targets(self) -> MotionTargets:
        """What `place_parts` fills: all of `now`, and the steps that it read."""
        now = self._now
        return MotionTargets(now.poses, now.chosen, now.gains, now.nearer, self.steps)

    def parts_at(self, scene_id: str, step: int) -> tuple[Instance, ...]:
        """The same of one agent, for who knows its step."""
        motion = self._motions.get(scene_id)
        moment: Moment = take_moment(motion, self._agent.time_after(step))
        return tuple(
            replace(part, cloud=self._names[id(motion), part.cloud]) for part in moment.parts
        )

    def parts_of(
        self, scene_ids: Sequence[str], steps: NDArray[np.int32]
    ) -> list[tuple[Instance, ...]]:
        """The same of several agents."""
        known: dict[tuple[str, int], tuple[Instance, ...]] = {}
        found = []
        for key in zip(scene_ids, steps.tolist(), strict=True):
            if key not in known:
                known[key] = self.parts_at(*key)
            found.append(known[key])
        return found
