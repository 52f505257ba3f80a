"""Make the page of a study: many policies, with intervals, paired differences and verdicts.

A study is described by a file: which policies were to be trained and examined, and which claims are
to be judged. Walks of `gn0 policy examine` and runs of `gn0 bench run` are looked for below FOLDER;
what is not there is said to be not run, or taken from a page before with --onto, where walks of
machines that are gone are rows. Of walks that are under way in FOLDER nothing is taken over; what
an arm that was trained anew has not begun is still the old one's. The intervals alone decide
whether a claim held. Needs no torch.
"""

from __future__ import annotations

from collections import Counter
from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 policy study runs/ablation/study.yaml out/ablation --out docs/ablation.md
  gn0 policy study runs/ablation/study.yaml out/today --onto docs/ablation.md --out page.md"""


class Args(Config, frozen=True):
    """A study, where its walks lie, and its page.

    Attributes:
        study: the description of the study, YAML.
        folder: below which its walks and training runs lie.
        out: the page to write, Markdown.
        onto: a page of this study from before; its rows stand where they are of more seeds than
            what lies below FOLDER. May be the page to write.
    """

    study: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="STUDY")]
    folder: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    out: str
    onto: Annotated[str, tyro.conf.arg(metavar="PAGE")] = ""


def run(args: Args) -> int:
    """Write the page, and print a line a claim."""
    from gn0.cli.console import plain_text
    from gn0.training.study.study_page import write_study

    judged = write_study(
        args.study,
        args.folder,
        args.out,
        onto=args.onto or None,
        say=lambda text: print(plain_text(text)),
    )
    for one in judged:
        print(f"{one.verdict:<18} {plain_text(' '.join(one.claim.text.split()))}")
    counts = Counter(one.verdict for one in judged)
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    print(f"page: {args.out}")
    return 0
