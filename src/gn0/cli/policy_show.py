"""Look at what a checkpoint was shown, was asked and said, and at what the expert would have said.

One decision is one picture: all pictures of the prompt, the prompt's text, the answer with its
points on the map, its actions beside the expert's, how probable each first action was, and the walk
so far. `--steps all` draws all decisions of an episode on a contact sheet. `--from RUN` draws
successes and failures of a run, chosen by seed and not by eye. CHECKPOINT may be `bae`, the policy
in the box; torch is not needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

if TYPE_CHECKING:
    from PIL import Image

    from gn0.geometry import Pose2D
    from gn0.policies.bae.policy_bae import PolicyBae
    from gn0.progress import Progress
    from gn0.viewer.episode_stage import EpisodeStage

EXAMPLES = """  gn0 policy show bae out/suite --out decision.png
  gn0 policy show bae out/suite --inputs views --out seen.png
  gn0 policy show out/sft/policy out/suite --episode flat_0003 --step 12 --out decision.png
  gn0 policy show out/sft/policy out/suite --episode flat_0003 --pose 1.5,2,90 --out there.png
  gn0 policy show out/sft/policy out/suite --episode flat_0003 --steps all --out walk.png
  gn0 policy show out/sft/policy out/suite --from out/bae --pick 3 --seed 0 --out cases.png"""

PICK, SEED = 3, 0  # episodes of a run of each kind, and how they are drawn


class Args(Config, frozen=True):
    """What to draw and where to.

    Attributes:
        checkpoint: the folder of a trained policy, or of its run; `bae` for the one in the box.
        suite: a suite folder, or a scene folder (the fifty goal episodes sampled in it).
        out: the PNG or JPEG file to write.
        episode: id of an episode; by default the first one.
        step: of the episode: the last question up to it is drawn.
        pose: X,Y,DEGREES: ask there, without a past, instead of walking.
        steps: one, or all decisions of the episode on a sheet.
        from_: draw cases of this run: a folder of `gn0 bench run` or of `gn0 policy examine`, or a
            file of JSON lines with `episode` and `success`.
        pick: how many successes and how many failures of it.
        seed: decides which ones.
        inputs: in which of its ways a checkpoint is asked that was trained in several; its default
            when empty.
        executed: actions of an answer that are carried out; 0 for as many as the checkpoint says.
        computed_by: torch, numpy, or auto: torch where it is installed.
        backend: what draws pictures: cpu, cuda, or the best available (auto).
    """

    checkpoint: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CHECKPOINT")]
    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    out: str
    episode: str = ""
    step: Annotated[int, msgspec.Meta(ge=0)] = 0
    pose: str = ""
    steps: Literal["one", "all"] = "one"
    from_: Annotated[str, tyro.conf.arg(name="from")] = ""
    pick: Annotated[int, msgspec.Meta(ge=1, le=20)] = PICK
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = SEED
    inputs: str = ""
    executed: Annotated[int, msgspec.Meta(ge=0, le=6)] = 0
    computed_by: Literal["auto", "torch", "numpy"] = "auto"
    backend: Literal["auto", "cpu", "cuda"] = "auto"


def run(args: Args) -> int:
    """Draw and write."""
    from gn0.bench.cases import read_outcomes
    from gn0.cli.console import draw_progress
    from gn0.cli.picture_file import check_picture, write_picture
    from gn0.policies.bae.policy_bae import PolicyBae
    from gn0.suites.suite import open_suite
    from gn0.viewer.episode_stage import DECISION_MAP, SHEET_MAP, EpisodeStage

    check_picture(args.out)
    _check_together(args)
    if args.pose:
        read_pose(args.pose, "--pose")  # before scene and weights are opened for nothing
    with draw_progress("drawing") as progress:
        suite = open_suite(args.suite)
        outcomes = read_outcomes(args.from_) if args.from_ else {}
        policy = PolicyBae(
            args.checkpoint,
            inputs=args.inputs,
            executed=args.executed,
            backend=args.computed_by,
        )
        is_sheet = bool(args.from_) or args.steps == "all"
        size = SHEET_MAP if is_sheet else DECISION_MAP
        stage = EpisodeStage(suite, policy, args.backend, size)
        if args.from_:
            picture = _draw_cases(args, outcomes, stage, progress)
        elif args.steps == "all":
            picture = _draw_walk(args, stage, progress)
        else:
            picture = _draw_decision(args, stage, policy, progress)
    write_picture(args.out, picture)
    print(f"{args.out}: {picture.width}x{picture.height} px")
    return 0


def _check_together(args: Args) -> None:
    from gn0.errors import ConfigError

    given = {
        "--pose": bool(args.pose), "--steps": args.steps == "all", "--from": bool(args.from_),
        "--step": args.step > 0,
    }  # fmt: skip
    named = [name for name, is_given in given.items() if is_given]
    if len(named) > 1 or (args.from_ and args.episode):
        raise ConfigError(
            f"{' and '.join(named if len(named) > 1 else ['--from', '--episode'])} ask for "
            "different pictures",
            where="gn0 policy show",
            remedy="give one of them",
        )
    if not args.from_ and (args.pick, args.seed) != (PICK, SEED):
        raise ConfigError(
            "--pick and --seed draw episodes of a run",
            where="gn0 policy show",
            remedy="add --from RUN, or leave them out",
        )


def _draw_decision(
    args: Args, stage: EpisodeStage, policy: PolicyBae, progress: Progress
) -> Image.Image:
    import numpy as np

    from gn0.errors import ConfigError
    from gn0.policies.bae.decision import Decision, ask_at, ask_expert, walk_asked
    from gn0.viewer.decision_picture import DecisionShown, render_decision

    episode = stage.find(args.episode)
    simulator, ground = stage.open(episode)
    if args.pose:
        pose = read_pose(args.pose, "--pose")
        decision = ask_at(policy, simulator, episode, pose)
        track = np.zeros((0, 2))
        words = "placed there, without a past"
    else:
        spots: list[tuple[float, float]] = []
        found: Decision | None = None
        words = ""
        for step in walk_asked(policy, simulator, episode):
            progress("walking", len(spots), min(args.step, simulator.max_steps))
            spots.append((step.pose.x, step.pose.y))
            found = step.decision
            if len(spots) > args.step:
                break
            if step.over:
                raise ConfigError(
                    f"the walk ends after step {len(spots) - 1}",
                    where="--step",
                    remedy=f"give 0 to {len(spots) - 1}",
                )
        assert found is not None
        decision = found
        track = np.array(spots)[: decision.step + 1]
        if decision.step < args.step:
            words = f"the question that step {args.step} was taken from"
    expert = ask_expert(simulator.navigation, episode, decision.pose)
    settings = policy.questions.settings
    shown = DecisionShown(episode, settings, decision, expert, track, words)
    return render_decision(shown, ground)


def _draw_walk(args: Args, stage: EpisodeStage, progress: Progress) -> Image.Image:
    from gn0.viewer.decision_sheet import render_walk, walk_episode

    walk = walk_episode(stage, stage.find(args.episode), progress=progress)
    return render_walk(walk, stage)


def _draw_cases(
    args: Args, outcomes: dict[str, bool], stage: EpisodeStage, progress: Progress
) -> Image.Image:
    from gn0.bench.cases import pick_cases
    from gn0.viewer.decision_sheet import render_walks, walk_episode

    cases = pick_cases(outcomes, args.pick, args.seed)
    for episode in cases:
        stage.find(episode)
    walks = []
    for number, episode in enumerate(cases):
        progress("episodes", number, len(cases))
        walks.append(walk_episode(stage, stage.find(episode)))
    progress("episodes", len(cases), len(cases))
    done = sum(outcomes.values())
    title = (
        f"{sum(outcomes[episode] for episode in cases)} successes of {done} and "
        f"{sum(not outcomes[episode] for episode in cases)} failures of {len(outcomes) - done}, "
        f"drawn with seed {args.seed}"
    )
    other = [w.episode.id for w in walks if w.success != outcomes[w.episode.id]]
    notes = []
    if other:
        notes.append(
            f"ended differently from {args.from_}: {', '.join(other)}: it was walked by another "
            "policy, or with other settings"
        )
    return render_walks(walks, stage, title, notes)


def read_pose(text: str, where: str) -> Pose2D:
    """X,Y,DEGREES as a pose; north is 90.

    Raises:
        ConfigError: it is not three numbers.
    """
    import math

    from gn0.errors import ConfigError
    from gn0.geometry import Pose2D

    try:
        x, y, degrees = (float(part) for part in text.split(","))
    except ValueError:
        x = y = degrees = math.nan
    if not all(map(math.isfinite, (x, y, degrees))):
        raise ConfigError(
            f"{text[:40]!r} is not a pose",
            where=where,
            remedy="give X,Y,DEGREES, for example 1.5,2,90",
        )
    return Pose2D(x, y, math.radians(degrees))
