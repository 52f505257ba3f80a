"""Several processes that train one model, each on its share of every batch.

`torchrun --nproc-per-node N -m gn0 train …` or `accelerate launch` start them; each finds in its
environment which one it is. The first writes; gradients are averaged (DDP), so all have the same
weights at every step. What they say to each other is JSON and numbers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, TypeVar, cast
from warnings import catch_warnings, simplefilter
from weakref import WeakSet

import msgspec
import torch
from torch import distributed, nn
from torch.nn.parallel import DistributedDataParallel

from gn0.device.device import Device
from gn0.errors import ConfigError, TrainingError
from gn0.seeds import derive_seed
from gn0.training.runs.run_folder import RunFolder, open_run

T = TypeVar("T")
_PATIENCE = timedelta(hours=2)  # the others wait while the first examines the policy
_AVERAGED: WeakSet[DistributedDataParallel] = WeakSet()
_AT_END: list[Callable[[], None]] = []  # let go of the group, where others hold it


@dataclass(frozen=True)
class Processes:
    """Which process this is.

    Attributes:
        rank: from 0; the first one writes.
        count: of how many.
        local: which of this machine, and of its cards.
    """

    rank: int = 0
    count: int = 1
    local: int = 0

    @property
    def leads(self) -> bool:
        """Whether this is the one that writes."""
        return self.rank == 0

    def name_card(self, device: Device | str) -> Device | str:
        """This process' own card, where a device is not named more closely."""
        if self.count == 1 or device not in ("auto", "cuda") or not torch.cuda.is_available():
            return device
        return f"cuda:{self.local}"

    def share(self, samples: int) -> int:
        """This process' part of so many samples.

        Raises:
            ConfigError: they cannot be shared out evenly.
        """
        if samples % self.count:
            raise ConfigError(
                f"a batch of {samples} for {self.count} processes",
                where="batch",
                remedy=f"give a multiple of {self.count}",
            )
        return samples // self.count

    def seed(self, seed: int) -> int:
        """A seed of this process' own; the same one where it is alone."""
        return derive_seed(seed, "process", self.rank) if self.count > 1 else seed

    def average(self, loss: nn.Module, *, whole: bool = True) -> nn.Module:
        """The module, its gradients averaged over all processes, its weights the first one's.

        Args:
            loss: its weights are all used, unless not `whole`.
            whole: whether every weight has a gradient in each step.
        """
        if self.count == 1:
            return loss
        if next(loss.parameters()).is_cuda:
            # else blocks that are compiled are cut up where a bucket of gradients is full
            torch._dynamo.config.optimize_ddp = False
        with catch_warnings():  # of torch 2.13: the flag has a successor for all but this value
            simplefilter("ignore", FutureWarning)
            averaged = DistributedDataParallel(
                loss,
                gradient_as_bucket_view=True,
                find_unused_parameters=not whole,
                broadcast_buffers=False,  # they are constants
            )
        _AVERAGED.add(averaged)
        return averaged

    def mean(self, values: Mapping[str, float], device: torch.device) -> dict[str, float]:
        """Means over all processes, the same in each."""
        if self.count == 1:
            return dict(values)
        sums = torch.tensor([*values.values()], dtype=torch.float64, device=device)
        self.ask(lambda: distributed.all_reduce(sums))
        return dict(zip(values, (sums / self.count).tolist(), strict=True))

    def gather(self, value: Any, device: torch.device) -> list[Any]:
        """The JSON values of all processes, in their order; each is told all of them."""
        if self.count == 1:
            return [value]
        raw = bytearray(msgspec.json.encode(value))
        sizes = [torch.zeros(1, dtype=torch.int64, device=device) for _ in range(self.count)]
        own = torch.tensor([len(raw)], device=device)
        self.ask(lambda: distributed.all_gather(sizes, own))
        longest = int(torch.stack(sizes).max())
        text = torch.zeros(longest, dtype=torch.uint8, device=device)
        text[: len(raw)] = torch.frombuffer(raw, dtype=torch.uint8).to(device)
        texts = [torch.empty_like(text) for _ in range(self.count)]
        self.ask(lambda: distributed.all_gather(texts, text))
        return [
            msgspec.json.decode(one[: int(size)].cpu().numpy().tobytes())
            for one, size in zip(texts, sizes, strict=True)
        ]

    def ask(self, call: Callable[[], T]) -> T:
        """What a call gives that all processes make together.

        Raises:
            TrainingError: one of them is gone.
        """
        try:
            return call()
        except torch.OutOfMemoryError:
            raise
        except RuntimeError as error:
            if self.count == 1:
                raise
            raise TrainingError(
                "another process of this run is gone",
                where=f"process {self.rank} of {self.count}",
                remedy="see what it said last; the same command goes on from the last checkpoint",
            ) from error


