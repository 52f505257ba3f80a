"""Who is who before agents on a device: what the sensors `who` and `people_seen` read there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray
from gn0.errors import ConfigError
from gn0.people.person import PEOPLE_MOST
from gn0.render.camera import Camera
from gn0.render.instance import Parts, PartsDevice
from gn0.sim.device_layout import THREADS, blocks_of
from gn0.sim.device_records import NamePeople, TellSeen

if TYPE_CHECKING:
    from gn0.sim.device_state import SimulatorDevice

SENSORS = frozenset({"who", "people_seen"})
_PIXELS = 256  # threads a block of kernels that have one a pixel


class Asked(NamedTuple):
    """What a renderer is asked for.

    Attributes:
        views: world-to-camera [N, 4, 4].
        keys: scenes.
        chosen: which of them each agent sees; None: as many keys as views, or one.
        parts: what stands before each agent.
    """

    views: Any
    keys: Sequence[str | None] | str
    chosen: DeviceArray | None = None
    parts: Parts | PartsDevice = ()


class WhoThere(Protocol):
    """Who is who in views on a device; see `gn0.render.cuda.who.WhoDevice`."""

    @property
    def numbers(self) -> DeviceArray:
        """Places of instances in their views, from 1, uint32 [V, H, W]."""
        ...

    @property
    def seen(self) -> DeviceArray:
        """Counts of pixels and box of each instance, uint32 [I, 7]."""
        ...


@runtime_checkable
class DrawsWho(Protocol):
    """A renderer that says on the device who is who: `RendererBatch`."""

    def draw_who(
        self,
        camera: Camera,
        views: NDArray[np.floating] | DeviceArray,
        keys: Sequence[str | None] | str,
        *,
        chosen: DeviceArray | None,
        parts: Parts | PartsDevice,
    ) -> WhoThere:
        """Which instance each pixel shows, and how much of each is seen."""
        ...


class WhoEyes:
    """Tells who is who in the pictures of agents.

    Args:
        renderer: draws.
        camera: of colours.

    Raises:
        ConfigError: this renderer does not say who is who on a device.
    """

    def __init__(self, renderer: object, camera: Camera) -> None:
        if not isinstance(renderer, DrawsWho):
            raise ConfigError(
                "this renderer does not say on a device who is who",
                remedy="use renderer 'cuda', leave out who and people_seen, or use VectorEnv",
            )
        self._renderer, self._camera = renderer, camera
        self._persons: dict[int, NDArray[np.uint8]] = {}  # by number of the episode

    def tell(
        self,
        simulator: SimulatorDevice,
        asked: Asked,
        pictures: DeviceArray,
        table: DeviceArray,
    ) -> None:
        """Write who is who where agents stand now; waits for the device.

        Args:
            simulator: of the agents.
            asked: of the renderer, just now.
            pictures: uint8 [N, H, W], see the sensor `who`.
            table: float32 [N, 16, 6], see the sensor `people_seen`.
        """
        found = self._renderer.draw_who(
            self._camera, asked.views, asked.keys, chosen=asked.chosen, parts=asked.parts
        )
        company = simulator.company
        places = company.places
        persons = simulator.device.upload(self._find_persons(simulator, places))
        naming = NamePeople(
            numbers=found.numbers,
            persons=persons,
            places=np.int32(places),
            pixels=np.uint64(self._camera.height * self._camera.width),
            size=np.uint64(pictures.size),
            out=pictures,
        )
        blocks = blocks_of(pictures.size, _PIXELS)
        company.kernels["name_people"].launch(blocks, _PIXELS, naming)
        size = simulator.count * PEOPLE_MOST
        telling = TellSeen(found.seen, persons, np.int32(places), np.int32(size), table)
        company.kernels["tell_seen"].launch(blocks_of(size), THREADS, telling)

    def _find_persons(self, simulator: SimulatorDevice, places: int) -> NDArray[np.uint8]:
        """Numbers [N, places] of the people around each agent, 0 for nobody."""
        episodes = simulator.store.episodes
        rows = np.zeros((simulator.count, places), np.uint8)
        for row, number in zip(rows, simulator.outputs["episode"].numpy().tolist(), strict=True):
            if number not in self._persons:
                people = [person.number for person in episodes[number].people]
                self._persons[number] = np.array(people, np.uint8)
            mine = self._persons[number]
            row[: len(mine)] = mine
        return rows
