"""Say what is wrong with avatars: skin through clothes, feet off the floor, a wrong colour's name.

Each is posed standing, in a stride and seated, seen from four sides, and its pixels are counted.
Exit code 1 if anything is found.
"""

from __future__ import annotations

from typing import Annotated

import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 avatar check out/bank
  gn0 avatar check out/bank --name p0003"""


class Args(Config, frozen=True):
    """Whom to look at.

    Attributes:
        source: a bank, or the file of one avatar.
        name: one avatar of the bank; all without it.
    """

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="BANK")]
    name: str = ""


def run(args: Args) -> int:
    """Print the findings, person by person."""
    from gn0.avatars.bank import open_avatars
    from gn0.avatars.poses import trial_poses
    from gn0.cli.console import draw_progress
    from gn0.viewer.avatar_check import check_avatar

    avatars = open_avatars(args.source, args.name)
    found = {}
    with draw_progress() as progress:
        for number, avatar in enumerate(avatars):
            progress("checking", number, len(avatars))
            found[avatar.name] = check_avatar(avatar, trial_poses())
        progress("checking", len(avatars), len(avatars))
    for name, findings in found.items():
        for finding in findings:
            print(f"{name:<9} {finding.code}: {finding.text}")
    wrong = sum(bool(findings) for findings in found.values())
    print(
        f"{counted(len(avatars), 'avatar')}: "
        + (f"{wrong} to look at" if wrong else "nothing is wrong")
    )
    return 1 if wrong else 0
