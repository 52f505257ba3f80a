"""The people around agents on a device as instances: a kernel says who is seen how, and from where.

What `gn0.people.shown` says of each person goes into a code; a bank on the device knows the posed
cloud of each code, and poses those that it lacks by one launch. Poses and light are written beside
it, so that nothing of it passes through the host while nobody looks anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.bank import AvatarBank
from gn0.avatars.detail import GRAIN, REACH_PX
from gn0.avatars.light import LightProbes, find_probes
from gn0.avatars.motion.library import LOOPS, speed_class
from gn0.avatars.motion.standing import FPS, GESTURES, IDLES
from gn0.avatars.motion.stepping import PIVOT, PIVOT_ROWS
from gn0.avatars.posed_bank import BUDGET, NEARER
from gn0.avatars.posed_device import HoldsParts, PosedBankDevice
from gn0.device.device import Device, DeviceArray
from gn0.errors import ConfigError, DeviceMemoryError, RenderError
from gn0.geometry import F32, F64
from gn0.missions.episode import Episode
from gn0.people.cast import Cast
from gn0.people.person import EpisodePerson
from gn0.people.shown_codes import ShownCodes
from gn0.people.sight import Sight
from gn0.render.instance import PartsDevice
from gn0.scenes.scene import Scene, read_splats
from gn0.seeds import derive_seed
from gn0.sim.device_layout import ROLE, THREADS, blocks_of
from gn0.sim.device_records import ShowPeople
from gn0.sim.device_routes import LookLight
from gn0.sim.open import split_look

if TYPE_CHECKING:
    from pathlib import Path

    from gn0.sim.device_state import SimulatorDevice

_POSTURES = 2**29  # bytes of the host at most, for their postures
_OFFSETS = 97  # by how many ticks people's clips are apart


class PeopleEyesDevice:
    """Shows people to agents on a device.

    Args:
        scenes: scene id → how to get the scene.
        renderer: draws, and holds posed clouds.
        focal: of pictures [px], which decides levels of detail.
        bank: of named people, its folder or itself.
        sight: what is seen in their pictures; who is beside is not posed. All round when None.
        budget: bytes of posed clouds.

    Attributes:
        sight: as of the arguments.
        codes: what kernels say of people.
        posed: the posed clouds.
        ahead: whether those of the next step are posed while this one is drawn, as far as they can
            be foreseen. It changes no picture.

    Raises:
        ConfigError: this renderer holds no posed clouds.
    """

    def __init__(
        self,
        scenes: Mapping[str, Callable[[], Scene]],
        renderer: Any,
        focal: float,
        bank: AvatarBank | Path | str | None = None,
        *,
        sight: Sight | None = None,
        budget: int = BUDGET,
    ) -> None:
        if not isinstance(renderer, HoldsParts) or not renderer.traits.device_views:  # type: ignore[attr-defined]
            raise ConfigError(
                "this renderer does not draw people on a device",
                remedy="use renderer 'cuda', or VectorEnv",
            )
        self._scenes, self.cast = scenes, Cast(bank)
        self._probes: dict[str, LightProbes] = {}  # by scene: its looks differ in gains alone
        self.posed = PosedBankDevice(renderer, budget, postures=_POSTURES)
        self.codes = ShownCodes(self.cast)
        self._from = [0.0] + [
            GRAIN[level] * focal / REACH_PX[level] for level in range(1, len(GRAIN))
        ]
        self.sight = sight
        self.ahead = renderer.device.kind == "cuda"
        self._tables: tuple[DeviceArray, DeviceArray] | None = None  # levels, turns
        self._shown: tuple[DeviceArray, ...] | None = None
        self._next: tuple[DeviceArray, ...] | None = None

    def check(self, episode: Episode) -> None:
        """Refuse people whom nobody can play.

        Raises:
            EpisodeError: names the person.
        """
        self.cast.check(episode.people, f"episode {episode.id!r}")

    def light_of(self, look: str) -> LookLight:
        """The light on people in a scene under a light."""
        scene_id, condition = split_look(look)
        probes = self._probes.get(scene_id)
        if probes is None:
            scene = self._scenes[scene_id]()
            probes = self._probes[scene_id] = find_probes(read_splats(scene), scene.grid)
        gains: F32 | F64 = probes.gains() if condition is None else probes.gains(condition)
        return LookLight(
            np.ascontiguousarray(probes.column, np.int32),
            np.ascontiguousarray(probes.places, np.float64),
            np.ascontiguousarray(gains, np.float64),
        )

    def roles_of(self, episode: Episode) -> NDArray[Any]:
        """What each person of an episode brings to its looks: `ROLE` [P].

        Raises:
            ConfigError: codes have no room for as many people who differ.
            EpisodeError, StorageError, FormatError: see `Cast.find`.
        """
        rows = np.zeros(len(episode.people), ROLE)
        for row, person in zip(rows, episode.people, strict=True):
            self._fill(row, person)
        return rows

    def _fill(self, row: Any, person: EpisodePerson) -> None:
        actor = self.cast.find(person.identity)
        library, seed = actor.library(person.seat), derive_seed(person.seed, "looks")
        row["number"] = self.codes.role(person.identity, person.seat)
        row["offset"], row["gait"] = seed % _OFFSETS, speed_class(person.speed)
        idle = IDLES[seed % len(IDLES)]
        row["idle"], row["idle_rows"] = self.codes.clip(idle), len(library.clip(idle).plan)
        reach = actor.reach_of(person)
        row["stands"], row["walks"], row["still"] = reach.stands, reach.walks, reach.still
        row["reach"], row["shadow"] = reach.most, reach.shadow
        row["coarser"][: len(reach.coarser)] = reach.coarser
        if person.behaviour == "script":
            row["stride"] = library.clip("walk", person.speed).stride
            return
        sits = person.behaviour == "sit"
        name = person.clip or ("sit" if sits else idle)
        clip = library.clip(name)
        assert clip.fps == FPS and not clip.stride
        row["clip"], row["clip_rows"] = self.codes.clip(name), len(clip.plan)
        row["clip_loops"], row["clip_rowed"] = name in LOOPS, name not in GESTURES
        if sits:
            row["forward"] = actor.behind(person.seat)
        elif name not in IDLES:
            row["lasts"] = clip.seconds

    def show(self, simulator: SimulatorDevice) -> PartsDevice:
        """Who stands before each agent now; whoever draws it waits for all of them to be posed."""
        company, device = simulator.company, simulator.device
        each = company.places
        count = simulator.count * each
        if self._shown is None or len(self._shown[0]) != count:
            more = device.zeros(count, np.int32), device.upload(np.full(count, NEARER, np.float32))
            self._shown, self._next = (*_new_looks(device, count), *more), None
        if self._tables is None:
            turns = [row * PIVOT / PIVOT_ROWS for row in range(PIVOT_ROWS + 1)]
            # the host's own, so that poses have its bits
            table = [(math.cos(turn), math.sin(turn)) for turn in turns]
            self._tables = device.upload(np.array(self._from)), device.upload(np.array(table))
        codes, poses, gains, chosen, nearer = self._shown
        self._find(simulator, company.crowd, (codes, poses, gains))
        late = self.posed.ask(codes, chosen, each)
        if self.ahead:  # before anybody waits
            self._next = self._next or _new_looks(device, count)
            self._find(simulator, company.look_ahead(), self._next)
            self.posed.expect(self._next[0])
        return PartsDevice(
            *(None, poses, chosen, each, gains, nearer, self._settle, late),
            meanwhile=self.pose_ahead if self.ahead else None,
        )

    def _settle(self) -> int:
        """Have all be posed whom agents see now; how many of these lacked somebody."""
        self.posed.answer(self.codes)
        return self.posed.late_views

    def pose_ahead(self, *, shown: bool = True) -> None:
        """Pose who will be seen next; the device draws what is seen now meanwhile.

        Who cannot be posed is posed, or refused, where it is seen: a step that was made is made.

        Args:
            shown: whether what is seen now may be drawn again, or by another call.
        """
        if self.ahead:
            with suppress(RenderError, DeviceMemoryError):
                self.posed.pose_expected(self.codes, shown=shown)

    def _find(
        self, simulator: SimulatorDevice, crowd: np.void, looks: Sequence[DeviceArray]
    ) -> None:
        """Write who is seen how, and from where, to codes, poses and gains."""
        assert self._tables is not None
        company = simulator.company
        levels, turned = self._tables
        codes, poses, gains = looks
        across, deeper, ground = self.sight or (math.inf, 0.0, 0.0)
        showing = ShowPeople(
            w=simulator.world,
            c=crowd,
            from_=levels,
            levels=np.int32(len(self._from)),
            turns=turned,
            across=np.float64(across),
            deeper=np.float64(deeper),
            ground=np.float64(ground),
            codes=codes,
            poses=poses,
            gains=gains,
        )
        count = simulator.count * company.places
        company.kernels["show_people"].launch(blocks_of(count), THREADS, showing)


def _new_looks(device: Device, count: int) -> tuple[DeviceArray, DeviceArray, DeviceArray]:
    """Codes, poses and gains of so many people."""
    return (
        device.zeros(count, np.uint64),
        device.zeros((count, 4, 4), np.float64),
        device.zeros((count, 4, 3), np.float32),
    )
