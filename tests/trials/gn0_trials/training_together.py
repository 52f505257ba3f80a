"""A short run of a small model that one process or several learn: `python -m …` or by torchrun."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

import torch

from gn0.data.answer_form import AnswerForm
from gn0.policies.bae.checkpoint import Checkpoint
from gn0.policies.bae.policy_settings import PolicySettings
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.training.inputs import InputMixture, read_inputs
from gn0.training.learner import Learner, Losses, LossForward, open_learner
from gn0.training.processes import Processes, join_processes, open_run_together
from gn0.training.pupil import build_pupil
from gn0.training.recipe import Recipe, Speed
from gn0.training.runs.training_state import load_state
from gn0.training.sharding import open_mesh, own_part, shard_blocks
from gn0.training.stage import Stage, StagePlan
from gn0.training.streams.samples import SampleBatch
from gn0_trials.pupil_small import TEXTS, PupilSmall, draw_states, make_words

RECIPE = Recipe(batch=4, warm_steps=2, mean=0.9)


class SharedOut:
    """Batches at random by their number; each process is given its rows of every one."""

    texts: tuple[str, ...] = ("", "", "")

    def __init__(self, processes: Processes, dies_at: int) -> None:
        self.processes, self.drawn, self.dies_at = processes, 0, dies_at

    def draw(self, count: int) -> Any:
        """This process' rows of the next batch."""
        own = self.processes
        if self.drawn == self.dies_at and own.rank == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        states = draw_states(count * own.count, seed=self.drawn)
        self.drawn += count * own.count
        return states.pick(slice(own.rank * count, (own.rank + 1) * count))

    def state(self) -> dict[str, int]:
        """How many were drawn."""
        return {"drawn": self.drawn}

    def restore(self, state: Any) -> None:
        """Go on from there."""
        self.drawn = state["drawn"]


class Kept:
    """What a stage needs of a pupil."""

    def __init__(self, pupil: PupilSmall, model: Any) -> None:
        self.checkpoint = Checkpoint(model, pupil.tokenizer, pupil.ids)


def learn_inputs(folder: Path, samples: int, *, fsdp: bool = False) -> None:
    """The same of a policy that is asked with maps, or with words alone: its tower is idle then."""
    view = MapView((EgoSquare(32, 0.24), EgoSquare(32, 0.6)))
    plain = PolicySettings(
        prompt="short", pictures=("near",), form=AnswerForm(layout="compact"), view=view
    )
    settings, shares = read_inputs("maps,words=/0", plain)
    pupil = build_pupil("nano", settings, TEXTS)
    with (
        join_processes("host") as processes,
        open_run_together(
            processes, pupil.model.device, folder, stage="sft", recipe={},
            hashes={"corpus": "c"}, command=["gn0"], device="cpu", versions={},
        ) as run,
    ):  # fmt: skip
        if fsdp:
            shard_blocks(pupil.model, open_mesh(processes, torch.device("cpu")))
        maker = pupil.inputs["maps"].maker(TEXTS, "cpu")
        learner = open_learner(pupil, maker.table, RECIPE, Speed(fsdp=fsdp), processes)
        plan = StagePlan(samples=samples, report=1, save=0)
        stream = SharedOut(processes, -1)
        stream.texts = TEXTS
        mixture = InputMixture(shares, 1)
        Stage(pupil, learner, stream, maker, plan, {}, "c", mixture=mixture).run(run, print)


def count_held(learner: Learner[Any, Any]) -> dict[str, int]:
    """Numbers that this process holds: of weights, averaged weights and the optimiser's states."""
    remembered = [one for kept in learner.optimiser.state.values() for one in kept.values()]
    held = {
        "weights": learner.weights.values(),
        "averaged": learner.averaged.values(),
        "optimiser": [one for one in remembered if one.ndim],
    }
    return {name: sum(own_part(one).numel() for one in some) for name, some in held.items()}


def learn(folder: Path, samples: int, dies_at: int = -1, *, fsdp: bool = False) -> None:
    """Learn from so many samples, in whatever processes the environment speaks of."""
    pupil = PupilSmall(make_words())
    with (
        join_processes("host") as processes,
        open_run_together(
            processes, next(pupil.model.parameters()).device, folder, stage="sft", recipe={},
            hashes={"corpus": "c"}, command=["gn0"], device="cpu", versions={},
        ) as run,
    ):  # fmt: skip
        state = load_state(run.resumed) if run.resumed else None
        model = state.checkpoint.model.train() if state else pupil.model
        if fsdp:
            shard_blocks(model, open_mesh(processes, torch.device("cpu")))
        loss = LossForward(pupil.forward_of(model), pupil.slots, RECIPE)
        learner: Learner[SampleBatch, Losses] = Learner(loss, RECIPE, processes=processes)
        plan = StagePlan(samples=samples, report=1, save=2)
        stream = SharedOut(processes, dies_at)
        kept: Any = Kept(pupil, model)
        stage = Stage(kept, learner, stream, pupil.maker, plan, {}, "c")
        if state is not None:
            stage.restore(state)
        stage.run(run, print)
        held = processes.gather(count_held(learner), torch.device("cpu"))
        if processes.leads:
            (folder / "held.json").write_text(json.dumps(held))
    if hasattr(learner._called, "reducer"):
        sys.exit("the reducer outlives its group: closing it may hang")
    if fsdp and list_gloo_threads():
        sys.exit("threads of gloo outlive their group: ending the interpreter may abort")


def list_gloo_threads() -> list[str]:
    """Names of this process' threads that compute for gloo; none where the system tells none."""
    names = (path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm"))
    return [name for name in names if name == "pt_gloo_runloop"]


if __name__ == "__main__":
    asked = sys.argv[4].split(",") if len(sys.argv) > 4 else []
    parts = "fsdp" in asked
    if "inputs" in asked:
        learn_inputs(Path(sys.argv[1]), int(sys.argv[2]), fsdp=parts)
    else:
        learn(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), fsdp=parts)
