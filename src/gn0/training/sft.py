"""SFT: a model learns what the expert would do, from labelled states (paper, l. 736).

    suite or dataset ─ stream ─ prompts and answers ─ loss ─ AdamW ─ averaged weights ─ OUT/policy

Sources of states: `walks`, those of the expert's own walks, as in the paper; `uniform`, anywhere;
or the samples of a dataset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from gn0.device.device import Device
from gn0.errors import ConfigError
from gn0.policies.bae.checkpoint import load_checkpoint
from gn0.policies.bae.policy_settings import PolicySettings, holds_policy
from gn0.sim.history import LENGTH as MOSAIC
from gn0.training.imitation import Imitation, ImitationJob, open_imitation
from gn0.training.learner import open_learner
from gn0.training.pupil import Pupil, ask_anew, build_pupil, check_going_on, fit_texts, open_pupil
from gn0.training.stage import Stage, Watch
from gn0.training.streams.picture_jitter import PictureJitter
from gn0.training.streams.samples import Stream
from gn0.training.streams.step_ring import StepRing
from gn0.training.streams.stream_dataset import StreamDataset
from gn0.training.streams.stream_live import StreamLive
from gn0.training.streams.stream_uniform import StreamUniform
from gn0.training.worlds import Lessons, list_maps, load_lessons, open_world

Source = Literal["walks", "uniform", "dataset"]


class SftJob(ImitationJob, frozen=True, kw_only=True):
    """What is trained, on what, and how; see `ImitationJob` for the rest.

    Attributes:
        source: where states come from.
        size: of a model from random weights; or
        start: the folder of a policy or of a Qwen3-VL to go on from.
        settings: what the policy is shown and asked.
        shares: of the samples, one a dataset; by their sizes when empty.
        kept: states of walks that batches are drawn from.
        ratio: new states of walks a sample.
    """

    source: Source = "walks"
    size: str = "tiny"
    start: str = ""
    settings: PolicySettings
    shares: tuple[float, ...] = ()
    kept: Annotated[int, msgspec.Meta(ge=1)] = 200_000
    ratio: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.shares and (self.source != "dataset" or len(self.shares) != len(self.suites)):
            raise ConfigError(
                f"{len(self.shares)} shares of samples",
                where="shares",
                remedy="give one a dataset, with --source dataset",
            )
        names = set(self.settings.by_input) if self.settings.inputs else set()
        if set(self.inputs) != names:
            raise ConfigError(
                f"shares of {', '.join(self.inputs) or 'nothing'} for inputs "
                f"{', '.join(sorted(names)) or 'without a name'}",
                where="inputs",
                remedy="give one for each of the settings' inputs",
            )


def train_sft(
    job: SftJob,
    out: Path | str,
    *,
    device: Device | str = "auto",
    fresh: bool = False,
    command: Sequence[str] = (),
    say: Callable[[str], None] = print,
) -> Path:
    """Train, or go on where an earlier call stopped.

    Args:
        job: what is trained, on what and how.
        out: the folder of the run.
        device: a card; or `host`, the emulation, where the model learns on the CPU. Samples of a
            dataset are learned on a card where torch finds one, else on the CPU.
        fresh: forget what an earlier call left there.
        command: words of the command line, for `run.json`.
        say: is told how it goes.

    Returns:
        OUT/policy, as `gn0 bench run --policy bae` loads it.

    Raises:
        ConfigError, CheckpointError: the job makes no sense, or a state is damaged.
        TrainingError: a loss is not finite, or the folder holds another run.
        DeviceError, DeviceMemoryError, StorageError: see their texts.
    """
    if job.start and holds_policy(job.start):
        check_going_on(job.start, job.settings)
    with open_imitation(
        job, "sft", out, device=device, fresh=fresh, command=command, say=say,
        hash_corpus=lambda: _hash_corpus(job),
    ) as run:  # fmt: skip
        if run.finished is not None:
            return run.policy
        pupil = run.open_pupil(lambda: _make_pupil(job, run))
        stream, watch = _open_stream(job, pupil, run)
        maker = pupil.maker_of(stream, run.where)
        learner = open_learner(pupil, maker.table, job.recipe, job.speed, run.processes)
        stage = Stage(
            pupil, learner, stream, maker, job.plan, run.recipe, run.corpus, mixture=run.mixture
        )
        run.restore(stage)
        examine = run.open_examination(job, pupil, learner)
        found = stage.run(run.folder, run.say, examine, watch)
        return run.finish(stage, found)


def _hash_corpus(job: SftJob) -> str:
    """Of what is there at the first sample; the others' hashes are in the stream's state."""
    if job.source == "dataset":
        return StreamDataset(job.suites, job.settings.shown, shares=job.shares or None).hash
    return load_lessons(job.lots[0], job.splits).hash


def _make_pupil(job: SftJob, run: Imitation) -> Pupil:
    if job.source == "dataset":
        texts = StreamDataset(job.suites, job.settings.shown).texts
    else:
        texts = run.load_texts()
    if job.start and holds_policy(job.start):
        pupil = ask_anew(job.start, job.settings, texts)
        return fit_texts(pupil, texts, shorten=False) if job.source == "dataset" else pupil
    if job.start:
        base = load_checkpoint(job.start, grow=True)
        return fit_texts(open_pupil(base, job.settings), texts)
    return build_pupil(job.size, job.settings, texts, seed=job.seed)


def _open_stream(job: SftJob, pupil: Pupil, run: Imitation) -> tuple[Stream, Watch | None]:
    """What is learned from, and what reports tell of it."""
    if run.card is None:
        read = StreamDataset(
            job.suites,
            job.settings.shown,
            shares=job.shares or None,
            map_view=job.settings.view,
            map_size=job.settings.map_size,
            seed=job.seed,
            blackout=job.recipe.blackout,
            jitter=PictureJitter() if job.jitter else None,
            workers=job.workers,
            rank=run.processes.rank,
            ranks=run.processes.count,
            device=pupil.model.device,
        )
        return read, None

    def open_part(lessons: Lessons, begun: int, seed: int) -> Stream:
        world = open_world(
            lessons, pupil.settings, job.agents, device=run.card or "auto", say=run.say
        )
        shown = list_maps(pupil.settings)
        if job.source == "uniform":
            return StreamUniform(world, seed=seed, **shown)
        steps = max(MOSAIC + 1, -(-job.kept // job.agents))
        ring = StepRing(world, steps, **shown)
        lazy = bool(job.inputs)  # a step does not show what other inputs do
        dark = job.recipe.blackout
        return StreamLive(world, ring, seed=seed, ratio=job.ratio, dark=dark, lazy=lazy)

    growing = run.open_growing(pupil, open_part)
    return run.jitter(growing), lambda: run.count_suites(growing)
