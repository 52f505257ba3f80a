"""Flags that the verbs of `gn0 train` share, and what they all do with them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import tyro

from gn0.cli.comma_lists import split_words
from gn0.cli.reminder import break_silence
from gn0.config import Config

F = TypeVar("F", bound="StageFlags")
Count = Annotated[int, msgspec.Meta(ge=1)]
CountOrNone = Annotated[int, msgspec.Meta(ge=0)]
Seed = Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]  # as torch takes them
Batch = Annotated[int, msgspec.Meta(ge=0, le=65536)]
Rate = Annotated[float, msgspec.Meta(ge=0, le=1)]
Minutes = Annotated[float, msgspec.Meta(ge=0)]
Weight = Annotated[float, msgspec.Meta(ge=0, le=1000)]


class StageFlags(Config, frozen=True, kw_only=True):
    """Flags of every stage; a verb whose own text of one of them is another gives it anew.

    Attributes:
        suite: suite folders, as `gn0 missions generate` writes.
        out: the folder of the run; an interrupted one there goes on.
        exam: the suite to be examined in; the first by default.
        split: splits of the suite to learn from, with commas between; all for all.
        held_out: splits to be examined in, with commas between; empty for none.
        examined: episodes of an examination.
        save: steps from checkpoint to checkpoint; 0 for one at the end.
        examine: steps from examination to examination; 0 for one before the first and one at the
            end.
        seed: of weights, states and order.
        device: auto, cuda, or host (the emulation: slow, for trials).
        fresh: forget what an earlier command left in the output folder, instead of going on.
    """

    suite: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SUITE [SUITE ...]", help_behavior_hint="(required)"),
        msgspec.Meta(min_length=1),
    ]
    out: str
    exam: str = ""
    split: str = "train"
    held_out: str = "val_unseen"
    examined: CountOrNone = 512
    save: CountOrNone = 1000
    examine: CountOrNone = 0
    seed: Seed = 0
    device: str = "auto"
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False

    def list_job(self) -> dict[str, Any]:
        """Fields of the stage's job that these flags say."""
        return {
            "suites": self.suite,
            "exam": self.exam,
            "splits": () if self.split == "all" else split_words(self.split),
            "held_out": split_words(self.held_out),
            "examined": self.examined,
            "seed": self.seed,
        }

    def list_plan(self) -> dict[str, Any]:
        """Fields of the stage's plan that these flags say."""
        return {"save": self.save, "examine": self.examine}


class PolicyFlags(StageFlags, frozen=True, kw_only=True):
    """Flags of every stage that trains GN-BAE; see `StageFlags` for the rest.

    Attributes:
        asked: states of an examination.
        shard_mb: megabytes of a checkpoint's file at most.
        drop_optimiser: leave the optimiser's states out of checkpoints: half of the bytes or
            more, and whoever goes on warms the rate again.
    """

    asked: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 4096
    shard_mb: Count = 2000
    drop_optimiser: bool = False

    def list_job(self) -> dict[str, Any]:
        """See `StageFlags`."""
        return {**super().list_job(), "asked": self.asked}

    def list_plan(self) -> dict[str, Any]:
        """See `StageFlags`."""
        own = {"shard_mb": self.shard_mb, "keep_optimiser": not self.drop_optimiser}
        return {**super().list_plan(), **own}


