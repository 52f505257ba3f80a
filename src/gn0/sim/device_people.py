"""People around agents on a device: their state there, and what moves, keeps and tells them.

They do what `gn0.sim.people.Company` has them do, bit for bit. Their routes lie beside the episodes
that they are in (`EpisodeStore`), the walls of a scene beside its map; what they are doing is in
columns, environments last. An action is two launches: everybody through its ticks, then rewards and
ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, Kernel
from gn0.missions.episode import AgentSpec, Episode
from gn0.people.crowd import PACE
from gn0.people.person import PEOPLE_MOST, RADIUS
from gn0.people.reach import REALS, WHOLES
from gn0.sim.device_layout import (
    CROWD,
    CROWD_FIELDS,
    CROWD_THREADS,
    PEOPLE,
    THREADS,
    blocks_of,
    pack_struct,
)
from gn0.sim.device_records import (
    MovePeople,
    PlacePeople,
    RestorePeople,
    SavePeople,
    ShortenRanges,
    StepAmong,
    WidenCrowd,
)

LANES = (32, 16, 8)  # environments a block of kernels that move people
BLOCKS = 512  # as long as wider ones are at least so many: four a multiprocessor or so
KEPT = ("people_real", "people_whole")  # rows of saved states


class Engine(Protocol):
    """What people need of the simulator of their agents."""

    @property
    def count(self) -> int:
        """Of agents."""
        ...

    @property
    def device(self) -> Device:
        """Where they are."""
        ...

    @property
    def world(self) -> np.void:
        """The struct `World` that kernels take."""
        ...

    def copy(self, source: DeviceArray, target: DeviceArray) -> None:
        """Copy an array on the device into another of the same size."""
        ...


class CompanyDevice:
    """The people around N agents.

    Args:
        simulator: of the agents.
        radius: of people's discs [m].

    Attributes:
        places: people that an environment has room for; 0 while no episode has any.
        outputs: what was told last, [N, …] by name; see `device_layout.CROWD_FIELDS`.
    """

    def __init__(self, simulator: Engine, radius: float = RADIUS) -> None:
        self._simulator, self._radius = simulator, radius
        self.places = 0
        self.outputs: dict[str, DeviceArray] = {}
        self._kernels: Mapping[str, Kernel] = {}
        self._state: dict[str, DeviceArray] = {}
        self._crowd: np.void | None = None
        self._later: tuple[np.void, dict[str, DeviceArray]] | None = None

    def __bool__(self) -> bool:
        return self.places > 0

    @property
    def _device(self) -> Device:
        return self._simulator.device

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = [*(self._state | self.outputs).values()]
        arrays += [] if self._later is None else [*self._later[1].values()]
        return sum(array.nbytes for array in arrays)

    @property
    def crowd(self) -> np.void:
        """The struct `Crowd` that kernels take."""
        assert self._crowd is not None
        return self._crowd

    @property
    def kernels(self) -> Mapping[str, Kernel]:
        """Kernels of people."""
        return self._kernels

    @property
    def lanes(self) -> int:
        """Environments a block: few where there are few, so that all of the card has some."""
        for lanes in LANES[:-1]:
            if lanes * self.places <= CROWD_THREADS and self._simulator.count >= lanes * BLOCKS:
                return lanes
        return LANES[-1]

    @property
    def arrays(self) -> dict[str, DeviceArray]:
        """What else of agents [N, …] a saved state holds, by name."""
        return {}

    def tell(self, prefix: str = "") -> dict[str, DeviceArray]:
        """What infos hold of people [N, …]; with prefix `final_`, of episodes that ended."""
        return {name: self.outputs[prefix + name] for name, _ in CROWD_FIELDS if self.outputs}

    def make_room(self, episodes: Sequence[Episode], body: AgentSpec) -> None:
        """Have room for the people of all of these episodes; nobody is moved."""
        places = max((len(episode.people) for episode in episodes), default=0)
        if places <= self.places:
            return
        count, zeros, before = self._simulator.count, self._device.zeros, self.places
        self._kernels = self._kernels or self._device.load(PEOPLE)
        fresh = {
            "real": zeros((REALS, places, count), np.float64),
            "whole": zeros((WHOLES, places, count), np.int64),
            "cut": zeros(count, np.bool_),
        }
        if before:
            self._widen("real", fresh["real"])
            self._widen("whole", fresh["whole"])
            self._simulator.copy(self._state["cut"], fresh["cut"])
        told = {}
        for prefix in ("", "final_"):
            for name, kind in CROWD_FIELDS:
                shape = (count, places, 4) if name == "people" else (count,)
                told[prefix + name] = zeros(shape, kind)
        told["people"] = self._device.upload(np.full((count, places, 4), np.nan))
        if before:
            for name, array in self.outputs.items():
                if array.shape == told[name].shape:
                    self._simulator.copy(array, told[name])
                else:
                    self._device.upload(_pad(array.numpy(), told[name].numpy()), told[name])
        self._state, self.outputs, self.places, self._later = fresh, told, places, None
        self._crowd = pack_struct(
            CROWD,
            **fresh,
            **told,
            agent_radius=body.radius,
            person_radius=self._radius,
            tick_seconds=PACE.seconds,
            tick_cos=PACE.cos,
            tick_sin=PACE.sin,
            rate=PACE.rate,
            parts=PACE.parts,
            places=places,
            ticks=body.step_ticks,
            slides=body.sliding,
        )

    def _widen(self, name: str, out: DeviceArray) -> None:
        columns, places, count = self._state[name].shape
        widening = WidenCrowd(
            in_=self._state[name],
            columns=np.int32(columns),
            from_=np.int32(places),
            to=np.int32(out.shape[1]),
            count_=np.int32(count),
            out=out,
        )
        self._kernels[f"widen_{name}s"].launch(
            blocks_of(columns * places * count), THREADS, widening
        )

    def place(self, slots: DeviceArray, out: np.void) -> None:
        """Begin episodes, everybody at their beginnings; `out` is the struct `Outputs`."""
        placing = PlacePeople(self._simulator.world, self.crowd, slots, out)
        self.run("place_people", placing)

    def move(self, codes: DeviceArray) -> None:
        """Everybody through the ticks of an action each, and agents that go ahead with them."""
        self.run("move_people", MovePeople(self._simulator.world, self.crowd, codes))

    def look_ahead(self) -> np.void:
        """The struct `Crowd` of where people will be after an action in which agents stand still.

        Their state does not change. It holds until the next call.
        """
        if self._later is None:
            device, state = self._device, self._state
            own = {name: device.empty(array.shape, array.dtype) for name, array in state.items()}
            for name, _ in CROWD_FIELDS:
                told = self.outputs[name]
                own[name] = device.empty(told.shape, told.dtype)
            crowd = self.crowd.copy()
            for name, array in own.items():
                crowd[name] = array.pointer
            own["codes"] = device.zeros(self._simulator.count, np.uint8)  # STOP
            self._later = crowd, own
        crowd, own = self._later
        for name in ("real", "whole"):
            self._simulator.copy(self._state[name], own[name])
        self.run("move_people", MovePeople(self._simulator.world, crowd, own["codes"]))
        return crowd

    def step(self, codes: DeviceArray, out: np.void) -> None:
        """Take one action each; `out` is the struct `Outputs`."""
        self.move(codes)
        self.run("step_people", StepAmong(self._simulator.world, self.crowd, codes, out))

    def run(self, name: str, record: Any) -> None:
        """Run a kernel with a thread for each person that there is room for."""
        lanes = self.lanes
        blocks = blocks_of(self._simulator.count, lanes)
        self._kernels[name].launch(blocks, (lanes, self.places), record)

    def shorten(
        self,
        slots: DeviceArray,
        poses: DeviceArray,
        turns: DeviceArray,
        out: DeviceArray,
        prefix: str = "",
    ) -> None:
        """Cut range rings `out` [N, R] m where people are in the way."""
        shortening = ShortenRanges(
            w=self._simulator.world,
            c=self.crowd,
            slots=slots,
            poses=poses,
            turns=turns,
            people=self.outputs[prefix + "people"],
            rays=np.int32(out.shape[1]),
            out=out,
        )
        self._kernels["shorten_ranges"].launch(blocks_of(out.size), THREADS, shortening)

    def save(self, agents: DeviceArray) -> dict[str, DeviceArray]:
        """What people around `agents` int32 [K] do, in rows that `restore` understands."""
        count = len(agents)
        real = self._device.empty((count, PEOPLE_MOST, REALS), np.float64)
        whole = self._device.empty((count, PEOPLE_MOST, WHOLES), np.int64)
        saving = SavePeople(self._simulator.world, self.crowd, agents, np.int32(count), real, whole)
        self._kernels["save_people"].launch(blocks_of(count * PEOPLE_MOST), THREADS, saving)
        return dict(zip(KEPT, (real, whole), strict=True))

    def restore(
        self, saved: Mapping[str, DeviceArray], rows: DeviceArray, agents: DeviceArray
    ) -> None:
        """Put people of rows `rows` int32 [K] around `agents` [K], who play those episodes."""
        count = len(agents)
        restoring = RestorePeople(
            w=self._simulator.world,
            c=self.crowd,
            rows=rows,
            agents=agents,
            count_=np.int32(count),
            real=saved[KEPT[0]],
            whole=saved[KEPT[1]],
        )
        self._kernels["restore_people"].launch(blocks_of(count * self.places), THREADS, restoring)

    def read_state(self, name: str) -> NDArray[Any]:
        """Columns `real` [N, P, REALS] or `whole` [N, P, WHOLES] on the host; waits."""
        return np.ascontiguousarray(self._state[name].numpy().transpose(2, 1, 0))


def _pad(old: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
    new[:, : old.shape[1]] = old
    return new
