"""Agents on a device who follow somebody: what steps earn and what ends episodes, kept there.

The rules are those of `gn0.sim.follow_tally`, operation by operation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gn0.device.device import DeviceArray
from gn0.missions.episode import AgentSpec, Episode
from gn0.missions.follow_rules import FOLLOW, SAME_TIME, FollowRules
from gn0.sim.device_layout import FOLLOW_FIELDS, FOLLOWING, pack_struct
from gn0.sim.device_people import CompanyDevice, Engine
from gn0.sim.device_records import PlaceFollowing, StepFollowing
from gn0.sim.follow_tally import FOLLOWING as EARNED
from gn0.sim.follow_tally import TOUCH

_NAMES = {"distance": "person_distance"}  # of infos, where they are others than the kernels'


class FollowingDevice(CompanyDevice):
    """People around N agents, each of whom follows one of them; see `CompanyDevice`.

    Args:
        simulator: of the agents.
        rules: of following.
    """

    def __init__(self, simulator: Engine, rules: FollowRules = FOLLOW) -> None:
        super().__init__(simulator, rules.person_radius)
        self._rules = rules
        self._tally: dict[str, DeviceArray] = {}
        self._ended: dict[str, DeviceArray] = {}

    def make_room(self, episodes: Sequence[Episode], body: AgentSpec) -> None:
        """See `CompanyDevice`."""
        super().make_room(episodes, body)
        if self._tally or not self:
            return
        count, zeros, rules = self._simulator.count, self._device.zeros, self._rules
        self._tally = {
            "far": zeros(count, np.int32),
            "over_at": zeros(count, np.float64),
            "gap": zeros(count, np.float64),
        } | {name: zeros(count, kind) for name, kind in FOLLOW_FIELDS}
        self._ended = {name: zeros(count, kind) for name, kind in FOLLOW_FIELDS}
        self._following = pack_struct(
            FOLLOWING,
            **self._tally,
            **{f"final_{name}": array for name, array in self._ended.items()},
            reach=rules.reach,
            aligned=math.cos(math.radians(rules.half_view)),
            nearest=rules.nearest,
            lost_beyond=rules.lost_beyond,
            linger=rules.linger,
            touch_within=rules.touch_within,
            same_time=SAME_TIME,
            step_seconds=body.step_seconds,
            following=EARNED,
            touch=TOUCH,
            lost_after=rules.lost_after,
        )

    @property
    def arrays(self) -> dict[str, DeviceArray]:
        """See `CompanyDevice`."""
        return {f"follow_{name}": array for name, array in self._tally.items()}

    def tell(self, prefix: str = "") -> dict[str, DeviceArray]:
        """See `CompanyDevice`; `end` counts in `gn0.sim.follow_tally.ENDS`."""
        told = self._ended if prefix else self._tally
        more = {_NAMES.get(name, name): told[name] for name, _ in FOLLOW_FIELDS}
        return super().tell(prefix) | more

    def place(self, slots: DeviceArray, out: np.void) -> None:
        """See `CompanyDevice`."""
        placing = PlaceFollowing(self._simulator.world, self.crowd, self._following, slots, out)
        self.run("place_following", placing)

    def step(self, codes: DeviceArray, out: np.void) -> None:
        """See `CompanyDevice`."""
        self.move(codes)
        world = self._simulator.world
        stepping = StepFollowing(world, self.crowd, self._following, codes, out)
        self.run("step_following", stepping)