class ImitationFlags(PolicyFlags, frozen=True, kw_only=True):
    """Flags of stages that learn from the expert's labels; see `PolicyFlags` for the rest.

    Attributes:
        text_length: tokens of instructions, where suites that join may have longer ones than the
            first; still longer ones are left out.
        batch: samples of a step; the recipe's when 0.
        rate: the learning rate; the recipe's when 0.
        stop_weight: of an answer's first STOP; the recipe's when 0.
        agents: that gather states side by side.
        jitter: vary colour and light of the camera's pictures.
        inside: where the goal is a room, metres behind its entrance where labels say STOP; 0: as
            soon as one is in it, so that whoever errs by a hand's breadth stops before the door.
        speed: how steps are computed on a card, as words with commas between: blocks, whole or
            tuned; joined; narrow; beside. `gn0 figures train.speed` compares them; blocks by
            default.
        fsdp: started by torchrun, each card keeps its part of all weights, gradients and optimiser
            states (FSDP2), for a model that does not fit on one; not with --lora, nor where the
            policy drives.
        workers: processes that read a dataset.
        report: steps from report to report.
    """

    text_length: Annotated[int, msgspec.Meta(ge=0, le=4096)] = 0
    batch: Batch = 0
    rate: Rate = 0
    stop_weight: Weight = 0
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 1024
    jitter: bool = False
    inside: Annotated[float, msgspec.Meta(ge=0, le=5)] = 0
    speed: str = ""
    fsdp: bool = False
    workers: Annotated[int, msgspec.Meta(ge=0, le=256)] = 0
    report: Count = 50

    def list_job(self) -> dict[str, Any]:
        """See `StageFlags`."""
        from gn0.training.recipe import parse_speed

        names = ("text_length", "agents", "jitter", "inside", "workers")
        own = {name: getattr(self, name) for name in names}
        speed = parse_speed(split_words(self.speed), fsdp=self.fsdp)
        return {**super().list_job(), **own, "speed": speed}

    def list_plan(self) -> dict[str, Any]:
        """See `StageFlags`."""
        return {**super().list_plan(), "report": self.report}

    def list_recipe(self) -> dict[str, float]:
        """What of the recipe is another than its own."""
        given = {"batch": self.batch, "rate": self.rate, "stop_weight": self.stop_weight}
        return {name: value for name, value in given.items() if value}


def resolve_start(flags: F) -> F:
    """The flags with the policy's own folder in `start`, where that of its run, or `bae`, is given.

    Raises:
        CheckpointError: there is no such folder, or no policy in that of a run yet.
    """
    from gn0.policies.bae.shipped import find_checkpoint

    start = getattr(flags, "start", "")
    return msgspec.structs.replace(flags, start=str(find_checkpoint(start))) if start else flags


def train_stage(
    flags: StageFlags,
    train: Callable[..., Path],
    job: Any,
    *,
    policy: str = "bae",
    note: str = "",
) -> int:
    """Train, and say where the policy lies.

    Args:
        flags: of the verb.
        train: the stage.
        job: of the stage.
        policy: as `gn0 bench run` names it.
        note: is told beside where it lies.
    """
    import os
    import shlex
    import sys

    from gn0.config import check_config

    job, command = check_config(job), sys.argv[1:]
    leads = os.environ.get("RANK", "0") == "0"  # of several processes the first one speaks
    with break_silence(partial(print, flush=True) if leads else _say_nothing) as say:
        how = {"device": flags.device, "fresh": flags.fresh, "command": command, "say": say}
        try:
            made = train(job, flags.out, **how)
        except KeyboardInterrupt:
            say(f"\n{describe_rest(Path(flags.out))}")
            raise
    if not leads:
        return 0
    exam = flags.exam or flags.suite[0]
    print(f"written to {made}{note}")
    words = (exam, "--policy", policy, "--policy-option", f"checkpoint={made}")
    print(f"next: gn0 bench run {shlex.join(words)}")
    return 0


def describe_rest(out: Path) -> str:
    """Where the command of a run that was stopped goes on when it is given again."""
    from gn0.training.runs.run_folder import CHECKPOINTS
    from gn0.training.runs.state_folder import find_latest, read_step

    latest = find_latest(out / CHECKPOINTS)
    if latest is None:
        return "no checkpoint yet (--save): the same command learns from the beginning"
    return f"the same command goes on from step {read_step(latest):,}"


def _say_nothing(line: str) -> None:
    """Nothing."""
