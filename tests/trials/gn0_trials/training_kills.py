"""A training run that is killed again and again, and what its folder holds each time.

`python -m gn0_trials.training_kills FOLDER` loads torch once and then, for each line "UNTIL" on its
input, forks a process that goes on with the run up to that step; it writes what happens to its
output. `kill_training` drives it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import torch

from gn0.config import Config
from gn0.policies.bae.checkpoint import Checkpoint
from gn0.policies.bae.sizes import build_model
from gn0.policies.bae.tokenizer import read_token_ids, train_tokenizer
from gn0.seeds import random_stream
from gn0.training.runs.generators import capture_generators, restore_generators
from gn0.training.runs.metrics_file import read_metrics
from gn0.training.runs.optimiser_state import capture_optimiser, restore_optimiser
from gn0.training.runs.recipe_text import describe_recipe
from gn0.training.runs.resume_checks import check_resume
from gn0.training.runs.run_folder import CHECKPOINTS, METRICS, RunFolder, open_run
from gn0.training.runs.state_file import TrainingCounters
from gn0.training.runs.state_folder import find_latest
from gn0.training.runs.training_state import (
    TrainingState,
    list_versions,
    load_state,
    name_device,
)

EVERY = 2  # steps between two states
CORPUS = "words at random"


class WordsRecipe(Config, frozen=True):
    """How a learner of words at random learns."""

    size: str = "nano"
    rate: float = 1e-3
    steps: int = 8
    shape: tuple[int, ...] = (2, 6)
    hub_token: str = ""


class LearnerOfWords:
    """A model that is taught words at random; all that it draws comes from saved generators."""

    def __init__(self, state: TrainingState | None = None, recipe: WordsRecipe | None = None):
        self.recipe = recipe or WordsRecipe()
        tokenizer = train_tokenizer(["go to the red sofa", "find the lamp"])
        ids = read_token_ids(tokenizer)
        model = state.checkpoint.model if state else build_model(self.recipe.size, ids)
        self.checkpoint = Checkpoint(model, tokenizer, ids)
        self.model = model.train()
        matrices = [(n, w) for n, w in model.named_parameters() if w.ndim > 1]
        others = [(n, w) for n, w in model.named_parameters() if w.ndim <= 1]
        self.named = [*matrices, *others]
        groups = [
            {"params": [w for _, w in matrices], "weight_decay": 0.05},
            {"params": [w for _, w in others], "weight_decay": 0.0},
        ]
        self.optimiser = torch.optim.AdamW(groups, self.recipe.rate, betas=(0.9, 0.95))
        self.own = torch.Generator().manual_seed(7)
        self.step = 0
        self.averaged = {name: weight.detach().clone() for name, weight in self.named}
        self.stream = random_stream(3, "draw")
        torch.manual_seed(5)
        if state:
            assert state.optimiser is not None
            self.step = state.counters.step
            self.averaged, self.stream = dict(state.averaged), state.streams["draw"]
            restore_optimiser(self.optimiser, state.optimiser, self.named)
            assert restore_generators(state.generators, {"own": self.own}) == ()

    def learn(self, steps: int = 1) -> list[float]:
        """Losses of some steps."""
        losses = []
        for _ in range(steps):
            self.step += 1
            for group in self.optimiser.param_groups:
                group["lr"] = self.recipe.rate / self.step
            words = torch.from_numpy(self.stream.integers(0, 250, self.recipe.shape))
            words[0, 0] = torch.randint(0, 250, (1,))[0]
            words[1, 0] = torch.randint(0, 250, (1,), generator=self.own)[0]
            loss = self.model(input_ids=words, labels=words).loss
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()
            for name, weight in self.named:
                self.averaged[name].lerp_(weight.detach(), 0.01)
            losses.append(loss.item())
        return losses

    def state(self) -> TrainingState:
        """All of it."""
        return TrainingState(
            checkpoint=self.checkpoint,
            counters=TrainingCounters(step=self.step, samples=2 * self.step, seconds=0.5),
            recipe=describe_recipe(self.recipe),
            corpus=CORPUS,
            device=name_device("cpu"),
            averaged=self.averaged,
            optimiser=capture_optimiser(self.optimiser, self.named),
            generators=capture_generators({"own": self.own}),
            streams={"draw": self.stream},
            source={"part": 3, "row": 17},
            arrays={"head.weight": torch.arange(6, dtype=torch.int64).reshape(2, 3)},
        )


@dataclass(frozen=True)
class KillTally:
    """What kills did.

    Attributes:
        kills: how many.
        last: the folder held the state that was being saved, or the one last told as saved.
        saving: a state was half-written at the kill, and stayed unseen.
        broken: in words, each time that something else was found.
        equal: the run's weights and losses are those of a run that was never killed.
        step: where it ended.
    """

    kills: int
    last: int
    saving: int
    broken: tuple[str, ...]
    equal: bool
    step: int


def kill_training(folder: Path, kills: int, *, seed: int = 0, longest: float = 1.2) -> KillTally:
    """Train `nano`, kill −9 at random moments, look, go on; then compare with a run without kills.

    Args:
        folder: empty.
        kills: how many.
        seed: of the moments.
        longest: seconds after which a process is killed at the latest, counted from its first step.
    """
    stream = random_stream(seed, "kills")
    killed, whole = folder / "killed", folder / "whole"
    broken: list[str] = []
    last = saving = saved = 0
    with _start(killed) as process:
        assert process.stdin is not None and process.stdout is not None
        for _ in range(kills):
            pid = _send(process, 10**9)
            told = _read_until(process.stdout, "begins")
            time.sleep(stream.uniform(0, longest))
            os.kill(pid, signal.SIGKILL)
            told += _read_until(process.stdout, "dead")
            saved = max([saved, *(int(line.split()[1]) for line in told if "saved" in line)])
            states = killed / CHECKPOINTS
            saving += any(p.name.startswith(".") for p in states.iterdir()) if saved else 0
            fault, found = _look(killed, saved)
            last += not fault
            broken += [fault] if fault else []
            saved = max(saved, found)
        until = saved + EVERY
        _send(process, until)
        _read_until(process.stdout, "dead")
    with _start(whole) as process:
        _send(process, until)
        assert process.stdout is not None
        _read_until(process.stdout, "dead")
    return KillTally(kills, last, saving, tuple(broken), _are_equal(killed, whole), until)


def _look(folder: Path, saved: int) -> tuple[str, int]:
    """What is wrong with a run's folder, "" if nothing, and the step of its last state."""
    latest = find_latest(folder / CHECKPOINTS)
    if latest is None:
        return (f"no state, though {saved} was saved" if saved else ""), 0
    step = load_state(latest).counters.step  # raises what would stop a resume
    if step not in (saved, saved + EVERY):
        return f"state {step} after {saved} was saved", step
    steps = [line["step"] for line in read_metrics(folder / METRICS)]
    if steps != [*range(1, len(steps) + 1)] or len(steps) < step:
        return f"metrics of steps {steps[:3]} … {steps[-3:]} at state {step}", step
    return "", step


