"""DAgger: a policy learns what the expert would do where it gets to by itself (paper, l. 760).

    policy ─ walks ─ N labelled states ─ epochs of all of them ─ loss ─ AdamW ─ OUT/policy

The states are gathered once, by the policy that training goes on from, and then learned from in
epochs, as in the paper. `driver="expert"` gathers as many of the expert's own walks instead: the
control that tells what the policy's states are worth. `dagger_live.py` gathers while it learns.
"""

from __future__ import annotations

import gc
import hashlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import torch
from torch import nn

from gn0.config import load_json
from gn0.device.device import Device
from gn0.errors import CheckpointError, ConfigError
from gn0.missions.controls import CONTROL_TEXT
from gn0.policies.bae.policy_settings import load_policy_settings
from gn0.sim.history import LENGTH as MOSAIC
from gn0.storage import write_json
from gn0.training.imitation import Imitation, ImitationJob, open_imitation
from gn0.training.learner import open_learner
from gn0.training.policy_driver import PolicyDriver, open_driver
from gn0.training.pupil import Pupil, fit_texts, load_pupil
from gn0.training.recipe import RECIPES, Kind, Recipe
from gn0.training.runs.metrics_file import read_metrics
from gn0.training.runs.run_folder import METRICS
from gn0.training.stage import Examine, Stage
from gn0.training.streams.live_counts import share_counts
from gn0.training.streams.picture_jitter import PictureJitter
from gn0.training.streams.samples import Stream
from gn0.training.streams.step_ring import StepRing
from gn0.training.streams.stream_collected import StreamCollected, count_steps
from gn0.training.streams.stream_dataset import StreamDataset
from gn0.training.streams.stream_live import StreamLive
from gn0.training.worlds import leave_out_long, list_maps, load_lessons, open_world

SLOT = re.compile(r"entropy_action_[0-9]+")  # of an examination, in the default input
WALKS = "walks.json"  # how far collecting has come, in the run's folder
VARIOUS = 0.75  # of the collected states that are different: with fewer, what helps is told
STATES: dict[Kind, int] = {"scratch": 300_000, "pretrained": 284_000}
DAGGER_RECIPES: dict[Kind, Recipe] = {
    "scratch": msgspec.structs.replace(RECIPES["scratch"], rate=1e-4),  # a tenth of SFT's
    # the paper's: one rate for the whole model
    "pretrained": msgspec.structs.replace(RECIPES["pretrained"], rate=1e-6, vision_rate=1e-6),
}


