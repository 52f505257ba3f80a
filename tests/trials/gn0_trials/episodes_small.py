"""A policy of random weights in two flats, and RL on their episodes that a CPU can run.

`python -m gn0_trials.episodes_small SUITE START OUT UPDATES` is such a run, for several processes.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import msgspec
import torch

from gn0.data.answer_form import AnswerForm
from gn0.device.host import DeviceHost
from gn0.policies.bae.policy_settings import PolicySettings
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.training.episode_rl import EpisodeJob, open_stage, train_episode_rl
from gn0.training.processes import ALONE
from gn0.training.pupil import Pupil, build_pupil, load_pupil
from gn0.training.rl.episode_recipe import EpisodePlan, EpisodeRecipe
from gn0.training.rl.episode_stage import EpisodeStage
from gn0.training.worlds import load_lessons

SETTINGS = PolicySettings(
    prompt="short",
    pictures=("near",),
    form=AnswerForm(layout="compact"),
    view=MapView(squares=(EgoSquare(32, 0.24, content="occupancy"),)),
)
RECIPE = EpisodeRecipe(
    episodes=2, group=3, max_steps=12, minibatches=2, batch=8, rate=1e-3, warm_updates=0
)


def build_walker(texts: list[str], *, points: int = 13, seed: int = 3) -> Pupil:
    """A policy of random weights, far enough from even chances that its walks differ."""
    form = AnswerForm(points=points, layout="compact")
    pupil = build_pupil("nano", msgspec.structs.replace(SETTINGS, form=form), texts, seed=seed)
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        for weight in pupil.model.parameters():
            weight.add_(0.05 * torch.randn_like(weight))
    return pupil


def make_job(suite: Path | str, start: Path | str, updates: int = 2, **recipe: Any) -> EpisodeJob:
    """A short run without examinations."""
    return EpisodeJob(
        suites=(str(suite),),
        start=str(start),
        splits=(),
        held_out=(),
        recipe=msgspec.structs.replace(RECIPE, **recipe),
        plan=EpisodePlan(updates=updates, save=1),
    )


def open_small(job: EpisodeJob) -> EpisodeStage:
    """The stage of a job before its first update."""
    lessons = load_lessons(job.suites, job.splits)
    pupil = load_pupil(job.start)
    return open_stage(
        job, pupil, lessons, DeviceHost(), processes=ALONE, recipe={}, say=lambda _: None
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    train_episode_rl(
        make_job(sys.argv[1], sys.argv[2], int(sys.argv[4])), sys.argv[3], device="host"
    )
