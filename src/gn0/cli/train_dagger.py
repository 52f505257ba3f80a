"""Let a trained policy walk, and teach it what the expert would do where it gets to: DAgger.

By default as in the paper: the policy of --start gathers --states once, and then goes on from its
weights over --epochs of them. With --live, a stage of its own, the policy in training walks all the
time and learns from where it gets to now; the expert drives at first. What was stopped goes on when
the same command is given again, in mid-collection, too. The trained policy is in OUT/policy, and
`gn0 bench run SUITE --policy bae --policy-option checkpoint=OUT/policy` examines it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec

from gn0.cli.comma_lists import read_joins, split_words
from gn0.cli.train_flags import ImitationFlags, resolve_start, train_stage
from gn0.errors import ConfigError

if TYPE_CHECKING:
    from gn0.policies.bae.policy_settings import PolicySettings
    from gn0.training.dagger import DaggerJob
    from gn0.training.dagger_live import DaggerLiveJob

EXAMPLES = """  gn0 train dagger out/suite --start out/sft/policy --out out/dagger
  gn0 train dagger out/suite --start out/sft/policy --driver expert --out out/longer
  gn0 train dagger out/suite --start out/sft/policy --beta 0.5 --stop-share 1 --out out/half
  gn0 train dagger out/collected --source dataset --start out/sft-4b/policy --recipe pretrained \\
      --out out/dagger-4b
  gn0 train dagger out/suite --live --start out/sft/policy --samples 1500000 --beta-from 0 \\
      --beta-to 500000 --out out/live
  gn0 train dagger out/suite --live --start out/maps/policy --inputs all:0.5,views:0.3,maps:0.2 \\
      --beta-from 0 --beta-to 500000 --out out/every
  gn0 train dagger out/suite --live --pictures near,far --samples 50000000 --out out/from-nothing
  gn0 train dagger out/suite --start out/sft/policy --split all --held-out "" --states 64 \\
      --batch 8 --agents 4 --device host --out out/tried"""


class Args(ImitationFlags, frozen=True, kw_only=True):
    """What to walk in, who walks, and how to learn.

    Attributes:
        suite: suite folders, as `gn0 missions generate` writes; a dataset's with --source dataset.
        start: folder of the policy to go on from, or of its run, such as out/sft; bae for the one
            in the box; may be left out with --live, which then begins with random weights.
        live: gather states while learning, with the policy in training: stage dagger_live.
        source: where states come from: walks of agents in the suites, or a dataset that
            `gn0 data dagger` collected (not with --live).
        states: to gather, rounded up to whole batches; 300,000, or the paper's 284,000 for
            pretrained (not with --live).
        epochs: over all states, by default 5 (not with --live).
        driver: who walks: the policy, or the expert, which is the control: as many samples of its
            own walks (not with --live).
        beta: chance that the expert drives an agent until the next decision, by default 0 (not with
            --live).
        rescue: actions that led nowhere after which the expert drives an agent until the next
            decision, so that one at a wall is not hundreds of states; 0: never, as by default (not
            with --live).
        samples: to learn from (--live; by default 8,000,000).
        minutes: of training at most; the rate falls in time for it (--live).
        beta_from: samples up to which the expert drives all agents (--live; by default 250,000).
        beta_to: samples from which the policy does, beta falling in between (--live; by default
            2,500,000).
        acts: with which weights the policy walks: current, or averaged (--live).
        confirm_stop: ask again about a STOP behind the first action of an answer (--live).
        draw_after: actions without getting anywhere after which answers are drawn as probable as
            the policy holds them, when it walks and when it is examined; 0: never, by default as
            the policy of --start does (--live).
        joins: samples drawn when each suite joins, with commas between; those of one number join
            together, and a suite that is not there yet is waited for (--live).
        join_late: do not wait for suites that are not there yet: learn on, and take each up when it
            is there, unless the rate falls by then (--live).
        kept: states that batches are drawn from (--live; by default 200,000).
        ratio: new states a sample (--live; by default 0.5).
        size: of a model from random weights: nano or tiny (--live without --start, as --layout and
            --preset).
        prompt: a prompt of `gn0 list prompts`, or the path of one; by default short (--live, as all
            below down to --points: with --start, what the policy is asked from now on, by default
            what it was asked so far).
        pictures: what the prompt shows, with commas between; by default near,far.
        without: parts of the prompt that are left out, with commas between.
        points: waypoints of an answer; by default 13.
        layout: of answers: compact or json.
        preset: of the cameras, as in `gn0 list presets`.
        inputs: shares of the steps by the policy's inputs, as all:0.5,views:0.3,maps:0.2, and of
            who drives with --live; there a policy may go on with other inputs than it had, which
            are read as in `gn0 train sft`. A policy of several inputs learns its default alone
            without it, and drives by that.
        executed: actions of an answer that are carried out; 0 for what the policy's settings say.
        stop_share: chance that a wrong STOP ends the episode; else the expert's action is carried
            out.
        recipe: how it learns: scratch, a tenth of SFT's rate with --start and else all of it;
            pretrained, the paper's.
        agents: that walk side by side.
    """

    start: str = ""
    live: bool = False
    source: Literal["walks", "dataset"] | None = None
    states: Annotated[int, msgspec.Meta(ge=1)] | None = None
    epochs: Annotated[int, msgspec.Meta(ge=1, le=1000)] | None = None
    driver: Literal["policy", "expert"] | None = None
    beta: Annotated[float, msgspec.Meta(ge=0, le=1)] | None = None
    rescue: Annotated[int, msgspec.Meta(ge=0, le=10_000)] | None = None
    samples: Annotated[int, msgspec.Meta(ge=1)] | None = None
    minutes: Annotated[float, msgspec.Meta(gt=0)] | None = None
    beta_from: Annotated[int, msgspec.Meta(ge=0)] | None = None
    beta_to: Annotated[int, msgspec.Meta(ge=0)] | None = None
    acts: Literal["current", "averaged"] | None = None
    confirm_stop: bool = False
    draw_after: Annotated[int, msgspec.Meta(ge=0, le=10_000)] | None = None
    joins: str | None = None
    join_late: bool = False
    kept: Annotated[int, msgspec.Meta(ge=1)] | None = None
    ratio: Annotated[float, msgspec.Meta(gt=0, le=10)] | None = None
    size: str | None = None
    prompt: str | None = None
    pictures: str | None = None
    without: str | None = None
    points: Annotated[int, msgspec.Meta(ge=0, le=64)] | None = None
    layout: Literal["compact", "json"] | None = None
    preset: str | None = None
    inputs: str = ""
    executed: Annotated[int, msgspec.Meta(ge=0, le=64)] = 0
    stop_share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.2
    recipe: Literal["scratch", "pretrained"] = "scratch"


ONCE = ("source", "states", "epochs", "driver", "beta", "rescue")
LIVE = (
    "samples", "minutes", "beta_from", "beta_to", "acts", "confirm_stop", "draw_after", "joins",
    "join_late", "kept", "ratio",
)  # fmt: skip
OWN = ("size", "layout", "preset")  # that a policy keeps
ASKED = ("prompt", "pictures", "without", "points")  # that it may be asked in another way
ANEW = (*OWN, *ASKED)


def run(args: Args) -> int:
    """Gather states and learn, and say where the policy lies."""
    from gn0.cli.train_packages import check_packages
    from gn0.data.dataset import open_dataset
    from gn0.policies.bae.policy_settings import load_policy_settings
    from gn0.suites.suite_kept import load_suite_kept

    _check_flags(args)
    # what is learned from is looked at first: packages are of no help against a broken folder
    first = args.suite[0]
    open_dataset(first) if args.source == "dataset" else load_suite_kept(first)
    if args.start:
        args = resolve_start(args)
        load_policy_settings(args.start)
    check_packages()
    from gn0.training.dagger import train_dagger
    from gn0.training.dagger_live import train_dagger_live

    if args.live:
        return train_stage(args, train_dagger_live, _read_live(args))
    return train_stage(args, train_dagger, _read_once(args))


def _check_flags(args: Args) -> None:
    """Refuse flags of the other stage."""
    if args.live:
        _refuse(args, ONCE, "--live", "leave it out, or leave out --live")
        if args.start:
            _refuse(args, OWN, "--start", "the policy has its own; leave it out")
        return
    _refuse(args, (*LIVE, *ANEW), "states that are gathered once", "leave it out, or give --live")
    if not args.start:
        raise ConfigError(
            "nobody to walk: no policy to go on from",
            where="--start",
            remedy="give the policy of an earlier stage, such as out/sft/policy; "
            "--live begins with random weights",
        )
    if args.source == "dataset":
        walked = ("states", "driver", "beta", "rescue")
        _refuse(args, walked, "--source dataset", "the dataset has its states; leave it out")


def _refuse(args: Args, names: Sequence[str], beside: str, remedy: str) -> None:
    for name in names:
        value = getattr(args, name)
        if value is not None and value is not False:
            flag = f"--{name.replace('_', '-')}"
            raise ConfigError(f"{flag} beside {beside}", where=flag, remedy=remedy)


def _read_once(args: Args) -> DaggerJob:
    from gn0.training.dagger import DAGGER_RECIPES, STATES, DaggerJob

    return DaggerJob(
        **_read_both(args, DAGGER_RECIPES[args.recipe]),
        **_given(args, ("source", "epochs", "driver", "beta", "rescue")),
        states=args.states or STATES[args.recipe],
    )


def _read_live(args: Args) -> DaggerLiveJob:
    from gn0.data.answer_form import AnswerForm
    from gn0.policies.bae.policy_settings import PolicySettings
    from gn0.training.dagger import DAGGER_RECIPES
    from gn0.training.dagger_live import DaggerLiveJob
    from gn0.training.inputs import read_inputs
    from gn0.training.recipe import RECIPES

    settings, inputs = None, dict[str, float]()
    if args.start:
        settings, inputs = _read_going_on(args)
    else:
        settings = PolicySettings(
            prompt=args.prompt or "short",
            pictures=split_words("near,far" if args.pictures is None else args.pictures),
            form=AnswerForm(
                points=13 if args.points is None else args.points, layout=args.layout or "compact"
            ),
            without=split_words(args.without or ""),
            preset=args.preset or "tiny_128",
        )
        if args.inputs:
            settings, inputs = read_inputs(args.inputs, settings)
    recipes = DAGGER_RECIPES if args.start else RECIPES
    names = ("size", "kept", "ratio", "acts", "beta_from", "beta_to", "draw_after")
    both = _read_both(args, recipes[args.recipe])
    both["inputs"] = inputs
    return DaggerLiveJob(
        **both,
        **_given(args, names),
        joins=read_joins(args.joins or "0"),
        join_late=args.join_late,
        settings=settings,
        confirm_stop=args.confirm_stop,
    )


def _read_going_on(args: Args) -> tuple[PolicySettings | None, dict[str, float]]:
    """How the policy of --start is asked from now on; None: as it was."""
    from pathlib import Path

    from gn0.policies.bae.policy_settings import join_inputs, load_policy_settings
    from gn0.policies.bae.prompt_template import ENDING
    from gn0.training.inputs import fit_prompt, read_again, read_inputs

    own = load_policy_settings(args.start)
    if all(getattr(args, name) is None for name in ASKED) and not args.inputs:
        return None, {}
    by_input = {
        name: msgspec.structs.replace(one, prompt=str(Path(args.start) / one.prompt))
        if one.prompt.endswith(ENDING) else one
        for name, one in own.by_input.items()
    }  # fmt: skip
    if all(getattr(args, name) is None for name in ASKED):
        return read_again(args.inputs, join_inputs(by_input))
    first = by_input[own.input]
    form = first.form
    if args.points is not None:
        form = msgspec.structs.replace(form, points=args.points)
    asked = msgspec.structs.replace(
        first,
        input="",
        prompt=args.prompt or first.prompt,
        prompt_digest="",
        pictures=first.pictures if args.pictures is None else split_words(args.pictures),
        without=first.without if args.without is None else split_words(args.without),
        form=form,
    )
    if args.inputs:
        return read_inputs(args.inputs, asked)
    return fit_prompt(asked), {}


def _given(args: Args, names: Sequence[str]) -> dict[str, Any]:
    found = {name: getattr(args, name) for name in names}
    return {name: value for name, value in found.items() if value is not None}


def _read_both(args: Args, recipe: Any) -> dict[str, Any]:
    """What both stages are told."""
    from gn0.training.inputs import read_shares
    from gn0.training.stage import StagePlan

    chosen = args.list_recipe()
    if args.rate and recipe.vision_rate is not None:
        chosen["vision_rate"] = args.rate  # one rate for the whole model
    return {
        **args.list_job(),
        "start": args.start,
        "inputs": {} if args.live else read_shares(args.inputs),
        "recipe": msgspec.structs.replace(recipe, **chosen),
        "plan": StagePlan(
            **args.list_plan(),
            samples=args.samples or StagePlan().samples,
            minutes=args.minutes,
        ),
        "executed": args.executed,
        "stop_share": args.stop_share,
    }
