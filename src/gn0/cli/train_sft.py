"""Train a policy on what the expert would do: supervised fine-tuning, the paper's first stage.

States come from the expert's own walks through a suite (walks), from anywhere in its scenes
(uniform), or from a dataset; pictures and labels are made beside the learner, on its card. A run
that was stopped goes on when the same command is given again. The trained policy is in OUT/policy,
and `gn0 bench run SUITE --policy bae --policy-option checkpoint=OUT/policy` examines it.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from gn0.cli.comma_lists import read_joins, read_numbers, split_words
from gn0.cli.train_flags import ImitationFlags, Minutes, resolve_start, train_stage
from gn0.errors import ConfigError

EXAMPLES = """  gn0 train sft out/suite --out out/sft
  gn0 train sft out/suite --source uniform --pictures near,far --minutes 8 --out out/sft
  gn0 train sft out/suite --pictures rgb,history --points 0 --samples 4000000 --out out/views
  gn0 train sft out/suite --inputs all:0.5,views:0.3,maps:0.2 --out out/every
  gn0 train sft out/suite --prompt paper_planning_maps --out out/paper
  gn0 train sft out/first out/second --source dataset --shares 0.7,0.3 --out out/both
  gn0 train sft out/dataset --source dataset --recipe pretrained --start Qwen3-VL-4B-Instruct \\
      --layout json --lora 16 --batch 8 --out out/sft-4b
  gn0 train sft out/first out/second out/third --joins 0,500000,1500000 --text-length 120 \\
      --out out/growing
  gn0 train sft out/suite --split all --held-out "" --size nano --samples 64 --batch 8 \\
      --agents 4 --device host --out out/tried"""


class Args(ImitationFlags, frozen=True, kw_only=True):
    """What to train, on what, and how.

    Attributes:
        suite: suite folders, as `gn0 missions generate` writes; datasets' with --source dataset.
        joins: samples drawn when each suite joins, with commas between; those of one number join
            together, and a suite that is not there yet is waited for. By default all are there from
            the first sample on.
        join_late: do not wait for suites that are not there yet: learn on, and take each up when it
            is there, unless the rate falls by then.
        source: where states come from: walks of the expert, uniform over the scenes, or datasets.
        shares: of the samples, one a dataset with commas between; by their sizes by default.
        recipe: how it learns: scratch, from random weights; pretrained, the paper's rates.
        size: of a model from random weights: nano (2 M) or tiny (17 M).
        start: a folder to start from instead: a policy, its run, or any Qwen3-VL as safetensors;
            bae for the policy in the box.
        prompt: a prompt of `gn0 list prompts`, or the path of one; what it does not leave open
            (pictures, points, layout) is its own.
        pictures: what the prompt shows, with commas between: rgb, history, near and far of the
            ego map, and whole maps: bev, occupancy.
        map_size: width and height [px] that whole maps of any scene are brought to.
        inputs: several inputs of one policy with their shares of the steps, in place of --pictures
            and --points: all (rgb, history, near, far; 13 waypoints), views (rgb, history; none),
            maps (near, far; 13), a prompt of `gn0 list prompts` whose pictures are given, or one of
            your own as NAME=rgb+near/13:SHARE. The first is the default.
        map_paint: what near and far show as BEV: the scene, or the categories of its objects, an
            oracle map: a control.
        without: parts of the prompt that are left out, with commas between; paper for what the
            paper's prompts do not tell: heading, last_action and bumper.
        points: waypoints of an answer; 0 for actions alone.
        layout: of answers: compact or json.
        order: of answers: waypoints first, as in the paper, or actions first.
        preset: of the cameras, as in `gn0 list presets`.
        samples: to learn from.
        minutes: of training at most; the rate falls in time for it. 0 for no limit.
        rate: the learning rate; the recipe's when 0, of pretrained ten times as much with --lora.
        lora: rank of adapters that learn in place of all weights of --start; 0 for none.
        kept: states of walks that batches are drawn from.
        ratio: new states of walks a sample.
        examine: steps from examination to examination; 0 for one at the end.
    """

    joins: str = "0"
    join_late: bool = False
    source: Literal["walks", "uniform", "dataset"] = "walks"
    shares: str = ""
    recipe: Literal["scratch", "pretrained"] = "scratch"
    size: str = "tiny"
    start: str = ""
    prompt: str = "short"
    pictures: str = "near,far"
    map_size: str = "128,128"
    inputs: str = ""
    map_paint: Literal["scene", "categories"] = "scene"
    without: str = ""
    points: Annotated[int, msgspec.Meta(ge=0, le=64)] = 13
    layout: Literal["compact", "json"] = "compact"
    order: Literal["paper", "actions_first"] = "paper"
    preset: str = "tiny_128"
    samples: Annotated[int, msgspec.Meta(ge=1)] = 8_000_000
    minutes: Minutes = 0
    lora: Annotated[int, msgspec.Meta(ge=0, le=1024)] = 0
    kept: Annotated[int, msgspec.Meta(ge=1)] = 200_000
    ratio: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.5


def run(args: Args) -> int:
    """Train, and say where the policy lies."""
    from gn0.cli.train_packages import check_packages
    from gn0.data.answer_form import AnswerForm
    from gn0.data.dataset import open_dataset
    from gn0.policies.bae.policy_settings import PolicySettings
    from gn0.sim.ego_map import MapView
    from gn0.suites.suite_kept import load_suite_kept

    # what is learned from is looked at first: packages are of no help against a broken folder
    for dataset in args.suite if args.source == "dataset" else ():
        open_dataset(dataset)
    if args.source != "dataset":
        load_suite_kept(args.suite[0])
    args = resolve_start(args)
    check_packages()
    from gn0.training.inputs import fit_prompt, read_inputs
    from gn0.training.recipe import RECIPES
    from gn0.training.sft import SftJob, train_sft
    from gn0.training.stage import StagePlan

    recipe = RECIPES[args.recipe]
    chosen = args.list_recipe()
    if args.lora:
        chosen["lora"] = args.lora
        if args.recipe == "pretrained":
            chosen.setdefault("rate", 10 * recipe.rate)
    settings = PolicySettings(
        prompt=args.prompt,
        pictures=split_words(args.pictures),
        form=AnswerForm(points=args.points, layout=args.layout, order=args.order),
        without=split_words(args.without),
        preset=args.preset,
        view=MapView(paint=args.map_paint),
        map_size=_read_size(args.map_size),
    )
    inputs: dict[str, float] = {}
    if args.inputs:
        settings, inputs = read_inputs(args.inputs, settings)
    else:
        settings = fit_prompt(settings)
    job = SftJob(
        **args.list_job(),
        joins=read_joins(args.joins),
        join_late=args.join_late,
        source=args.source,
        size=args.size,
        start=args.start,
        settings=settings,
        inputs=inputs,
        shares=read_numbers(args.shares, float, "--shares", "0.7,0.3"),
        recipe=msgspec.structs.replace(recipe, **chosen),
        plan=StagePlan(**args.list_plan(), samples=args.samples, minutes=args.minutes or None),
        kept=args.kept,
        ratio=args.ratio,
    )
    return train_stage(args, train_sft, job)


def _read_size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(one) for one in split_words(text))
    except ValueError:
        raise ConfigError(
            f"no size: {text!r}", where="--map-size", remedy="give 128,128 or the like"
        ) from None
    return width, height
