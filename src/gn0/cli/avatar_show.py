"""Draw an avatar: front, sides, back and face, or all avatars of a bank on one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 avatar show out/bank --out people.png
  gn0 avatar show out/bank --name p0003 --out person.png
  gn0 avatar show out/bank/p0003.npz"""


class Args(Config, frozen=True):
    """What to draw, and where.

    Attributes:
        source: a bank, or the file of one avatar.
        name: one avatar of the bank; all without it.
        out: the picture to write, .png or .jpg.
    """

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="BANK")]
    name: str = ""
    out: str = "avatar.png"


def run(args: Args) -> int:
    """Draw and write; say what is in it."""
    from gn0.avatars.bank import open_avatars
    from gn0.cli.console import draw_progress
    from gn0.cli.picture_file import check_picture, write_picture
    from gn0.counted import counted
    from gn0.storage import check_writable
    from gn0.viewer.avatar_sheet import (
        describe_avatar,
        draw_avatars,
        draw_portrait,
        list_record,
    )

    out = Path(args.out)
    check_picture(args.out)
    check_writable(out)
    avatars = open_avatars(args.source, args.name)
    with draw_progress() as progress:
        if len(avatars) == 1:
            sheet = draw_portrait(avatars[0])
        else:
            sheet = draw_avatars(avatars, progress=progress)
    write_picture(args.out, sheet)
    if len(avatars) == 1:
        for key, value in list_record(avatars[0].record):
            print(f"{key:<16}{value}")
        print(" / ".join(describe_avatar(avatars[0])))
    else:
        print(counted(len(avatars), "person", "people"))
    print(f"written to {out}")
    return 0
