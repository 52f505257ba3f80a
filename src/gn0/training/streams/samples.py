"""Samples to train on: labelled states of many episodes, and what a model is given of them.

Every stream gives `LabelledStates`; a `SampleMaker` makes the batch of one prompt out of them, on
the device where they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from gn0.data.answer_slots import ACTION, FREE, AnswerSlots, X, Y
from gn0.data.codec import EgoFrame
from gn0.errors import ConfigError
from gn0.paper import MAP_BINS
from gn0.policies.bae.prompt_table import PromptFiller, PromptTable
from gn0.sim.sensors import MapFrame


@dataclass(frozen=True)
class LabelledStates:
    """N states with what the expert would do there, all on one device.

    Attributes:
        episode: int32 [N] numbers, which are the texts of a prompt table.
        pose: float64 [N, 3] x, y [m], yaw [rad], world frame.
        last: int8 [N] code of the action before; -1 at the start.
        collided: bool [N] whether that action was cut short.
        actions: int8 [N, 6] of the expert.
        waypoints: float32 [N, 13, 2] m in the agent's frame, x forward and y left.
        distance: float64 [N] m to the goal on foot.
        pictures: uint8 [N, H, W, 3] by name: a sensor's, or `near`, `far` … of the squares of
            `ego_map`.
    """

    episode: Tensor
    pose: Tensor
    last: Tensor
    collided: Tensor
    actions: Tensor
    waypoints: Tensor
    distance: Tensor
    pictures: Mapping[str, Tensor]

    def __len__(self) -> int:
        return len(self.episode)

    def pick(self, rows: Tensor | slice) -> LabelledStates:
        """Some of them."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "pictures"}
        pictures = {name: one[rows] for name, one in self.pictures.items()}
        return replace(self, pictures=pictures, **{k: v[rows] for k, v in arrays.items()})


@dataclass(frozen=True)
class SampleBatch:
    """What a model is given, and what it should answer.

    Attributes:
        pictures: uint8 [B, H, W, 3] each, in the prompt's order.
        ids: int64 [B, P] prompts.
        answer: int64 [B, S].
        states: what they were made of.
        input: in which of the policy's ways it asks; empty where there is one alone.
    """

    pictures: tuple[Tensor, ...]
    ids: Tensor
    answer: Tensor
    states: LabelledStates
    input: str = ""

    def __len__(self) -> int:
        return len(self.ids)


class Stream(Protocol):
    """A source of labelled states that goes on where it was left.

    One that knows the scenes' maps also has `frames`, the `MapFrame` of each episode by number.
    """

    @property
    def texts(self) -> tuple[str, ...]:
        """Instructions by episode number; another object only once they are others."""
        ...

    def draw(self, count: int) -> LabelledStates:
        """The next states."""
        ...

    def state(self) -> dict[str, Any]:
        """Where it stands, as JSON: what `restore` takes."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from there: the same states follow."""
        ...


