"""A finished policy walks the episodes of a suite, as many at once as a card holds.

    job = WalkJob(checkpoint="out/sft/policy", suite="out/suite")
    walks = examine_policy(job, "out/walks")

Each walk is one of `gn0 bench run --policy bae`, episode for episode, in float32 to the step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import torch

import gn0
from gn0.config import Config
from gn0.device.device import Device
from gn0.device.open import open_device
from gn0.errors import ConfigError
from gn0.missions.controls import Control
from gn0.policies.bae.draws import MOST, check_draw_after
from gn0.policies.bae.policy_bae import digest_checkpoint
from gn0.policies.bae.shipped import find_checkpoint
from gn0.policies.bae.waypoint_plan import Carried, check_carried
from gn0.progress import Progress, no_progress
from gn0.storage import content_hash
from gn0.training.exams.evaluation import ClosedLoop
from gn0.training.exams.walks import Walk
from gn0.training.exams.walks_folder import WalksAbout, open_walks
from gn0.training.pupil import Pupil, load_pupil
from gn0.training.runs.training_state import name_device
from gn0.training.worlds import Lessons, load_lessons, open_world, pick_evenly

Dtype = Literal["auto", "float32", "bfloat16"]


class WalkJob(Config, frozen=True):
    """Which policy walks where, and how.

    Attributes:
        checkpoint: folder of the policy; "" or `bae` for the one in the box.
        suite: folder of the suite.
        splits: of the suite; all when empty.
        control: what is taken away from the policy.
        inputs: in which of its ways the policy is asked, where it was trained in several; its
            default when empty.
        executed: actions of an answer that are carried out; 0: as the policy says.
        draw_after: actions without getting anywhere after which answers are drawn; 0: never, -1: as
            the policy says.
        confirm_stop: a STOP behind the first action of an answer is asked again.
        carried: the actions of an answer, or its waypoints; see `ClosedLoop`.
        episodes: that are walked, evenly over the suite; 0 for all.
        agents: side by side; all are asked in one batch.
        dtype: of what is computed; auto: bfloat16 on a card, else float32.
    """

    checkpoint: str
    suite: str
    splits: tuple[str, ...] = ("val_unseen",)
    control: Control = "none"
    inputs: str = ""
    executed: Annotated[int, msgspec.Meta(ge=0)] = 0
    draw_after: Annotated[int, msgspec.Meta(ge=-1, le=MOST)] = -1
    confirm_stop: bool = False
    carried: Carried = "actions"
    episodes: Annotated[int, msgspec.Meta(ge=0)] = 0
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 1024
    dtype: Dtype = "auto"


def examine_policy(
    job: WalkJob,
    out: Path | str,
    *,
    device: Device | str = "auto",
    fresh: bool = False,
    say: Callable[[str], None] = print,
    progress: Progress = no_progress,
) -> list[Walk]:
    """Walk, or go on where an earlier call stopped.

    Args:
        job: which policy, where and how.
        out: the folder of the walks.
        device: a card; or `host`, the emulation, where the model answers on the CPU.
        fresh: forget what an earlier call left there.
        say: is told what is left out, and that walks were there before.
        progress: is told after each chunk how many walks there are, and how many there will be.

    Returns:
        the walks, in order of the suite's episodes.

    Raises:
        ConfigError: no such split, or more actions are to be carried out than an answer has.
        CheckpointError: the folder is no policy.
        TrainingError: the folder holds other walks, or something else.
        DeviceError, DeviceMemoryError, StorageError: see their texts.
    """
    folder = find_checkpoint(job.checkpoint)
    every = load_lessons(job.suite, job.splits)
    pupil = _choose_input(load_pupil(folder), job.inputs)
    settings = pupil.settings
    if job.executed > settings.form.actions:
        raise ConfigError(
            f"{job.executed} actions of an answer cannot be carried out",
            where="executed",
            remedy=f"give 1 to {settings.form.actions}, or 0 for {settings.executed}",
        )
    check_carried(job.carried, settings.form.points)
    lessons = _leave_out_unspoken(every, pupil, say)
    wanted = pick_evenly(len(lessons.episodes), job.episodes)
    if not wanted:
        raise ConfigError("no episodes to walk", where=job.suite, remedy="choose another split")
    card = open_device(device) if isinstance(device, str) else device
    here = torch.device("cuda" if card.kind == "cuda" else "cpu")
    dtype = job.dtype if job.dtype != "auto" else "bfloat16" if here.type == "cuda" else "float32"
    about = WalksAbout(
        suite=every.suites[0].name,
        suite_hash=every.suites[0].hash,
        splits=job.splits,
        episodes=len(wanted),
        episodes_hash=content_hash(*(lessons.episodes[k].id for k in wanted)),
        left_out=len(every.episodes) - len(lessons.episodes),
        checkpoint=str(job.checkpoint),
        weights=digest_checkpoint(folder),
        control=job.control,
        inputs=job.inputs,
        executed=job.executed or settings.executed,
        draw_after=check_draw_after(job.draw_after, settings.draw_after),
        confirm_stop=job.confirm_stop,
        carried=job.carried,
        agents=min(job.agents, len(wanted)),
        dtype=dtype,
        device=name_device(here),
        version=gn0.__version__,
    )
    with open_walks(out, about, fresh=fresh) as kept:
        if kept.about.finished:
            say(f"walked before: {len(kept.walks)} episodes")
            return kept.walks
        pupil.model.to(here).eval()
        _walk(kept.walks, kept.add, wanted, about, lessons, pupil, card, progress)
        kept.finish()
        return kept.walks


def _walk(
    walks: list[Walk],
    add: Callable[[list[Walk]], None],
    wanted: list[int],
    about: WalksAbout,
    lessons: Lessons,
    pupil: Pupil,
    card: Device,
    progress: Progress,
) -> None:
    """Walk what is wanted beyond the walks that there are, a chunk at a time."""
    if len(walks) == len(wanted):
        return
    world = open_world(lessons, pupil.settings, about.agents, device=card)
    try:
        loop = ClosedLoop(
            world,
            pupil,
            dtype=torch.bfloat16 if about.dtype == "bfloat16" else None,
            executed=about.executed,
            draw_after=about.draw_after,
            confirm_stop=about.confirm_stop,
            carried=about.carried,
        )
        progress("walking", len(walks), len(wanted))
        while len(walks) < len(wanted):
            some = wanted[len(walks) : len(walks) + about.agents]
            add(loop.play(some, control=about.control))
            progress("walking", len(walks), len(wanted))
    finally:
        world.close()


def _choose_input(pupil: Pupil, name: str) -> Pupil:
    """The policy as it is asked in one of its ways; itself when `name` is empty."""
    if not name:
        return pupil
    known: Mapping[str, Pupil] = pupil.inputs  # where it was trained in several
    if name not in known:
        raise ConfigError(
            f"the policy has no input {name!r}",
            where="inputs",
            remedy=f"known: {', '.join(known) or 'its only one; leave the option out'}",
        )
    return known[name]


def _leave_out_unspoken(lessons: Lessons, pupil: Pupil, say: Callable[[str], None]) -> Lessons:
    """The lessons without those whose text does not fit into the policy's prompt.

    Exactly, where `leave_out_long` leaves two tokens of room.
    """
    fits = {text: _fits(text, pupil) for text in dict.fromkeys(lessons.texts)}
    kept = tuple(episode for episode in lessons.episodes if fits[episode.instruction])
    if len(kept) < len(lessons.episodes):
        length = pupil.settings.text_length
        left = len(lessons.episodes) - len(kept)
        say(f"left out {left} episodes: their prompts have more than {length} tokens")
    return replace(lessons, episodes=kept)


def _fits(text: str, pupil: Pupil) -> bool:
    if len(pupil.words.encode(text)) <= pupil.longest_text:
        return True
    try:
        pupil.table([text])
    except ConfigError:
        return False
    return True
