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
import torch

from gn0.config import Config
from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.device.device import Device
from gn0.device.open import open_device
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
from gn0.training.recurrent_examination import RecurrentExamination
from gn0.training.recurrent_learner import RecurrentLearner, RecurrentRecipe, WordTable
from gn0.training.recurrent_stage import RecurrentStage, ReportPlan, RoundPlan, find_autocast
from gn0.training.runs.recipe_text import describe_command, describe_recipe
from gn0.training.runs.resume_checks import check_resume
from gn0.training.runs.run_folder import open_run
from gn0.training.runs.training_state import TrainingState, list_versions, load_state, name_device
from gn0.training.streams.step_ring import find_torch_device
from gn0.training.streams.stream_walks import StreamWalks
from gn0.training.worlds import load_lessons, open_world

FREE = ("told", "examined")  # of a job: what may differ where a run goes on
POLICY = "policy"  # folder of the trained policy in a run's
TEXT_LENGTH = 96  # tokens of an instruction at least, so that longer ones of other suites are read
_ROUND = 8


class BaselineJob(Config, frozen=True, kw_only=True):
    """What is trained, on what, and how.

    Attributes:
        suites: suite folders.
        exam: the suite to be examined in; the first of `suites` when empty.
        splits: of the suites, to learn from; all when empty.
        held_out: of the suite, to be examined in; none when empty.
        settings: the net.
        text_length: tokens of an instruction that are read; 0: as many as the longest has, and
            `TEXT_LENGTH` at least.
        recipe: how it learns.
        plan: how long, and in which rounds.
        told: what it says on the way.
        agents: N that walk side by side.
        steps: T of a stretch.
        examined: episodes of an examination.
        seed: of weights, walks and chances.
    """

    suites: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    exam: str = ""
    splits: tuple[str, ...] = ("train",)
    held_out: tuple[str, ...] = ("val_unseen",)
    settings: CmaSettings = CmaSettings()
    text_length: Annotated[int, msgspec.Meta(ge=0, le=4096)] = 0
    recipe: RecurrentRecipe = RecurrentRecipe()
    plan: RoundPlan = RoundPlan()
    told: ReportPlan = ReportPlan()
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 128
    steps: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 32
    examined: Annotated[int, msgspec.Meta(ge=0)] = 512
    seed: int = 0


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
    exam = job.exam or job.suites[0]
    examined = load_lessons(exam, job.held_out).texts if job.held_out and job.examined else ()
    card = open_device(device) if isinstance(device, str) else device
    recipe = describe_recipe(job)
    versions = list_versions()
    kind = torch.device("cuda" if card.kind == "cuda" else "cpu")
    with open_run(
        Path(out),
        stage="baseline",
        recipe=recipe,
        hashes={"corpus": lessons.hash},
        command=describe_command(command),
        device=name_device(kind),
        versions=versions,
        free=FREE,
        fresh=fresh,
    ) as folder:
        policy = folder.folder / POLICY
        if folder.finished is not None and not folder.notes and policy.is_dir():
            say(f"done before, at step {folder.finished}")
            return policy
        state = load_state(folder.resumed, load_cma_checkpoint) if folder.resumed else None
        if state is None:
            checkpoint = _build(job, [*load_lessons(job.suites).texts, *examined])
        else:
            checkpoint = cast(CmaCheckpoint, state.checkpoint)
        settings = checkpoint.settings
        env = open_world(lessons, settings, job.agents, device=card)
        where = find_torch_device(env)
        net = checkpoint.model.to(where).train()
        tokenizer = read_byte_pairs(checkpoint.tokenizer, policy)
        stream = StreamWalks(
            env, settings.pictures, settings.view, job.steps, seed=job.seed,
            beta=lambda number: job.recipe.mix**number, stop_share=job.recipe.stop_share,
        )  # fmt: skip
        table = WordTable(tokenizer, stream.texts, settings.text_length, where)
        autocast = find_autocast(where)
        learner = RecurrentLearner(net, table, job.agents, job.recipe, autocast=autocast)
        stage = RecurrentStage(
            learner, stream, checkpoint.tokenizer, job.plan, job.told, recipe, lessons.hash
        )
        for note in (*folder.notes, *_go_on(stage, state, name_device(where))):
            say(note)
            folder.log(note)
        examine = None
        if examined:
            examine = RecurrentExamination(
                net, tokenizer, exam, job.held_out, card, episodes=job.examined, autocast=autocast
            )
        found = stage.run(folder, say, examine)
        save_cma_checkpoint(policy, stage.checkpoint, overwrite=True)
        folder.finish(stage.counters.step, found)
    return policy


def _go_on(stage: RecurrentStage, state: TrainingState | None, device: str) -> tuple[str, ...]:
    """Restore a state, where there is one; gives what is not as it was."""
    if state is None:
        return ()
    notes = check_resume(state, recipe=stage.recipe, corpus=stage.corpus, device=device, free=FREE)
    return tuple(dict.fromkeys((*notes, *stage.restore(state))))


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
