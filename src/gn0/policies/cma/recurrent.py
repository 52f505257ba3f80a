"""The graphs of CMA and Seq2Seq, over walks of N agents in T steps at once.

    words ─ embedding ─ LSTM ──────────── text ◄─┐
    picture ─ encoder ── 16 places ◄─────────┐   │ attends
       └─ mean ─┐                            │   │
    action ─────┴─ GRU 1 ─ state ── attends ─┴───┘
                             └─ state, text, pictures, action ─ GRU 2 ─ 4 actions

What a step sees does not hang on the steps before, so encoders and attention work on all T · N
states together; only the GRUs go from step to step. Where an episode begins their state is nought.
Widths are in `CmaSizes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from gn0.policies.cma.cma_settings import DEPTH, CmaSettings
from gn0.policies.cma.efficientnet_lite import EfficientNetLite0
from gn0.policies.cma.resnet import ResNet18, count_groups, pool_map, scale_colours, scale_depth

ACTIONS = 4
SIDE = 4  # of a picture's map


@dataclass(frozen=True)
class Words:
    """M instructions as they are read.

    Attributes:
        states: float32 [M, L, W] of the encoder at each word.
        last: float32 [M, W] at the last word; of both directions at their ends.
        there: bool [M, L] where there is a word.
    """

    states: Tensor
    last: Tensor
    there: Tensor

    def pick(self, rows: Tensor) -> Words:
        """Those of rows int64 [B]."""
        return Words(
            self.states.index_select(0, rows),
            self.last.index_select(0, rows),
            self.there.index_select(0, rows),
        )


class Reader(nn.Module):
    """Instructions word by word: learned words, one LSTM, and one from behind where asked for."""

    def __init__(self, vocabulary: int, word: int, text: int, *, both: bool) -> None:
        super().__init__()
        self.words = nn.Embedding(vocabulary, word)
        self.ahead = nn.LSTM(word, text, batch_first=True)
        self.back = nn.LSTM(word, text, batch_first=True) if both else None
        self.width = text * (2 if both else 1)

    def forward(self, ids: Tensor, counts: Tensor) -> Words:
        """Read int64 [M, L] ids, of which the first `counts` [M], at least one, are words."""
        length = ids.shape[1]
        places = torch.arange(length, device=ids.device)[None]
        there = places < counts[:, None]
        shown = self.words(ids) * there[..., None]
        end = (counts - 1)[:, None, None]
        states = self.ahead(shown)[0]
        last = states.gather(1, end.expand(-1, 1, states.shape[2]))[:, 0]
        if self.back is not None:
            # each text turned round in its own length: what is behind it is never read before it
            turned = torch.where(there, counts[:, None] - 1 - places, places)
            backwards = shown.gather(1, turned[..., None].expand_as(shown))
            other = self.back(backwards)[0]
            ends = other.gather(1, end.expand(-1, 1, other.shape[2]))[:, 0]
            other = other.gather(1, turned[..., None].expand_as(other))
            states, last = torch.cat([states, other], -1), torch.cat([last, ends], -1)
        return Words(states * there[..., None], last, there)


class Eye(nn.Module):
    """One of the pictures: its encoder, and the learned vector of each place of its map.

    Args:
        name: of the picture.
        settings: sizes and the depth sensor's reach.
    """

    def __init__(self, name: str, settings: CmaSettings) -> None:
        super().__init__()
        sizes = settings.sizes
        self.is_depth, self.reach = name == DEPTH, settings.depth_range
        self.net: ResNet18 | EfficientNetLite0
        if name == "rgb" and settings.encoder == "efficientnet_lite0":
            self.net = EfficientNetLite0()
        else:
            self.net = ResNet18(1 if self.is_depth else 3, sizes.planes)
        planes, self.width = self.net.planes, sizes.depth if self.is_depth else sizes.colour
        self.squeeze: nn.Module = nn.Identity()
        if self.is_depth:
            self.squeeze = nn.Sequential(
                nn.Conv2d(planes, sizes.squeezed, 3, 1, 1, bias=False),
                nn.GroupNorm(count_groups(sizes.squeezed), sizes.squeezed),
                nn.ReLU(),
            )
            planes = sizes.squeezed
        self.places = nn.Parameter(torch.randn(sizes.place, SIDE * SIDE))
        self.channels = planes + sizes.place
        whole = self.channels * (SIDE * SIDE if self.is_depth else 1)
        self.tell = nn.Linear(whole, self.width)

    def forward(self, pictures: Tensor) -> Tensor:
        """Maps float32 [B, channels, 16]."""
        scaled = scale_depth(pictures, self.reach) if self.is_depth else scale_colours(pictures)
        found = pool_map(self.squeeze(self.net(scaled)), SIDE).float()
        return torch.cat([found, self.places.expand(len(found), -1, -1)], 1)

    def summarise(self, seen: Tensor) -> Tensor:
        """What the first GRU is told of a map: float32 [B, width]."""
        whole = seen.flatten(1) if self.is_depth else seen.mean(-1)
        return functional.relu(self.tell(whole))


class Attention(nn.Module):
    """What a query finds among P places: softmax(q · k / √d) v."""

    def __init__(self, query: int, channels: int, key: int, value: int) -> None:
        super().__init__()
        self.query = nn.Linear(query, key)
        self.key = nn.Linear(channels, key)
        self.value: nn.Module = nn.Linear(channels, value) if value else nn.Identity()

    def forward(self, asked: Tensor, places: Tensor, there: Tensor | None = None) -> Tensor:
        """[B, value], or [B, channels] without values of its own.

        Args:
            asked: [B, query].
            places: [B, P, channels].
            there: bool [B, P], places that count, at least one; all when None.
        """
        scores = torch.einsum("bk,bpk->bp", self.query(asked), self.key(places))
        scores = scores / self.key.out_features**0.5
        if there is not None:
            scores = scores.masked_fill(~there, torch.finfo(scores.dtype).min)
        return torch.einsum("bp,bpv->bv", scores.softmax(-1), self.value(places))


class StepGru(nn.Module):
    """A GRU over T steps of N walks, whose state is nought wherever an episode begins."""

    def __init__(self, given: int, hidden: int) -> None:
        super().__init__()
        self.cell = nn.GRUCell(given, hidden)
        for name, weight in self.cell.named_parameters():
            if name.startswith("weight"):
                nn.init.orthogonal_(weight)
            else:
                nn.init.zeros_(weight)

    def forward(self, given: Tensor, begins: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """States [T, N, H] after each step of [T, N, G], and the last [N, H].

        Args:
            given: what each step brings.
            begins: bool [T, N].
            state: [N, H] before the first.
        """
        kept = (~begins).to(given.dtype)[..., None]
        states = []
        for step, goes_on in zip(given, kept, strict=True):
            state = self.cell(step, state * goes_on)
            states.append(state)
        return torch.stack(states), state


class RecurrentNet(nn.Module):
    """A recurrent baseline; see the module's text.

    Args:
        settings: its graph, pictures and sizes.
    """

    def __init__(self, settings: CmaSettings) -> None:
        super().__init__()
        sizes = settings.sizes
        self.settings = settings
        self.attends = settings.graph == "cma"
        self.eyes = nn.ModuleDict({name: Eye(name, settings) for name in settings.pictures})
        eyes = [self._eye(name) for name in settings.pictures]
        told = sum(eye.width for eye in eyes)
        self.reader: Reader | None = None
        text = sizes.text * (2 if self.attends else 1)
        if settings.words:
            self.reader = Reader(settings.vocabulary, sizes.word, sizes.text, both=self.attends)
        else:  # goal-blind: the same vector for all, in the place of what is read
            self.wordless = nn.Parameter(torch.zeros(text))
        if self.attends:
            self.actions = nn.Embedding(ACTIONS + 1, sizes.action)
            self.first = StepGru(told + sizes.action, sizes.hidden)
            if settings.words:
                self.to_words = Attention(sizes.hidden, text, sizes.key, 0)
            self.to_pictures = nn.ModuleDict(
                {
                    name: Attention(text, eye.channels, sizes.key, eye.width)
                    for name, eye in zip(settings.pictures, eyes, strict=True)
                }
            )
            whole = sizes.hidden + text + told + sizes.action
            self.join = nn.Linear(whole, sizes.hidden)
            self.second = StepGru(sizes.hidden, sizes.hidden)
        else:
            self.first = StepGru(text + told, sizes.hidden)
        self.grus = 2 if self.attends else 1
        self.choose = nn.Linear(sizes.hidden, ACTIONS)
        nn.init.orthogonal_(self.choose.weight, 0.01)
        nn.init.zeros_(self.choose.bias)
        self.progress = nn.Linear(sizes.hidden, 1)

    def _eye(self, name: str) -> Eye:
        eye = self.eyes[name]
        assert isinstance(eye, Eye)
        return eye

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return self.choose.weight.device

    def begin(self, count: int) -> Tensor:
        """States [GRUs, N, H] of walks that have not begun."""
        weight = self.choose.weight
        return weight.new_zeros((self.grus, count, weight.shape[1]))

    def read(self, ids: Tensor, counts: Tensor) -> Words | None:
        """Instructions int64 [M, L] with so many words each; None for who reads nothing."""
        return None if self.reader is None else self.reader(ids, counts)

    def see(self, pictures: Sequence[Tensor]) -> list[Tensor]:
        """Maps [B, C, 16] of the pictures, in the settings' order."""
        return [
            self._eye(name)(one) for name, one in zip(self.settings.pictures, pictures, strict=True)
        ]

    def forward(
        self, words: Words | None, seen: Sequence[Tensor], last: Tensor, memory: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Go T steps with N agents.

        Args:
            words: of each of the T · N states, as `read` and `Words.pick` give them.
            seen: of each of the states, as `see` gives it.
            last: int64 [T, N] action before; -1 where an episode begins.
            memory: [GRUs, N, H] before the first step.

        Returns:
            logits [T, N, 4] of the actions, the progress [T, N] that it believes to have made,
            -1 to 1, and the memory after the last step.
        """
        steps, count = last.shape
        begins = last < 0
        names = self.settings.pictures
        told = [self._eye(name).summarise(one) for name, one in zip(names, seen, strict=True)]
        if not self.attends:
            text = self._text(words, None, steps * count)
            given = torch.cat([text, *told], -1).view(steps, count, -1)
            states, first = self.first(given, begins, memory[0])
            return *self._say(states), first[None]
        done = self.actions((last + 1).flatten())
        given = torch.cat([*told, done], -1).view(steps, count, -1)
        states, first = self.first(given, begins, memory[0])
        state = states.flatten(0, 1)
        text = self._text(words, state, steps * count)
        found = [
            self.to_pictures[name](text, one.transpose(1, 2))
            for name, one in zip(names, seen, strict=True)
        ]
        joined = functional.relu(self.join(torch.cat([state, text, *found, done], -1)))
        states, second = self.second(joined.view(steps, count, -1), begins, memory[1])
        return *self._say(states), torch.stack([first, second])

    def _text(self, words: Words | None, state: Tensor | None, count: int) -> Tensor:
        """What is known of the instruction at each state [B, W]."""
        if words is None:
            return self.wordless.expand(count, -1)
        if state is None:
            return words.last
        found: Tensor = self.to_words(state, words.states, words.there)
        return found

    def _say(self, states: Tensor) -> tuple[Tensor, Tensor]:
        return self.choose(states), torch.tanh(self.progress(states))[..., 0]
