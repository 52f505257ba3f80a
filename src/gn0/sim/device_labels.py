"""Labels of all agents on a device: the field expert of `gn0.maps.field_expert`, the same bits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray, KernelSource
from gn0.errors import SimError
from gn0.maps.field_expert import ROUNDING, STOP_DISTANCE
from gn0.paper import ACTIONS_AHEAD, POINTS, SPACING
from gn0.sim.device_layout import KERNELS, SOURCE, blocks_of
from gn0.sim.device_pool import Block
from gn0.sim.device_records import LabelActions, LabelWays
from gn0.sim.device_state import SimulatorDevice
from gn0.sim.ground import BEND, Destination, destination_of

WARP = 32  # threads an agent
TOGETHER = 256  # episodes that are brought before one looks whether more fit
THREADS = 4 * WARP  # a block; LABEL_WARPS of `expert.cu`

WAYS = np.dtype(
    [
        *((name, np.uint64) for name in ("bends", "vias", "stops")),
        *((name, np.int32) for name in ("stop_count", "unused")),
    ],
    align=True,
)
EXPERT = KernelSource(
    "expert",
    (KERNELS / "world.cu", KERNELS / "step.cu", KERNELS / "expert.cu"),
    (*SOURCE.defines, ("BEND_BYTES", BEND.itemsize), ("WAYS_BYTES", WAYS.itemsize)),
)


class LabelsDevice(NamedTuple):
    """Labels of N agents where they stand, on their device; as `gn0.data.Labels`.

    Attributes:
        actions: int8 [N, 6] what to do next; STOP from the end on.
        waypoints: float32 [N, 13, 2] m in the agents' frames, x forward and y left.
        valid: int8 [N] how many waypoints are not repetitions.
        distance: float64 [N] m to the goal on foot.
    """

    actions: DeviceArray
    waypoints: DeviceArray
    valid: DeviceArray
    distance: DeviceArray


@dataclass(eq=False)
class _HeldWays:
    """A block, where its arrays lie in it, places to stop at, and slots that need it."""

    block: Block
    pointers: list[int]
    stops: int
    users: int = 0


class ExpertDevice:
    """Labels the agents of a simulator.

    What labels need of a goal beside its field comes to the device when its first episode is
    played, into the memory of maps and fields, and goes when the last of them goes.

    Args:
        simulator: whose agents they are.
    """

    def __init__(self, simulator: SimulatorDevice) -> None:
        self._simulator = simulator
        device, count = simulator.device, simulator.count
        self._kernels = device.load(EXPERT)
        simulator.store.ground.with_ways = True
        self._held: dict[Destination, _HeldWays] = {}
        self._numbers = np.zeros(0, np.int32)  # of the episodes that rows of the table are of
        self._table = np.zeros(0, WAYS)
        self._rows: DeviceArray = device.zeros((1, WAYS.itemsize), np.uint8)
        self._out = LabelsDevice(
            device.zeros((count, ACTIONS_AHEAD), np.int8),
            device.zeros((count, POINTS, 2), np.float32),
            device.zeros(count, np.int8),
            device.zeros(count, np.float64),
        )

    def label(self, stop_distance: float = STOP_DISTANCE) -> LabelsDevice:
        """Labels of all agents; they hold until the next call.

        Args:
            stop_distance: STOP within this walking distance of the goal, in line of sight [m].

        Raises:
            SimError: the distance is out of range.
            DeviceMemoryError: what is played does not fit the device.
        """
        if not ROUNDING < stop_distance <= 10:
            raise SimError(
                f"labels that stop {stop_distance} m from the goal", remedy="give up to 10 m"
            )
        self.bring()
        simulator, out = self._simulator, self._out
        name = "label_sliding" if simulator.store.agent.sliding else "label_actions"
        blocks = blocks_of(simulator.count * WARP, THREADS)
        actions = LabelActions(
            simulator.world,
            self._rows,
            near=np.float64(stop_distance - ROUNDING),
            ahead=np.int32(ACTIONS_AHEAD),
            actions=out.actions,
            distance=out.distance,
        )
        self._kernels[name].launch(blocks, THREADS, actions)
        ways = LabelWays(
            simulator.world,
            self._rows,
            spacing=np.float64(SPACING),
            slots=np.int32(POINTS),
            waypoints=out.waypoints,
            valid=out.valid,
        )
        self._kernels["label_ways"].launch(blocks, THREADS, ways)
        return out

    def bring_all(self, numbers: NDArray[np.integer]) -> int:
        """Bring these episodes with their ways, as many as fit the memory together; their count.

        Raises: see `EpisodeStore.pin`.
        """
        store, count = self._simulator.store, 0
        by_scene = np.array(sorted(numbers.tolist(), key=lambda n: store.episodes[n].scene_id))
        for part in np.array_split(by_scene, -(-len(numbers) // TOGETHER)):
            before = store.dropped
            store.build_fields(part)
            slots = store.pin(part)
            try:
                self.bring()
            finally:
                store.release(slots)
            if store.dropped > before or store.pool.held > store.pool.limit:
                break
            count += len(part)
        return count

    def bring(self) -> None:
        """See to it that the ways of all episodes that are played are on the device."""
        seated, pinned = self._simulator.store.seats
        grown = len(seated) - len(self._numbers)
        if grown:
            self._numbers = np.append(self._numbers, np.full(grown, -1, np.int32))
            self._table = np.append(self._table, np.zeros(grown, WAYS))
        gone = np.flatnonzero((self._numbers >= 0) & (self._numbers != seated))
        for slot in gone.tolist():
            self._let_go(slot)
        fresh = np.flatnonzero(pinned & (self._numbers < 0))
        for slot in fresh.tolist():
            self._seat(slot, int(seated[slot]))
        if grown or len(fresh):
            raw: NDArray[np.uint8] = self._table.view(np.uint8).reshape(len(self._table), -1)
            self._rows = self._simulator.device.upload(raw)

    def _seat(self, slot: int, number: int) -> None:
        store = self._simulator.store
        goal = destination_of(store.episodes[number])
        held = self._held.get(goal)
        if held is None:
            ways = store.ground.ways(goal)
            held = self._held[goal] = _HeldWays(*store.hold(*ways), len(ways.stops))
        held.users += 1
        row = self._table[slot]
        row["bends"], row["vias"], row["stops"] = held.pointers
        row["stop_count"] = held.stops
        self._numbers[slot] = number

    def _let_go(self, slot: int) -> None:
        store = self._simulator.store
        goal = destination_of(store.episodes[int(self._numbers[slot])])
        self._numbers[slot] = -1
        self._held[goal].users -= 1
        if not self._held[goal].users:
            store.pool.give(self._held.pop(goal).block)
