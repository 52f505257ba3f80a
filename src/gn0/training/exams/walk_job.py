"""`WalkJob`: which policy walks where, and how it is asked."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from gn0.config import Config
from gn0.missions.controls import Control
from gn0.policies.bae.draws import MOST
from gn0.policies.bae.waypoint_plan import Carried

Dtype = Literal["auto", "float32", "bfloat16"]


class WalkJob(Config, frozen=True):
    """Which policy walks where, and how.

    Attributes:
        checkpoint: folder of the policy; "" or `bae` for the one in the box.
        suite: folder of the suite.
        splits: of the suite; all when empty.
        control: what is taken away from the policy.
        inputs: in which of its ways the policy is asked, where it was trained in several; its
            default when empty.
        executed: actions of an answer that are carried out; 0: as the policy says.
        draw_after: actions without getting anywhere after which answers are drawn; 0: never, -1: as
            the policy says.
        confirm_stop: a STOP behind the first action of an answer is asked again.
        carried: the actions of an answer, or its waypoints; see `ClosedLoop`.
        episodes: that are walked, evenly over the suite; 0 for all.
        agents: side by side, all asked in one batch; who has ended begins the next episode.
        dtype: of what is computed; auto: bfloat16 on a card, else float32.
    """

    checkpoint: str
    suite: str
    splits: tuple[str, ...] = ("val_unseen",)
    control: Control = "none"
    inputs: str = ""
    executed: Annotated[int, msgspec.Meta(ge=0)] = 0
    draw_after: Annotated[int, msgspec.Meta(ge=-1, le=MOST)] = -1
    confirm_stop: bool = False
    carried: Carried = "actions"
    episodes: Annotated[int, msgspec.Meta(ge=0)] = 0
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 1024
    dtype: Dtype = "auto"
