"""The policy in the box: where the weights lie that GN0 comes with."""

from __future__ import annotations

import os
from pathlib import Path

from gn0.errors import CheckpointError
from gn0.policies.bae.policy_settings import FILE
from gn0.storage import plain_path
from gn0.suites.run_files import RUN

SHIPPED = "bae-tiny"
TRAINED = "policy"  # in the folder of a training run
BASELINE = "cma.json"  # in that of a baseline, which is another room's
VARIABLE = "GN0_POLICY"  # environment: the folder of a checkpoint, in place of the shipped one
_PACKAGE = Path(__file__).resolve().parents[2]


def find_checkpoint(named: str = "", *, package: Path = _PACKAGE) -> Path:
    """The folder of a checkpoint: the named one, else $GN0_POLICY, else the one in the box.

    A wheel has it inside the package, a checkout beside `src`.

    Args:
        named: a folder, that of a training run for its policy; "" or `bae`, where no folder is
            called so, for the one in the box.
        package: folder of the package gn0.

    Raises:
        CheckpointError: there is no such folder, or this installation came without weights.
    """
    folder = plain_path(named).expanduser()
    if named and (named != "bae" or folder.is_dir()):
        if not folder.is_dir():
            raise CheckpointError(
                "no such checkpoint", where=folder, remedy="give the folder that training wrote"
            )
        if (folder / TRAINED / FILE).is_file():
            return folder / TRAINED
        if any((place / BASELINE).is_file() for place in (folder, folder / TRAINED)):
            raise CheckpointError(
                "a baseline of `gn0 train baseline`, not GN-BAE",
                where=folder,
                remedy="gn0 policy examine walks it, and so does gn0 bench run --policy cma",
            )
        if (folder / RUN).is_file():
            raise CheckpointError(
                "this training run has no policy yet",
                where=folder,
                remedy="give the same `gn0 train` command again; it goes on to the end",
            )
        return folder
    chosen = os.environ.get(VARIABLE, "")
    places = (
        [Path(chosen).expanduser()]
        if chosen
        else [package / "release" / SHIPPED, package.parents[1] / "release" / SHIPPED]
    )
    for place in places:
        if (place / FILE).is_file():
            return place
    raise CheckpointError(
        f"${VARIABLE} names no checkpoint" if chosen else "GN0 was installed without its policy",
        where=places[0],
        remedy=f"copy release/{SHIPPED} of GN0's repository, and name it by checkpoint=FOLDER or "
        f"set {VARIABLE} to it",
    )
