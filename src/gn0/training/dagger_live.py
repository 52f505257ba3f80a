"""DAgger at scale: the policy in training drives the agents whose states it learns from.

    suites ─ agents, driven by the policy or, less and less, by the expert ─ ring ─ loss ─ AdamW
       ╰──────────────── the same model, one step further ────────────────╯

The ring of states is refilled while the model learns, so what it learns from is where it gets to
now. The paper collects once (`dagger.py`); this stage has a name of its own, and neither goes on
from a state of the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from gn0.device.device import Device
from gn0.errors import ConfigError
from gn0.missions.controls import CONTROL_TEXT
from gn0.policies.bae.draws import MOST, check_draw_after
from gn0.policies.bae.policy_settings import PolicySettings, load_policy_settings
from gn0.sim.history import LENGTH as MOSAIC
from gn0.training.dagger import begin_examined, compare_entropy
from gn0.training.imitation import Imitation, ImitationJob, open_imitation
from gn0.training.learner import Learner, open_learner
from gn0.training.lessons_live import check_lessons
from gn0.training.policy_driver import PolicyDriver, open_driver
from gn0.training.pupil import Pupil, ask_anew, build_pupil, check_going_on, load_pupil
from gn0.training.stage import Stage
from gn0.training.streams.live_counts import share_counts
from gn0.training.streams.samples import Stream
from gn0.training.streams.step_ring import StepRing
from gn0.training.streams.stream_growing import StreamGrowing
from gn0.training.streams.stream_live import Driver, StreamLive, count_confirmed
from gn0.training.worlds import Lessons, list_maps, load_lessons, open_world

Samples = Annotated[int, msgspec.Meta(ge=0)]


class DaggerLiveJob(ImitationJob, frozen=True, kw_only=True):
    """What is learned from states that the policy in training visits; see `ImitationJob`.

    Attributes:
        stage: its name.
        start: folder of a policy to go on from; a model of random weights when empty, of
        size: its size, and
        settings: what it is shown and asked; as the policy that goes on was when None.
        kept: states that batches are drawn from.
        ratio: new states a sample.
        executed: actions of an answer that are carried out; 0: as the settings say.
        acts: with the weights as they are now, or with the averaged ones.
        beta_from, beta_to: samples at which the expert, who drives all agents at first, begins to
            give them up, and at which the policy drives all.
        stop_share: chance that a wrong STOP is carried out; else the expert's action is.
        confirm_stop: a STOP behind the first action of an answer is asked again.
        draw_after: actions without getting anywhere after which answers are drawn, when the policy
            drives and is examined, and in its settings; 0: never, -1: as the settings say.
    """

    stage: Literal["dagger_live"] = "dagger_live"
    start: str = ""
    size: str = "tiny"
    settings: PolicySettings | None = None
    kept: Annotated[int, msgspec.Meta(ge=1)] = 200_000
    ratio: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.5
    executed: Annotated[int, msgspec.Meta(ge=0, le=64)] = 0
    acts: Literal["current", "averaged"] = "current"
    beta_from: Samples = 250_000
    beta_to: Samples = 2_500_000
    stop_share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.2
    confirm_stop: bool = False
    draw_after: Annotated[int, msgspec.Meta(ge=-1, le=MOST)] = -1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.speed.fsdp:
            raise ConfigError(
                "agents that act with weights that lie in parts",
                where="fsdp",
                remedy="leave out --fsdp, or learn from a dataset (without --live)",
            )
        if self.beta_to < self.beta_from:
            raise ConfigError(
                f"beta falls from {self.beta_from} to {self.beta_to} samples",
                where="beta_to",
                remedy="give as many as beta_from, or more",
            )
        if not self.start and self.settings is None:
            raise ConfigError(
                "random weights without settings: nobody says what the policy is shown and asked",
                where="settings",
                remedy="give `settings`, or `start` to go on as that policy was",
            )

    def beta(self, samples: int) -> float:
        """Chance that the expert drives an agent, after so many samples of all processes."""
        if samples < self.beta_from:
            return 1.0
        if samples >= self.beta_to:
            return 0.0
        return (self.beta_to - samples) / (self.beta_to - self.beta_from)


def train_dagger_live(
    job: DaggerLiveJob,
    out: Path | str,
    *,
    device: Device | str = "auto",
    fresh: bool = False,
    command: Sequence[str] = (),
    say: Callable[[str], None] = print,
) -> Path:
    """Walk and learn, or go on where an earlier call stopped.

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
    if job.start and job.settings is not None:
        check_going_on(job.start, job.settings)
    _check_mixture(job)
    with open_imitation(
        job, job.stage, out, device=device, fresh=fresh, command=command, say=say,
        hash_corpus=lambda: load_lessons(job.lots[0], job.splits).hash,
    ) as run:  # fmt: skip
        if run.finished is not None:
            return run.policy
        pupil = run.open_pupil(lambda: _make_pupil(job, run))
        table = pupil.table([CONTROL_TEXT])  # laid out as those of all episodes
        learner = open_learner(pupil, table, job.recipe, job.speed, run.processes)
        walks = _open_walks(job, pupil, learner, run)
        stream = run.jitter(walks)
        maker = pupil.maker_of(stream, run.where)
        stage = Stage(
            pupil, learner, stream, maker, job.plan, run.recipe, run.corpus, mixture=run.mixture
        )
        run.restore(stage)
        examine = run.open_examination(job, pupil, learner)
        if run.state is None:
            begin_examined(stage, run, examine, {})

        def watch() -> dict[str, float]:
            counts = run.processes.mean(asdict(walks.tell()), run.where)
            beta = job.beta(walks.drawn * run.processes.count)
            return {**share_counts(counts), "beta": beta, **run.count_suites(walks)}

        found = stage.run(run.folder, run.say, examine, watch)
        return run.finish(stage, compare_entropy(run, found))