class SampleMaker:
    """Makes batches of one prompt.

    Args:
        table: prompts of the stream's texts.
        slots: of the answers.
        frame: the square that answers' coordinates are on; not read where there are `maps`.
        device: of the states.
        maps: float64 [E, 5] width, height, m a pixel, x_min, y_min of each episode's map, where
            coordinates are on the whole of it, as in the paper.
        input: name of the policy's way that the prompt belongs to.
    """

    def __init__(
        self,
        table: PromptTable,
        slots: AnswerSlots,
        frame: EgoFrame | None,
        device: torch.device | str,
        maps: Any = None,
        input: str = "",
    ) -> None:
        self.table, self.slots, self.frame, self.input = table, slots, frame, input
        self.device = torch.device(device)
        self._filler = PromptFiller(table, self._send)
        if frame is None and maps is None:
            raise ConfigError("coordinates on no picture", remedy="give a square or maps")
        self._here = None if frame is None else self._send(encode_place(frame))
        self._maps = None if maps is None else self._send(np.asarray(maps, np.float64))
        self._answer = self._send(np.where(slots.ids == FREE, 0, slots.ids).astype(np.int64))
        self._actions = self._send(np.array(slots.vocabulary.actions, np.int64))
        self._at = {k: self._send(np.flatnonzero(slots.kinds == k)) for k in (X, Y, ACTION)}

    def _send(self, array: Any) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)

    def make(self, states: LabelledStates) -> SampleBatch:
        """A batch of these states.

        Raises:
            ConfigError: the states lack a picture that the prompt shows.
        """
        names = self.table.template.pictures
        missing = [name for name in names if name not in states.pictures]
        if missing:
            raise ConfigError(
                f"prompt {self.table.template.name!r} shows {missing[0]!r}, the samples do not",
                where=self.table.template.file,
                remedy=f"they have {', '.join(states.pictures) or 'none'}",
            )
        return SampleBatch(
            tuple(states.pictures[name] for name in names),
            self.prompts(states.episode, states.pose, states.last, states.collided),
            self.answers(states.actions, states.waypoints, states.episode, states.pose),
            states,
            self.input,
        )

    def prompts(self, episode: Tensor, pose: Tensor, last: Tensor, collided: Tensor) -> Tensor:
        """Prompts int64 [N, P]; see `LabelledStates` for what they are made of."""
        numbers = torch.empty((len(episode), 3), dtype=torch.int32, device=self.device)
        if self._maps is None:
            numbers[:, :2] = self._here
        else:
            here = torch.zeros((len(episode), 1, 2), device=self.device)
            numbers[:, :2] = encode_maps(self._maps[episode.long()], here, pose)[:, 0]
        numbers[:, 2] = encode_headings(pose[:, 2])
        filled = self._filler.fill(episode.long(), last.long(), collided.long(), numbers)
        return filled.long()

    def answers(
        self,
        actions: Tensor,
        waypoints: Tensor,
        episode: Tensor | None = None,
        pose: Tensor | None = None,
    ) -> Tensor:
        """Answers int64 [N, S] of actions [N, 6] and waypoints [N, 13, 2] m.

        Episodes [N] and poses [N, 3] are read where coordinates are on whole maps.
        """
        out = self._answer.expand(len(actions), -1).clone()
        out[:, self._at[ACTION]] = self._actions[actions.long()]
        form = self.slots.form
        if form.points:
            points = waypoints[:, form.first_point : form.points]
            if self._maps is None:
                assert self.frame is not None  # else there are maps
                tokens = encode_squares(self.frame, points)
            else:
                tokens = encode_maps(*self._on_map(episode, pose, points))
            for axis, kind in enumerate((X, Y)):
                out[:, self._at[kind]] = tokens[..., axis] + self.slots.vocabulary.number
        return out

    def _on_map(
        self, episode: Tensor | None, pose: Tensor | None, points: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        assert self._maps is not None
        if episode is None or pose is None:
            raise ConfigError(
                "coordinates on whole maps need episodes and poses",
                where=self.table.template.file,
                remedy="give those of the states",
            )
        return self._maps[episode.long()], points, pose

    def waypoints(
        self, answer: Tensor, episode: Tensor | None = None, pose: Tensor | None = None
    ) -> Tensor:
        """Waypoints float32 [N, K, 2] m that answers name, from `form.first_point` on."""
        tokens = torch.stack([answer[:, self._at[kind]] for kind in (X, Y)], -1)
        tokens = tokens - self.slots.vocabulary.number
        if self._maps is None:
            assert self.frame is not None
            return decode_squares(self.frame, tokens)
        return decode_maps(*self._on_map(episode, pose, tokens))

    def actions(self, answer: Tensor) -> Tensor:
        """Actions int64 [N, 6] of answers."""
        said = answer[:, self._at[ACTION]]
        return (said[..., None] == self._actions).int().argmax(-1)


def find_frames(stream: Stream) -> tuple[MapFrame, ...]:
    """The whole map of each of a stream's episodes, by number; none where it knows of none."""
    found: tuple[MapFrame, ...] = getattr(stream, "frames", ())
    return found


def pack_frames(frames: Sequence[MapFrame]) -> np.ndarray:
    """Whole maps as `SampleMaker` takes them: width, height, m a pixel, x_min, y_min [E, 5]."""
    return np.array([(f.width, f.height, f.metres_per_pixel, f.x_min, f.y_min) for f in frames])


def encode_place(frame: EgoFrame) -> np.ndarray:
    """Map tokens int32 [2] of the agent's own place."""
    return encode_squares(frame, torch.zeros((1, 1, 2)))[0, 0].numpy().astype(np.int32)


def encode_squares(frame: EgoFrame, waypoints: Tensor) -> Tensor:
    """`gn0.data.codec.encode_waypoints` on an ego square: int64 [N, K, 2], the same tokens."""
    places = waypoints.double() / frame.metres_per_pixel
    right = 0.5 * frame.size - places[..., 1] - 0.5
    down = frame.ahead * frame.size - places[..., 0] - 0.5
    scaled = torch.stack([right, down], -1) / float(frame.size) * MAP_BINS
    return (scaled + 0.5).floor().clamp(0, MAP_BINS - 1).long()


def decode_squares(frame: EgoFrame, tokens: Tensor) -> Tensor:
    """`gn0.data.codec.decode_waypoints` on an ego square: float32 [N, K, 2] m."""
    pixels = tokens.double() / MAP_BINS * float(frame.size)
    forward = frame.ahead * frame.size - 0.5 - pixels[..., 1]
    left = 0.5 * frame.size - 0.5 - pixels[..., 0]
    return (torch.stack([forward, left], -1) * frame.metres_per_pixel).float()


def encode_maps(maps: Tensor, waypoints: Tensor, pose: Tensor) -> Tensor:
    """`gn0.data.codec.encode_waypoints` on whole maps: int64 [N, K, 2].

    The same tokens on the CPU; on a card a sine may differ in its last bit, and with it a token
    whose waypoint lies on the border of two to 1e-13 m.

    Args:
        maps: float64 [N, 5], see `SampleMaker`.
        waypoints: [N, K, 2] m in each agent's frame.
        pose: float64 [N, 3].
    """
    width, height, scale, x_min, y_min = (one[:, None] for one in maps.unbind(-1))
    cos, sin = _turn(pose)
    x, y = waypoints[..., 0].double(), waypoints[..., 1].double()
    right = (pose[:, :1] + cos * x - sin * y - x_min) / scale - 0.5
    down = height - (pose[:, 1:2] + sin * x + cos * y - y_min) / scale - 0.5
    scaled = torch.stack([right / width, down / height], -1) * MAP_BINS
    return (scaled + 0.5).floor().clamp(0, MAP_BINS - 1).long()


def decode_maps(maps: Tensor, tokens: Tensor, pose: Tensor) -> Tensor:
    """`gn0.data.codec.decode_waypoints` on whole maps: float32 [N, K, 2] m; see `encode_maps`."""
    width, height, scale, x_min, y_min = (one[:, None] for one in maps.unbind(-1))
    cos, sin = _turn(pose)
    right, down = tokens[..., 0].double() / MAP_BINS, tokens[..., 1].double() / MAP_BINS
    x = x_min + (right * width + 0.5) * scale - pose[:, :1]
    y = y_min + (height - 0.5 - down * height) * scale - pose[:, 1:2]
    return torch.stack([cos * x + sin * y, -sin * x + cos * y], -1).float()


def _turn(pose: Tensor) -> tuple[Tensor, Tensor]:
    """Cosine and sine [N, 1] of headings; on the CPU those of NumPy, whose bits the codec has."""
    yaw = pose[:, 2:]
    if yaw.device.type != "cpu":
        return yaw.cos(), yaw.sin()
    numbers = yaw.numpy()
    return torch.from_numpy(np.cos(numbers)), torch.from_numpy(np.sin(numbers))


def encode_headings(yaw: Tensor) -> Tensor:
    """`gn0.data.codec.encode_heading` of headings [N] rad: int64 [N], the same tokens."""
    share = torch.remainder(0.25 - yaw.double() / (2 * torch.pi), 1.0)
    return torch.remainder((share * MAP_BINS + 0.5).floor().long(), MAP_BINS)
