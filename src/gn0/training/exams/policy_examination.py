"""A finished policy walks the episodes of a suite, as many at once as a card holds.

    job = WalkJob(checkpoint="out/sft/policy", suite="out/suite")
    walks = examine_policy(job, "out/walks")

Each walk is one of `gn0 bench run --policy bae`, or `cma` for a recurrent baseline, episode for
episode, in float32 to the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

import gn0
from gn0.counted import counted
from gn0.device.device import Device
from gn0.errors import ConfigError
from gn0.progress import Progress, no_progress
from gn0.storage import content_hash
from gn0.training.exams.examined import Examined, open_examined
from gn0.training.exams.walk_job import WalkJob
from gn0.training.exams.walks import Walk
from gn0.training.exams.walks_folder import WalksAbout, WalksFolder, open_walks
from gn0.training.runs.training_state import name_device
from gn0.training.worlds import Lessons, load_lessons, open_card, open_world, pick_evenly


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
        progress: is told how many walks there are, and how many there will be.

    Returns:
        the walks, in order of the suite's episodes.

    Raises:
        ConfigError: no such split, or more actions are to be carried out than an answer has.
        CheckpointError: the folder is no policy.
        TrainingError: the folder holds other walks, or something else.
        DeviceError, DeviceMemoryError, StorageError: see their texts.
    """
    every = load_lessons(job.suite, job.splits)
    policy = open_examined(job)
    lessons = _leave_out_unspoken(every, policy, say)
    wanted = pick_evenly(len(lessons.episodes), job.episodes)
    if not wanted:
        raise ConfigError("no episodes to walk", where=job.suite, remedy="choose another split")
    card = open_card(device)
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
        weights=policy.weights,
        control=job.control,
        inputs=job.inputs,
        executed=policy.executed,
        draw_after=policy.draw_after,
        confirm_stop=job.confirm_stop,
        carried=job.carried,
        agents=min(job.agents, len(wanted)),
        dtype=dtype,
        device=name_device(here),
        version=gn0.__version__,
    )
    with open_walks(out, about, fresh=fresh) as kept:
        if kept.about.finished:
            say(f"walked before: {counted(len(kept.walks), 'episode')}")
            return kept.walks
        _walk(kept, wanted, lessons, policy, card, progress)
        kept.finish([lessons.episodes[k].id for k in wanted])
        return kept.walks


def _walk(
    kept: WalksFolder,
    wanted: list[int],
    lessons: Lessons,
    policy: Examined,
    card: Device,
    progress: Progress,
) -> None:
    """Walk what is wanted beyond the walks that there are."""
    before = {walk.episode for walk in kept.walks}
    left = [k for k in wanted if lessons.episodes[k].id not in before]
    if not left:
        return
    about = kept.about
    world = open_world(lessons, policy.settings, about.agents, device=card)
    try:
        loop = policy.open_loop(world, torch.bfloat16 if about.dtype == "bfloat16" else None)
        loop.play(
            left,
            control=about.control,
            keep=kept.add,
            progress=lambda stage, done, _: progress(stage, len(before) + done, len(wanted)),
        )
    finally:
        world.close()


def _leave_out_unspoken(lessons: Lessons, policy: Examined, say: Callable[[str], None]) -> Lessons:
    """The lessons without those whose text does not fit into what the policy reads."""
    fits = {text: policy.fits(text) for text in dict.fromkeys(lessons.texts)}
    kept = tuple(episode for episode in lessons.episodes if fits[episode.instruction])
    if len(kept) < len(lessons.episodes):
        left = len(lessons.episodes) - len(kept)
        say(f"left out {counted(left, 'episode')}: prompts of more than {policy.length} tokens")
    return replace(lessons, episodes=kept)