ALONE = Processes()


@contextmanager
def join_processes(device: Device | str = "auto") -> Iterator[Processes]:
    """Meet the other processes that the environment speaks of, until the block ends.

    Args:
        device: `host` for gloo; else each takes the card of its number (NCCL) where torch finds
            cards.

    Raises:
        ConfigError: fewer cards than processes.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1 or distributed.is_initialized():
        yield ALONE
        return
    own = Processes(int(os.environ["RANK"]), count, int(os.environ.get("LOCAL_RANK", "0")))
    kind = device if isinstance(device, str) else device.kind
    on_card = torch.cuda.is_available() and kind != "host"
    if on_card:
        if own.local >= torch.cuda.device_count():
            raise ConfigError(
                f"process {own.local} of a machine with {torch.cuda.device_count()} cards",
                remedy="start as many processes as there are cards",
            )
        torch.cuda.set_device(own.local)
    distributed.init_process_group("nccl" if on_card else "gloo", timeout=_PATIENCE)
    try:
        yield own
        # not after an error: it would wait for the others
        # nobody leaves while another still writes
        distributed.barrier(device_ids=[own.local] if on_card else None)
    finally:
        _release_reducers()
        while _AT_END:
            _AT_END.pop()()
    distributed.destroy_process_group()


def call_at_end(release: Callable[[], None]) -> None:
    """Let something that holds the processes' group let go of it, before the group is closed.

    Threads of gloo last as long as anything holds the group. One that drops its last tensor while
    the interpreter is ending aborts the process, whose work was done.
    """
    _AT_END.append(release)


def _release_reducers() -> None:
    """Let go of what averages gradients, while the group is still held by others.

    A reducer that is the last to hold its group closes it without giving up the interpreter's lock,
    and waits for threads of gloo that want that lock to let go of tensors: it hangs for ever.
    """
    for averaged in tuple(_AVERAGED):
        del averaged.reducer, averaged.logger, averaged.process_group
        _AVERAGED.discard(averaged)


@contextmanager
def open_run_together(
    processes: Processes, where: torch.device, out: Path | str, **options: Any
) -> Iterator[RunFolder]:
    """`open_run` in the first process; the others see what it found, and write nothing.

    Raises:
        TrainingError, StorageError: see `open_run`.
    """
    if processes.leads:
        with open_run(out, processes=processes.count, **options) as folder:
            told = (str(folder.resumed or ""), folder.notes, folder.finished)
            processes.gather(told, where)
            yield folder
        return
    resumed, notes, finished = processes.gather(None, where)[0]
    followed = FolderFollowed(Path(out), Path(resumed) if resumed else None, notes, finished)
    yield cast(RunFolder, followed)


@dataclass
class FolderFollowed:
    """The run's folder, as processes that do not write see it; see `RunFolder`."""

    folder: Path
    resumed: Path | None = None
    notes: tuple[str, ...] = ()
    finished: int | None = None

    def report(self, step: int, values: Mapping[str, float]) -> None:
        """Nothing."""

    def log(self, text: str) -> None:
        """Nothing."""

    def save(self, state: Any, **options: Any) -> Path:
        """Nothing; where states lie."""
        return self.folder

    def finish(self, step: int, results: Mapping[str, Any] | None = None) -> None:
        """Nothing."""