def _check_mixture(job: DaggerLiveJob) -> None:
    """Refuse shares of inputs that the policy does not have; none: it learns its default alone."""
    own = job.settings or load_policy_settings(job.start)
    if job.inputs and job.inputs.keys() != own.by_input.keys():
        raise ConfigError(
            f"a mixture of {', '.join(job.inputs)} for a policy with inputs "
            f"{', '.join(own.by_input) or 'without a name'}",
            where="inputs",
            remedy="give a share for each of the policy's inputs, or settings that have these",
        )


def _make_pupil(job: DaggerLiveJob, run: Imitation) -> Pupil:
    pupil = _load_pupil(job, run)
    drawn = check_draw_after(job.draw_after, pupil.settings.draw_after)
    return replace(pupil, settings=msgspec.structs.replace(pupil.settings, draw_after=drawn))


def _load_pupil(job: DaggerLiveJob, run: Imitation) -> Pupil:
    if job.start and job.settings is not None:
        return ask_anew(job.start, job.settings, run.load_texts())
    if job.start:
        return load_pupil(job.start)
    assert job.settings is not None  # checked by the job
    return build_pupil(job.size, job.settings, run.load_texts(), seed=job.seed)


def _open_walks(
    job: DaggerLiveJob, pupil: Pupil, learner: Learner, run: Imitation
) -> StreamGrowing:
    """Agents that the model drives as it is when they decide; joined by scenes, by the same one.

    Where it learns several inputs, it drives by each of them. Every driver has a CUDA graph of its
    own, with static buffers for all agents' pictures and answers, as long as the run lasts: with
    `confirm_stop` that is 9/8 times as much for each input.
    """
    processes = run.processes
    dtype = learner.autocast
    weights = learner.averaged_weights if job.acts == "averaged" else nullcontext
    driving = {name: pupil.inputs[name] for name in job.inputs or [pupil.settings.input]}

    def open_drivers(agents: int) -> dict[str, PolicyDriver]:
        return {
            name: open_driver(one, agents, executed=job.executed, dtype=dtype, weights=weights)
            for name, one in driving.items()
        }

    drivers = open_drivers(job.agents)
    # by the longest answer of any input
    drawing = max((one.drawing for one in drivers.values()), key=lambda d: d.slots if d else 0)
    again = open_drivers(count_confirmed(job.agents)) if job.confirm_stop else None

    def open_part(lessons: Lessons, begun: int, seed: int) -> Stream:
        check_lessons(lessons.episodes)
        world = open_world(
            lessons, pupil.settings, job.agents, device=run.card or "auto", say=run.say
        )
        steps = max(MOSAIC + 1, -(-job.kept // job.agents))
        ring = StepRing(world, steps, **list_maps(pupil.settings))
        texts = [episode.mission.instruction for episode in world.episodes]
        makers = {
            name: one.maker(texts, run.where, lambda: ring.frames) for name, one in driving.items()
        }

        def enter(those: Mapping[str, PolicyDriver]) -> Driver | Mapping[str, Driver]:
            entered = {name: one.enter(makers[name]) for name, one in those.items()}
            return entered if job.inputs else next(iter(entered.values()))

        return StreamLive(
            world, ring, seed=seed, ratio=job.ratio, driver=enter(drivers),
            inputs=job.inputs or None,
            beta=lambda drawn: job.beta((begun + drawn) * processes.count),
            stop_share=job.stop_share, confirm=None if again is None else enter(again),
            drawing=drawing,
            dark=job.recipe.blackout, lazy=bool(job.inputs),
        )  # fmt: skip

    return run.open_growing(pupil, open_part)