def _are_equal(one: Path, other: Path) -> bool:
    states = [load_state(folder / CHECKPOINTS) for folder in (one, other)]
    weights = [dict(state.checkpoint.model.named_parameters()) for state in states]
    same = all(torch.equal(array, weights[1][name]) for name, array in weights[0].items())
    averaged = [state.averaged for state in states]
    same &= all(torch.equal(array, averaged[1][name]) for name, array in averaged[0].items())
    return same and read_metrics(one / METRICS) == read_metrics(other / METRICS)


def _start(folder: Path) -> subprocess.Popen[str]:
    folder.mkdir(parents=True, exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", __name__, str(folder)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip


def _send(process: subprocess.Popen[str], until: int) -> int:
    """Have the run gone on with; the process that does."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(f"{until}\n")
    process.stdin.flush()
    return int(_read_until(process.stdout, "pid")[-1].split()[1])


def _read_until(stream: IO[str], word: str) -> list[str]:
    lines: list[str] = []
    for line in stream:
        lines.append(line.strip())
        if line.startswith(word):
            return lines
    raise RuntimeError(f"the training process ended: {lines[-3:]}")


def _say(text: str) -> None:
    os.write(1, f"{text}\n".encode())


def _go_on(run: RunFolder, until: int) -> None:
    state = load_state(run.resumed) if run.resumed else None
    learner = LearnerOfWords(state)
    if state is not None:
        recipe = describe_recipe(learner.recipe)
        device = name_device("cpu")
        check_resume(state, recipe=recipe, corpus=CORPUS, device=device, exact=True)
    _say(f"begins {learner.step}")
    while learner.step < until:
        (loss,) = learner.learn()
        run.report(learner.step, {"loss": loss})
        if learner.step % EVERY == 0:
            run.save(learner.state())
            _say(f"saved {learner.step}")


def main() -> None:
    """Fork a process for each line of the input; see above."""
    folder = Path(sys.argv[1])
    torch.set_num_threads(1)  # a process with threads is not forked
    for line in sys.stdin:
        pid = os.fork()
        if pid == 0:
            with open_run(
                folder, stage="words", recipe=describe_recipe(WordsRecipe()), hashes={},
                command=[], device="cpu", versions=list_versions(),
            ) as run:  # fmt: skip
                _go_on(run, int(line))
            os._exit(0)
        _say(f"pid {pid}")
        os.waitpid(pid, 0)
        _say("dead")


if __name__ == "__main__":
    main()
