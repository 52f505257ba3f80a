"""`StepRing`: the last steps of many agents on their device, from which samples are put together.

What is kept of a step is what cannot be made again cheaply: the view, its tile for mosaics, the
pose and the labels, some 53 kB at 128 px. The mosaic is laid out of the tiles of earlier steps and
ego maps are drawn when a sample is wanted: the bytes are those of the sensors `history` and
`ego_map` at that step. All work goes to torch's current stream and nothing waits for the device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gn0.device.device import Device
from gn0.device.dlpack import wrap_array
from gn0.errors import ConfigError, DeviceMemoryError, SimError
from gn0.policies.bae.policy_settings import SQUARE_NAMES
from gn0.sim.device_atlas import EgoAtlas
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_labels import LabelsDevice
from gn0.sim.history import COLUMNS, LENGTH, ROWS
from gn0.sim.sensors import MapFrame
from gn0.training.streams.samples import LabelledStates

_FIELDS: tuple[tuple[str, torch.dtype, tuple[int, ...]], ...] = (
    ("episode", torch.int32, ()),
    ("pose", torch.float64, (3,)),
    ("step", torch.int32, ()),
    ("last", torch.int8, ()),
    ("collided", torch.bool, ()),
    ("actions", torch.int8, (6,)),
    ("waypoints", torch.float32, (13, 2)),
    ("valid", torch.int8, ()),
    ("distance", torch.float64, ()),
)


class PicturesLazy(Mapping[str, Tensor]):
    """Pictures by name, each made when it is first looked at."""

    def __init__(self, makers: Mapping[str, Callable[[], Tensor]]) -> None:
        self._makers = dict(makers)
        self._made: dict[str, Tensor] = {}

    def __getitem__(self, name: str) -> Tensor:
        if name not in self._made:
            self._made[name] = self._makers[name]()
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


class StepRing:
    """The last T steps of N agents.

    A state has a number for ever: `step * N + agent`, steps counted from the first that was put.

    Args:
        env: whose agents; `rgb` and `ego_map` are kept or drawn where it carries them, also muted
            `ego_map`. It needs no sensor `history`.
        steps: T, more than sixteen where views are kept.
        atlas: draws the ego maps; of the environment when None.
        names: of its squares; `near`, `far`, `square_2` … when None, or none where whole maps are
            shown.
        whole: whole maps that samples have: bev, occupancy.
        map_size: (width, height) [px] that they are brought to.
        memory: bytes that the ring may take; what the card has free when None.

    Attributes:
        count: steps that have been put so far.
        pictures: names of the pictures that samples have.
        nbytes: bytes of the ring.

    Raises:
        ConfigError: too few steps, or names that do not fit the squares.
        DeviceMemoryError: the ring does not fit; says what would.
    """

    def __init__(
        self,
        env: VectorEnvDevice,
        steps: int,
        *,
        atlas: EgoAtlas | None = None,
        names: Sequence[str] | None = None,
        whole: Sequence[str] = (),
        map_size: tuple[int, int] = (128, 128),
        memory: int | None = None,
    ) -> None:
        self.env, self.steps, self.agents, self.count = env, steps, env.num_envs, 0
        self.device = find_torch_device(env)
        self._views = "rgb" in env.sensors
        if env.channels_first:
            raise ConfigError(
                "pictures whose channels come first", remedy="leave out channels_first"
            )
        if steps < 1 or (self._views and steps <= LENGTH):
            raise ConfigError(
                f"a ring of {steps} steps", remedy=f"keep {LENGTH + 1} or more, for the mosaics"
            )
        if atlas is None and "ego_map" in env.sensors:
            atlas = EgoAtlas(env)
        squares = () if atlas is None else atlas.view.squares
        if names is not None and not names and whole:
            squares = ()
        if whole and atlas is None:
            raise ConfigError(
                "whole maps of agents without maps", remedy="carry the sensor ego_map"
            )
        self.whole, self.map_size = tuple(whole), map_size
        given = list(SQUARE_NAMES[: len(squares)])
        if names is not None:
            given = list(names)
        if len(set(given)) != len(squares) or len(given) != len(squares):
            raise ConfigError(f"names {given} of {len(squares)} squares", remedy="name each once")
        self._atlas, self._squares = atlas, dict(zip(given, squares, strict=True))
        fields = {name: (kind, shape) for name, kind, shape in _FIELDS}
        if self._views:
            height, width = env.single_observation_space["rgb"].shape[:2]  # type: ignore[index]
            across, down = env.simulator.config.preset.history_tile
            fields["rgb"] = torch.uint8, (height, width, 3)
            fields["tile"] = torch.uint8, (down, across, 3)
        each = self.agents * sum(
            kind.itemsize * int(np.prod(shape)) for kind, shape in fields.values()
        )
        self.nbytes = each * steps
        room = measure_room(self.device) if memory is None else memory
        if room is not None and self.nbytes > room:
            raise self._refusal(each, room)
        try:
            self._kept = {
                name: torch.zeros((steps, self.agents, *shape), dtype=kind, device=self.device)
                for name, (kind, shape) in fields.items()
            }
        except torch.OutOfMemoryError:
            raise self._refusal(each, measure_room(self.device) or 0) from None
        views = ("rgb", "history") if self._views else ()
        self.pictures: tuple[str, ...] = (*views, *self._squares, *self.whole)

    def _refusal(self, each: int, room: int) -> DeviceMemoryError:
        return DeviceMemoryError(
            f"a ring of {self.steps} steps of {self.agents} agents takes {self.nbytes} bytes, "
            f"{room} are free",
            where=str(self.device),
            remedy=f"keep up to {room // each} steps ({room // each * self.agents} states), or "
            "smaller pictures",
        )

    def __getitem__(self, name: str) -> Tensor:
        """What is kept, [T, N, …] by name: step g is in row g modulo T."""
        return self._kept[name]

    def clear(self) -> None:
        """Forget all steps; numbers begin again at nought."""
        self.count = 0

    def skip(self, count: int) -> None:
        """Let `count` steps have been put that cannot be drawn any more; the ring is empty."""
        self.count = count

    def put(
        self, labels: LabelsDevice, last: Tensor, begun: Tensor | None = None, seen: Any = None
    ) -> None:
        """Keep what agents see now, where they stand, and what is to be done there.

        Args:
            labels: of all agents where they stand.
            last: int8 [N] code of the action before; −1 at an episode's start.
            begun: int32 [N] how many steps of its episode each agent has behind it; those that
                the environment has counted when None.
            seen: observations; the environment's when None.
        """
        at, simulator = self.count % self.steps, self.env.simulator
        if begun is None:
            begun = torch.from_dlpack(simulator.state["steps"])
        kept = {name: array[at] for name, array in self._kept.items()}
        for name in ("episode", "pose", "collided"):
            kept[name].copy_(torch.from_dlpack(simulator.outputs[name]))
        kept["step"].copy_(begun)
        kept["last"].copy_(last)
        for name in ("actions", "waypoints", "valid", "distance"):
            kept[name].copy_(torch.from_dlpack(getattr(labels, name)))
        if self._views:
            seen = self.env.observe() if seen is None else seen
            kept["rgb"].copy_(torch.from_dlpack(seen["rgb"]))
            self.env.write_tiles(wrap_array(kept["tile"], self.env.device))
        self.count += 1

    @property
    def window(self) -> tuple[int, int]:
        """First state that can be drawn, and the one behind the last.

        A step whose sixteen steps before were overwritten is out.
        """
        lost = self.count - self.steps
        first = 0 if lost <= 0 else lost + (LENGTH if self._views else 0)
        return first * self.agents, self.count * self.agents

    def draw(
        self, numbers: NDArray[np.int64], dark: NDArray[np.bool_] | None = None, *,
        lazy: bool = False,
    ) -> LabelledStates:  # fmt: skip
        """States by number, with their pictures.

        Args:
            numbers: int64 [B] in `window`.
            dark: bool [B], those whose mosaic is black.
            lazy: pictures are made when they are looked at, before the next `put`.

        Raises:
            SimError: a state that is not here, or not with its past.
        """
        first, end = self.window
        if len(numbers) and not (first <= numbers.min() and numbers.max() < end):
            raise SimError(
                f"states {numbers.min()} to {numbers.max()} of {first} to {end - 1}",
                remedy="draw states of StepRing.window",
            )
        rows = self._send(numbers % (self.steps * self.agents))
        picked = {
            name: kept.flatten(0, 1).index_select(0, rows)
            for name, kept in self._kept.items()
            if name not in ("rgb", "tile")
        }
        step = picked.pop("step")
        del picked["valid"]
        makers: dict[str, Callable[[], Tensor]] = {}
        if self._views:
            makers["rgb"] = lambda: self._kept["rgb"].flatten(0, 1).index_select(0, rows)
            shown = None if dark is None else self._send(~dark)
            makers["history"] = lambda: self._lay_mosaics(rows, step, shown)
        for name in self._squares:
            makers[name] = lambda name=name: self._draw_square(  # type: ignore[misc]
                name, picked["episode"], picked["pose"]
            )
        for name in self.whole:
            makers[name] = lambda name=name: self._draw_whole(  # type: ignore[misc]
                name, picked["episode"], picked["pose"]
            )
        pictures: Mapping[str, Tensor] = PicturesLazy(makers)
        return LabelledStates(**picked, pictures=pictures if lazy else dict(pictures))

    def latest(self) -> LabelledStates:
        """The states that were put last [N], pictures made when they are looked at."""
        end = self.count * self.agents
        return self.draw(np.arange(end - self.agents, end), lazy=True)

    def _send(self, array: NDArray[Any]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.device, non_blocking=True)

    def _lay_mosaics(self, rows: Tensor, step: Tensor, shown: Tensor | None) -> Tensor:
        """Mosaics [B, 4 h, 4 w, 3] of the sixteen steps before, newest first, of this episode."""
        tiles = self._kept["tile"].flatten(0, 1)
        back = torch.arange(1, LENGTH + 1, device=self.device)
        wanted = torch.remainder(rows[:, None] - back * self.agents, len(tiles))
        there = step[:, None] >= back
        if shown is not None:
            there = there & shown[:, None]
        height, width = tiles.shape[1:3]
        found = tiles.index_select(0, wanted.flatten()).view(-1, LENGTH, height, width, 3)
        found = found.masked_fill_(~there[:, :, None, None, None], 0)
        laid = found.view(-1, ROWS, COLUMNS, height, width, 3).transpose(2, 3)
        return laid.reshape(-1, ROWS * height, COLUMNS * width, 3)

    def _draw_square(self, name: str, episode: Tensor, pose: Tensor) -> Tensor:
        assert self._atlas is not None
        square, device = self._squares[name], self.env.device
        size = square.size
        out = torch.empty((len(pose), size, size, 3), dtype=torch.uint8, device=self.device)
        numbers, poses = wrap_array(episode, device), wrap_array(pose, device)
        self._atlas.draw(square, numbers, poses, wrap_array(out, device))
        return out

    def _draw_whole(self, name: str, episode: Tensor, pose: Tensor) -> Tensor:
        assert self._atlas is not None
        return draw_whole(self._atlas, self.env.device, name, self.map_size, episode, pose)

    @property
    def frames(self) -> tuple[MapFrame, ...]:
        """The whole map of each episode, by number; none where agents have no maps."""
        return () if self._atlas is None else self._atlas.frames


def draw_whole(
    atlas: EgoAtlas, device: Device, name: str, size: tuple[int, int], episode: Tensor, pose: Tensor
) -> Tensor:
    """Whole maps uint8 [B, H, W, 3] of episodes int32 [B] with agents at poses float64 [B, 3]."""
    shape = (len(pose), size[1], size[0], 3)
    out = torch.empty(shape, dtype=torch.uint8, device=pose.device)
    numbers, poses = (wrap_array(one.contiguous(), device) for one in (episode, pose))
    atlas.draw_whole(name, size, numbers, poses, wrap_array(out, device))
    return out


def measure_room(device: torch.device) -> int | None:
    """Bytes that a card has free for torch; None where that is not a card."""
    if device.type != "cuda":
        return None
    spare = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return torch.cuda.mem_get_info(device)[0] + spare


def find_torch_device(env: VectorEnvDevice) -> torch.device:
    """Where torch finds the memory of an environment's device."""
    if env.device.kind != "cuda":
        return torch.device("cpu")
    return torch.device("cuda", getattr(env.device, "ordinal", 0))
