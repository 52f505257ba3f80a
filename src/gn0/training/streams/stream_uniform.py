"""`StreamUniform`: samples of agents that stand anywhere, made as fast as pictures are drawn.

    stream = StreamUniform(env, seed=0)
    states = stream.draw(512)

Uniform headings are FORWARD in one of twelve cases; so about half of the agents look where the
expert would go, and some stand near the goal, where STOP is learned. Nobody has walked: mosaics are
black. For order on a card see `gn0.training.streams.stream_live`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from gn0.device.dlpack import wrap_array
from gn0.errors import ConfigError, FormatError
from gn0.policies.bae.policy_settings import SQUARE_NAMES
from gn0.seeds import derive_seed, random_stream
from gn0.sim.device_atlas import EgoAtlas
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.history import mosaic_size
from gn0.sim.sensors import MapFrame
from gn0.training.streams.samples import LabelledStates
from gn0.training.streams.step_ring import draw_whole, find_torch_device
from gn0.training.streams.stream_live import STOP_DISTANCE, check_stream


class StreamUniform:
    """Labelled states drawn uniformly: a new placement of all agents after every N samples.

    Sample k comes from the seed and k alone, so it resumes exactly, whatever the batches were.
    Rows of a placement are independent draws, so they are handed out in their order.

    Args:
        env: `VectorEnvDevice`, this stream's alone, reset or not.
        seed: of everything that is drawn here.
        facing: share of agents that look where the expert goes first, to one turn more or less.
        near: share of agents near the goal, and how near [m of way].
        stop_distance: where labels say STOP [m].
        names: of the squares of `ego_map`; `near`, `far`, `square_2` … when None, or none where
            whole maps are shown.
        whole: whole maps that samples have: bev, occupancy.
        map_size: (width, height) [px] that they are brought to.
        prepare: bring all episodes that fit to the device now, so that placing waits for none.

    Raises:
        ConfigError: shares out of range, or names that do not fit the squares.
        EpisodeError: an episode does not fit its scene.
    """

    def __init__(
        self,
        env: VectorEnvDevice,
        *,
        seed: int,
        facing: float = 0.55,
        near: tuple[float, float] = (0.15, 3.0),
        stop_distance: float = STOP_DISTANCE,
        names: Sequence[str] | None = None,
        whole: Sequence[str] = (),
        map_size: tuple[int, int] = (128, 128),
        prepare: bool = True,
    ) -> None:
        if not (0 <= facing <= 1 and 0 <= near[0] <= 1 and near[1] > 0) or env.channels_first:
            raise ConfigError(
                f"facing {facing}, near {near}, channels_first {env.channels_first}",
                remedy="give shares from 0 to 1, metres above 0, and leave out channels_first",
            )
        self.env, self.seed, self.facing, self.near = env, seed, facing, near
        self.stop_distance = stop_distance
        self._device = find_torch_device(env)
        self._squares = env.simulator.config.map_view.squares if "ego_map" in env.sensors else ()
        self.whole, self.map_size = tuple(whole), map_size
        self._atlas = EgoAtlas(env) if whole else None
        if whole and names is not None and not names:
            self._squares = ()
        count = len(self._squares)
        given = list(SQUARE_NAMES[:count])
        self.names = given if names is None else list(names)
        if len(set(self.names)) != count or len(self.names) != count:
            raise ConfigError(f"names {self.names} of {count} squares", remedy="name each once")
        self._turn = math.radians(env.tasks.agent.turn_degrees)
        drawn = ("rgb", "ego_map") if self._squares or not whole else ("rgb",)
        self._drawing = tuple(name for name in drawn if name in env.sensors)
        self._unseen = tuple({"ego_map"} & set(env.sensors) - set(self._drawing))
        self.drawn = 0
        self._round = -1
        self._now: LabelledStates | None = None
        env.mute(*self._silent)
        if prepare:
            env.prepare_all()
        env.reset(seed=0)

    @property
    def _silent(self) -> tuple[str, ...]:
        return self._unseen + (() if "history" in self.env.sensors else self._drawing)

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """Instructions by episode number."""
        return tuple(episode.mission.instruction for episode in self.env.episodes)

    @property
    def frames(self) -> tuple[MapFrame, ...]:
        """The whole map of each episode, by number; none where no whole map is shown."""
        return () if self._atlas is None else self._atlas.frames

    def draw(self, count: int) -> LabelledStates:
        """The next states.

        Raises:
            ConfigError: torch's current stream is not its default one.
        """
        check_stream(self._device)
        parts: list[LabelledStates] = []
        left = count
        while left or not parts:
            which, first = divmod(self.drawn, self.env.num_envs)
            taken = min(left, self.env.num_envs - first)
            parts.append(self._place(which).pick(slice(first, first + taken)))
            self.drawn += taken
            left -= taken
        return parts[0] if len(parts) == 1 else join_states(parts)

    def _place(self, which: int) -> LabelledStates:
        """The states of placement `which`."""
        if self._now is not None and self._round == which:
            return self._now
        env, seed = self.env, derive_seed(self.seed, "uniform", which)
        env.mute(*self._silent)
        env.place_uniform(seed, near=self.near)
        stream = random_stream(seed, "headings")
        faces = torch.from_numpy(stream.random(env.num_envs) < self.facing).to(self._device)
        more = torch.from_numpy(stream.integers(-1, 2, env.num_envs)).to(self._device)
        labels = env.labels(self.stop_distance)
        ways = torch.from_dlpack(labels.waypoints)
        turns = self._find_turns(ways[:, 1].double()) + more
        turns = torch.where(faces, turns, 0).to(torch.int32)
        env.mute(*self._unseen)
        seen, infos = env.turn_agents(wrap_array(turns, env.device))
        labels = env.labels(self.stop_distance)
        pictures: dict[str, Tensor] = {
            name: torch.from_dlpack(seen[name]).clone() for name in self._drawing if name == "rgb"
        }
        if pictures:
            across, down = mosaic_size(env.simulator.config.preset.history_tile)
            black = torch.zeros((1, down, across, 3), dtype=torch.uint8, device=self._device)
            pictures["history"] = black.expand(env.num_envs, -1, -1, -1)
        if self._squares:
            whole, left = torch.from_dlpack(seen["ego_map"]), 0
            for name, square in zip(self.names, self._squares, strict=True):
                size = square.size
                pictures[name] = whole[:, :size, left : left + size].clone()
                left += size
        own = {name: torch.from_dlpack(infos[name]).clone() for name in ("episode", "pose")}
        for name in self.whole:
            assert self._atlas is not None
            pictures[name] = draw_whole(
                self._atlas, env.device, name, self.map_size, own["episode"], own["pose"]
            )
        told = {
            name: torch.from_dlpack(getattr(labels, name)).clone()
            for name in ("actions", "waypoints", "distance")
        }
        last = torch.full((env.num_envs,), -1, dtype=torch.int8, device=self._device)
        hit = torch.zeros(env.num_envs, dtype=torch.bool, device=self._device)
        self._now = LabelledStates(**own, last=last, collided=hit, **told, pictures=pictures)
        self._round = which
        return self._now

    def _find_turns(self, way: Tensor) -> Tensor:
        """Whole turns [N] towards first waypoints [N, 2]; none where that is here already."""
        share = torch.atan2(way[:, 1], way[:, 0]) / self._turn
        return torch.where(way.square().sum(1) > 0, share.round(), 0).long()

    def state(self) -> dict[str, Any]:
        """Where it stands, as JSON: what `restore` takes."""
        return {"drawn": self.drawn}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from there: the same states follow.

        Raises:
            FormatError: it is no state of ours.
        """
        drawn = state.get("drawn")
        if not isinstance(drawn, int) or drawn < 0:
            raise FormatError(f"drawn is {drawn!r}", where="stream")
        self.drawn = drawn


def join_states(parts: Sequence[LabelledStates]) -> LabelledStates:
    """States one behind another."""
    first = parts[0]
    arrays = {
        name: torch.cat([getattr(part, name) for part in parts])
        for name in ("episode", "pose", "last", "collided", "actions", "waypoints", "distance")
    }
    pictures = {name: torch.cat([part.pictures[name] for part in parts]) for name in first.pictures}
    return LabelledStates(**arrays, pictures=pictures)
