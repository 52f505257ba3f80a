"""Recurrent baselines: CMA and Seq2Seq, retrained, small, on the states that GN-BAE learns from.

    suite ─ N agents walk T steps ─ loss ─ Adam ─ next T steps … ─ OUT/policy
            └ the expert drives; then, in rounds, the policy as it was at their beginning, too

Teacher forcing, then DAgger with p = 0.75, as VLN-CE trains them (https://arxiv.org/abs/2004.02857),
but for what a simulator beside the learner allows: encoders learn, too; walks are ever new instead
of stored; and the gradient goes back T steps, with hidden states carried on behind them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, cast

import msgspec

from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.device.device import Device
from gn0.missions.controls import CONTROL_TEXT
from gn0.policies.bae.tokenizer import MERGES, train_tokenizer
from gn0.policies.bae.tokenizer_file import TokenizerFile
from gn0.policies.cma.cma_checkpoint import (
    CmaCheckpoint,
    build_net,
    load_cma_checkpoint,
    save_cma_checkpoint,
)
from gn0.policies.cma.cma_settings import CmaSettings
from gn0.policies.qwen.byte_pairs import read_byte_pairs
from gn0.seeds import derive_seed
from gn0.training.exams.recurrent_examination import RecurrentExamination
from gn0.training.recurrent_learner import RecurrentLearner, RecurrentRecipe, WordTable
from gn0.training.recurrent_stage import RecurrentStage, ReportPlan, RoundPlan, find_autocast
from gn0.training.runs.training_state import load_state
from gn0.training.stage_run import StageJob, open_place, open_stage_run
from gn0.training.streams.step_ring import find_torch_device
from gn0.training.streams.stream_walks import StreamWalks
from gn0.training.worlds import load_held_out, load_lessons, open_world

FREE = ("told", "examined")  # of a job: what may differ where a run goes on
TEXT_LENGTH = 96  # tokens of an instruction at least, so that longer ones of other suites are read
_ROUND = 8


class BaselineJob(StageJob, frozen=True, kw_only=True):
    """What is trained, on what, and how; see `StageJob` for the rest.

    Attributes:
        settings: the net.
        text_length: tokens of an instruction that are read; 0: as many as the longest has, and
            `TEXT_LENGTH` at least.
        recipe: how it learns.
        plan: how long, and in which rounds.
        told: what it says on the way.
        agents: N that walk side by side.
        steps: T of a stretch.
    """

    settings: CmaSettings = CmaSettings()
    text_length: Annotated[int, msgspec.Meta(ge=0, le=4096)] = 0
    recipe: RecurrentRecipe = RecurrentRecipe()
    plan: RoundPlan = RoundPlan()
    told: ReportPlan = ReportPlan()
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 128
    steps: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 32


def train_baseline(
    job: BaselineJob,
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
        device: a card; or `host`, the emulation, where the net learns on the CPU.
        fresh: forget what an earlier call left there.
        command: words of the command line, for `run.json`.
        say: is told how it goes.

    Returns:
        OUT/policy, as `gn0 bench run --policy cma` loads it.

    Raises:
        ConfigError, CheckpointError: the job makes no sense, or a state is damaged.
        TrainingError: a loss is not finite, or the folder holds another run.
        DeviceError, DeviceMemoryError, StorageError: see their texts.
    """
    lessons = load_lessons(job.suites, job.splits)
    exam = job.exam_suite
    examined = load_held_out(exam, job.held_out).texts if job.held_out and job.examined else ()
    place = open_place(device, say)
    with open_stage_run(
        job, "baseline", out, place, hashes={"corpus": lessons.hash}, fresh=fresh,
        command=command, free=FREE, load=lambda folder: load_state(folder, load_cma_checkpoint),
    ) as run:  # fmt: skip
        if run.finished is not None:
            return run.policy
        if run.state is None:
            checkpoint = _build(job, [*load_lessons(job.suites).texts, *examined])
        else:
            checkpoint = cast(CmaCheckpoint, run.state.checkpoint)
        settings = checkpoint.settings
        env = open_world(lessons, settings, job.agents, device=run.walked, say=run.say)
        where = find_torch_device(env)
        net = checkpoint.model.to(where).train()
        tokenizer = read_byte_pairs(checkpoint.tokenizer, run.policy)
        stream = StreamWalks(
            env, settings.pictures, settings.view, job.steps, seed=job.seed,
            beta=lambda number: job.recipe.mix**number, stop_share=job.recipe.stop_share,
        )  # fmt: skip
        table = WordTable(tokenizer, stream.texts, settings.text_length, where)
        autocast = find_autocast(where)
        learner = RecurrentLearner(
            net, table, job.agents, job.recipe, autocast=autocast, compiled=where.type == "cuda"
        )
        stage = RecurrentStage(
            learner, stream, checkpoint.tokenizer, job.plan, job.told, run.recipe, run.corpus
        )
        run.restore(stage)
        examine = None
        if examined:
            examine = RecurrentExamination(
                net, tokenizer, exam, job.held_out, run.walked, episodes=job.examined,
                autocast=autocast,
            )  # fmt: skip
        found = stage.run(run.folder, run.say, examine)
        save_cma_checkpoint(run.policy, stage.checkpoint, overwrite=True)
        run.folder.finish(stage.counters.step, found)
    return run.policy


def _build(job: BaselineJob, texts: Sequence[str]) -> CmaCheckpoint:
    """A net of random weights, and a tokenizer of the texts' language."""
    trained = train_tokenizer([*texts, CONTROL_TEXT], MERGES).backend_tokenizer
    data = trained.to_str().encode()
    tokenizer: TextTokenizer = TokenizerFile(trained)
    length = job.text_length
    if not length:
        longest = max(len(tokenizer.encode(text)) for text in texts)
        length = max(TEXT_LENGTH, -(-longest // _ROUND) * _ROUND)
    settings = msgspec.structs.replace(job.settings, text_length=length, vocabulary=len(tokenizer))
    return CmaCheckpoint(build_net(settings, derive_seed(job.seed, "baseline weights")), data)
