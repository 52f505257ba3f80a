"""Say in plain words what is wrong with a scene, before anyone wastes an hour on it.

Errors (the scene should not be used) end with exit code 1; warnings (it can be, but look) and notes
with 0.
"""

from __future__ import annotations

from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = "  gn0 scene check out/house"


class Args(Config, frozen=True):
    """The scene.

    Attributes:
        folder: a scene folder.
    """

    folder: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")]


def run(args: Args) -> int:
    """Print the findings, worst first."""
    from gn0.cli.console import draw_progress
    from gn0.scenes.check import check_folder
    from gn0.scenes.folder import load_scene
    from gn0.viewer.see_through import check_see_through

    with draw_progress("checking the scene"):
        findings = check_folder(args.folder)
        if not any(finding.level == "error" for finding in findings):
            found = check_see_through(load_scene(args.folder))
            findings = (
                [f for f in findings if f.level == "warning"]
                + found
                + [f for f in findings if f.level == "note"]
            )
    for finding in findings:
        print(f"{finding.level:<8}{finding.code}: {finding.text}")
        if finding.remedy:
            print(f"        → {finding.remedy}")
    wrong = [f for f in findings if f.level != "note"]
    print(f"{args.folder}: " + (f"{len(wrong)} to look at" if wrong else "fit to navigate"))
    return 1 if any(f.level == "error" for f in findings) else 0