class DaggerJob(ImitationJob, frozen=True, kw_only=True):
    """What is learned from states gathered once; see `ImitationJob` for the rest.

    Attributes:
        stage: its name.
        source: `walks` of the agents in the suites, or the samples of a `dataset`, such as
            `gn0 data dagger` collects.
        start: folder of the policy that goes on, and that drives.
        states: gathered, over all processes; rounded up to whole batches.
        epochs: over them.
        driver: who walks.
        beta: chance that the expert drives an agent until the next decision.
        executed: actions of an answer that are carried out; 0: as the policy's settings say.
        stop_share: chance that a wrong STOP is carried out; else the expert's action is.
        rescue: actions that led nowhere after which the expert drives an agent until the next
            decision; 0: never.
    """

    stage: Literal["dagger"] = "dagger"
    source: Literal["walks", "dataset"] = "walks"
    start: Annotated[str, msgspec.Meta(min_length=1)]
    recipe: Recipe = DAGGER_RECIPES["scratch"]
    states: Annotated[int, msgspec.Meta(ge=1, le=2**40)] = STATES["scratch"]
    epochs: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 5
    driver: Literal["policy", "expert"] = "policy"
    beta: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.0
    executed: Annotated[int, msgspec.Meta(ge=0, le=64)] = 0
    stop_share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.2
    rescue: Annotated[int, msgspec.Meta(ge=0, le=10_000)] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.speed.fsdp and not self.reads_dataset:
            raise ConfigError(
                "agents that act with weights that lie in parts",
                where="fsdp",
                remedy="leave out --fsdp, or learn from a dataset (--source dataset)",
            )
        if len(self.joins) > 1 or self.joins[0]:
            raise ConfigError(
                "states that are gathered once, of scenes that join later",
                where="joins",
                remedy="wait for all scenes, or learn live (gn0 train dagger --live)",
            )
        if self.plan.minutes is not None:
            raise ConfigError(
                "a limit of minutes, and epochs that have every state once",
                where="minutes",
                remedy="give states and epochs alone, or learn live (gn0 train dagger --live)",
            )

    @property
    def whole(self) -> int:
        """States that are gathered: whole batches."""
        return -(-self.states // self.recipe.batch) * self.recipe.batch


def train_dagger(
    job: DaggerJob,
    out: Path | str,
    *,
    device: Device | str = "auto",
    fresh: bool = False,
    command: Sequence[str] = (),
    say: Callable[[str], None] = print,
) -> Path:
    """Gather states and learn from them, or go on where an earlier call stopped.

    Nothing is lost or doubled where gathering is interrupted: agents walk again as they had walked,
    by a log of their actions.

    Args:
        job: what is trained, on what and how.
        out: the folder of the run.
        device: a card; or `host`, the emulation, where the model learns on the CPU.
        fresh: forget what an earlier call left there.
        command: words of the command line, for `run.json`.
        say: is told how it goes.

    Returns:
        OUT/policy, as `gn0 bench run --policy bae` loads it.

    Raises:
        ConfigError, CheckpointError: the job makes no sense, or a policy or state is damaged.
        TrainingError: a loss is not finite, or the folder holds another run.
        DeviceError, DeviceMemoryError, StorageError: see their texts.
    """
    settings = load_policy_settings(job.start)

    def hash_corpus() -> str:
        if job.source == "dataset":
            return StreamDataset(job.suites, settings.shown).hash
        return load_lessons(job.lots[0], job.splits).hash

    with open_imitation(
        job, job.stage, out, device=device, fresh=fresh, command=command, say=say,
        hash_corpus=hash_corpus,
    ) as run:  # fmt: skip
        if run.finished is not None:
            return run.policy
        pupil = run.open_pupil(lambda: _load_start(job))
        table = pupil.table([CONTROL_TEXT])  # laid out as those of all episodes
        learner = open_learner(pupil, table, job.recipe, job.speed, run.processes)
        walks = None if run.card is None else _open_walks(job, pupil, run)
        stream = _open_dataset(job, pupil, run) if walks is None else run.jitter(walks)
        samples = job.whole * job.epochs
        if isinstance(stream, StreamDataset):
            samples = sum(int(stream.order.count(epoch).sum()) for epoch in range(job.epochs))
        plan = msgspec.structs.replace(job.plan, samples=samples)
        maker = pupil.maker_of(stream, run.where)
        stage = Stage(
            pupil, learner, stream, maker, plan, run.recipe, run.corpus, mixture=run.mixture
        )
        run.restore(stage)
        examine = run.open_examination(job, pupil, learner)
        if run.state is None:
            found = {} if walks is None else _collect(job, walks, pupil, run)
            begin_examined(stage, run, examine, found)
            if run.processes.leads:
                (run.folder.folder / WALKS).unlink(missing_ok=True)  # step 0 has all of it
        found = stage.run(run.folder, run.say, examine)
        return run.finish(stage, compare_entropy(run, found))


def _load_start(job: DaggerJob) -> Pupil:
    """The policy that goes on, its prompts as long as they are, or as a dataset's texts need."""
    pupil = load_pupil(job.start)
    if job.source == "walks":
        return pupil
    texts = StreamDataset(job.suites, load_policy_settings(job.start).shown).texts
    return fit_texts(pupil, texts, shorten=False)


def _open_dataset(job: DaggerJob, pupil: Pupil, run: Imitation) -> Stream:
    return StreamDataset(
        job.suites,
        pupil.settings.shown,
        map_view=pupil.settings.view,
        map_size=pupil.settings.map_size,
        seed=job.seed,
        blackout=job.recipe.blackout,
        jitter=PictureJitter() if job.jitter else None,
        workers=job.workers,
        rank=run.processes.rank,
        ranks=run.processes.count,
        device=run.where,
    )


def _open_walks(job: DaggerJob, pupil: Pupil, run: Imitation) -> StreamCollected:
    """Agents at the starts of episodes, and room for all states that they will see."""
    every = load_lessons(job.lots[0], job.splits)
    lessons = leave_out_long(every, pupil, run.say).into_areas(job.inside)
    world = open_world(lessons, pupil.settings, job.agents, device=run.card or "auto", say=run.say)
    states, seed = run.processes.share(job.whole), run.processes.seed(job.seed)
    steps = max(MOSAIC + 1, count_steps(states, job.agents))
    ring = StepRing(world, steps, **list_maps(pupil.settings))
    live = StreamLive(world, ring, seed=seed, stop_share=job.stop_share, rescue=job.rescue)
    return StreamCollected(live, states, seed=seed, dark=job.recipe.blackout)


def _collect(
    job: DaggerJob, walks: StreamCollected, pupil: Pupil, run: Imitation
) -> dict[str, float]:
    """Let agents walk until all states are there, or go on with that; tells what came of it."""
    file, processes = run.folder.folder / WALKS, run.processes
    whose = f"{job.driver} {hash_weights(pupil.model)}"
    _go_on(walks, file, whose, run)
    live = walks.live
    driver: PolicyDriver | None = None
    if job.driver == "policy" and job.beta < 1:
        dtype = torch.bfloat16 if run.where.type == "cuda" else None
        driver = open_driver(pupil, job.agents, executed=job.executed, dtype=dtype)
        live.driver, live.beta = driver.enter(pupil.maker_of(walks, run.where)), _hold(job.beta)
        live.drawing = driver.drawing

    def save() -> None:
        streams = processes.gather(walks.state(), run.where)
        if processes.leads:
            write_json(file, {"whose": whose, "streams": streams})
        run.say(f"collecting: step {live.ring.count:,} of {walks.steps:,}")

    counts = walks.collect(save)
    live.driver = driver = None
    _give_back(run.where)  # its memory is the learner's now
    different, episodes = walks.count_variety()
    shares = {"different": different / walks.states, "collected_episodes": float(episodes)}
    means = processes.mean(asdict(counts) | shares, run.where)
    found = share_counts(means) | {
        "different": means["different"],
        "collected": float(job.whole),
        "collected_episodes": means["collected_episodes"] * processes.count,
    }
    text = ", ".join(
        f"{name.removeprefix('walks_').replace('_', ' ')} {share:.1%}"
        for name, share in share_counts(means).items()
        if not math.isnan(share)
    )
    text = (
        f"collected {job.whole:,} states of the {job.driver}'s walks, {found['different']:.0%} of "
        f"them different, in {found['collected_episodes']:,.0f} episodes: {text}"
    )
    run.say(text)
    if found["different"] < VARIOUS:
        run.say(
            "many of these are alike, as of agents at a wall, and a policy that learns from them "
            "may forget: --rescue 16 lets the expert drive such agents on, more --agents begin "
            "more episodes, and with --beta the expert drives now and then"
        )
    run.folder.log(text)
    return found


def _give_back(where: torch.device) -> None:
    """Memory of what nobody holds any more, whatever holds itself included."""
    gc.collect()
    if where.type == "cuda":
        torch.cuda.empty_cache()


def _hold(beta: float) -> Callable[[int], float]:
    return lambda drawn: beta


def _go_on(walks: StreamCollected, file: Path, whose: str, run: Imitation) -> None:
    """Go on with what a run that was stopped had collected.

    Raises:
        CheckpointError: another policy, or another number of processes, had collected it.
    """
    if not file.is_file():
        return
    kept = load_json(file, dict[str, Any])
    if kept.get("whose") != whose:
        raise CheckpointError(
            "another policy had begun to collect states here",
            where=file,
            remedy="give the policy of before, or --fresh",
        )
    streams = kept.get("streams", [])
    if len(streams) != run.processes.count:
        raise CheckpointError(
            f"{len(streams)} processes had begun to collect states, here are {run.processes.count}",
            where=file,
            remedy="go on with as many, or give --fresh",
        )
    walks.restore(streams[run.processes.rank])
    run.say(f"goes on collecting at step {walks.live.ring.count:,} of {walks.steps:,}")


def begin_examined(
    stage: Stage, run: Imitation, examine: Examine | None, found: Mapping[str, float]
) -> None:
    """Examine the policy before its first step, and save the state of step 0."""
    before = dict(examine()) if examine is not None else {}
    if before:
        run.say(f"before the first step: entropy {before['entropy']:.3f}")
    stage.begin(run.folder, {**found, **before})


def compare_entropy(run: Imitation, found: Mapping[str, float]) -> dict[str, float]:
    """What was found at the end, with the entropy before the first step; both are logged."""
    if "entropy" not in found:
        return dict(found)
    first = read_metrics(run.folder.folder / METRICS)[0]

    def recall(name: str) -> float:
        value = first.get(name) if first["step"] == 0 else None
        return math.nan if value is None else float(value)  # nought is a value

    before = recall("entropy")
    text = f"entropy {before:.3f} before, {found['entropy']:.3f} after"
    slots = [name for name in found if SLOT.fullmatch(name)]
    if slots:
        text += f"; by action {' '.join(f'{found[name]:.3f}' for name in slots)}"
    run.say(text)
    run.folder.log(text)
    return {**found, "entropy_before": before, **{f"{n}_before": recall(n) for n in slots}}


def hash_weights(model: nn.Module) -> str:
    """SHA-256 of a model's weights, names and all."""
    digest = hashlib.sha256()
    for name, weight in sorted(model.named_parameters()):
        digest.update(f"{name} {weight.dtype} {tuple(weight.shape)}".encode())
        raw = weight.detach().cpu().contiguous().flatten().view(torch.uint8)
        digest.update(raw.numpy().tobytes())
    return digest.hexdigest()
