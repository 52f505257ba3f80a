"""Agents of a recurrent baseline, each in a slot with its instruction and memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gn0.errors import ConfigError
from gn0.policies.cma.cma_checkpoint import load_cma_checkpoint
from gn0.policies.cma.recurrent import RecurrentNet, Words

BATCH_CARD = 64  # agents at once on a card


@dataclass
class _Walker:
    """What is kept of an episode."""

    words: Words | None  # of one row
    memory: Tensor  # [GRUs, H]
    last: int = -1


class WalkersCma:
    """Agents in slots. Batches are filled up to one shape; fillers see black and are forgotten.

    Args:
        net: in evaluation mode, on its device.
        batch: agents at once.

    Attributes:
        name: what computes.
    """

    def __init__(self, net: RecurrentNet, batch: int) -> None:
        self.net, self.batch = net, batch
        self.device = net.device
        self.name = f"torch, float32 on {self.device.type}"
        self._walkers: dict[int, _Walker] = {}
        settings = net.settings
        self._black = [
            np.zeros((batch, *shape), np.float32 if name == "depth" else np.uint8)
            for name, shape in settings.shapes.items()
        ]
        self._silence = self._read([0])

    def __contains__(self, slot: int) -> bool:
        return slot in self._walkers

    @torch.no_grad()
    def _read(self, ids: Sequence[int]) -> Words | None:
        """An instruction, alone and filled up to the checkpoint's length."""
        row = np.zeros((1, self.net.settings.text_length), np.int64)
        row[0, : len(ids)] = ids
        counts = np.array([len(ids)])
        return self.net.read(self._send(row), self._send(counts))

    def _send(self, array: NDArray[Any]) -> Tensor:
        return torch.from_numpy(array).to(self.device)

    def begin(self, slot: int, ids: Sequence[int]) -> None:
        """Begin an episode with an instruction of these ids, at least one."""
        self._walkers[slot] = _Walker(self._read(ids), self.net.begin(1)[:, 0])

    @torch.no_grad()
    def step(self, slots: Sequence[int], shown: Sequence[Sequence[NDArray[Any]]]) -> list[int]:
        """Codes of the next actions of at most `batch` slots.

        Args:
            slots: each once.
            shown: pictures of each slot, in the net's order.
        """
        walkers, net, spare = [self._walkers[s] for s in slots], self.net, self.batch - len(slots)
        pictures = []
        for number, black in enumerate(self._black):
            rows = black.copy()
            for row, own in zip(rows, shown, strict=False):
                row[...] = own[number]
            pictures.append(self._send(rows))
        told = [w.words for w in walkers] + [self._silence] * spare
        words = None
        if self._silence is not None:
            words = Words(
                *(torch.cat([getattr(w, n) for w in told]) for n in ("states", "last", "there"))
            )
        empty = net.begin(1)[:, 0]
        memory = torch.stack([w.memory for w in walkers] + [empty] * spare, 1)
        last = self._send(np.array([[w.last for w in walkers] + [-1] * spare], np.int64))
        logits, _, memory = net(words, net.see(pictures), last, memory)
        actions: list[int] = logits[0].argmax(-1)[: len(slots)].tolist()
        for row, (walker, action) in enumerate(zip(walkers, actions, strict=True)):
            walker.memory, walker.last = memory[:, row], action
        return actions


def open_walkers(folder: Path, device: str, batch: int) -> WalkersCma:
    """Agents of a checkpoint.

    Raises:
        ConfigError: torch has no such device.
        CheckpointError: see `load_cma_checkpoint`.
    """
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    if device.split(":")[0] not in ("cpu", "cuda"):
        raise ConfigError(f"no device {device!r}", where="device", remedy="known: cpu, cuda, auto")
    if device.startswith("cuda") and not torch.cuda.is_available():
        raise ConfigError("torch sees no GPU", where="device", remedy="give device=cpu")
    net = load_cma_checkpoint(folder).model.to(device)
    return WalkersCma(net, batch or (BATCH_CARD if device.startswith("cuda") else 1))
