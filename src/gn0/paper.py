"""The paper's constants, each once. Line numbers are of `gn0.tex`, the source of the paper's text.

What the paper leaves open and we chose is marked "ours". Defaults of settings are taken from here;
a number that another format demands (`gn0.export`) stands with that format.

What is a rule and no number stands where it is done: docs/architecture.md names the files.
"""

from __future__ import annotations

STOP, FORWARD, LEFT, RIGHT = 0, 1, 2, 3
"""Codes of the four actions, as VLN-CE has them (l. 723)."""

FORWARD_STEP = 0.25
"""m that FORWARD moves, less where sim/collision.py cuts it (l. 723)."""

TURN_DEGREES = 15.0
"""Degrees that LEFT and RIGHT turn (l. 723)."""

BODY_RADIUS, EYE_HEIGHT = 0.20, 1.30
"""m: the agent's footprint, and its eye above the floor; open in the paper, as in its release."""

CAMERA_SIZE, CAMERA_VFOV = (480, 360), 70.0
"""Width and height [px] and vertical field of view [degrees] of preset `gn_bench`; "configurable"
in the paper (l. 657), as in its release."""

DEPTH_RANGE = (0.0, 10.0)
"""m: `LookPlan.finish` in sim/look_plan.py clips depth to it; open in the paper, as in its
release."""

MAX_STEPS = 500
"""Steps after which an episode ends; open in the paper, as its release and VLN-CE."""

SUCCESS_RADIUS = 3.0
"""m: who stops nearer than this to the goal has succeeded; strictly nearer is ours (l. 931)."""

ACTIONS_AHEAD = 6
"""Next actions that a policy predicts, and a label tells (l. 750)."""

POINTS = 13
"""Waypoints of a label: where the agent is, and twelve more (l. 1795)."""

TRACKING_POINTS = 7
"""Waypoints that a policy that follows a person answers with, its own place included (l. 1882)."""

SPACING = 0.25
"""m of arc length between waypoints: of a label (l. 1795), and of a reference path (ours)."""

MAP_BINS = 1000
"""Bins of a map's width and height, a token each: `<0>` to `<999>` (l. 726)."""

HISTORY = 16
"""Earlier views that an agent remembers (l. 706)."""

START_RADIUS, GOAL_RADIUS, FRECHET = 1.0, 1.0, 0.75
"""m: paths whose starts and goals are no farther apart are compared, and one below that discrete
Fréchet distance [m] is a duplicate; the rule is the paper's (l. 1481, 1499), the metres ours."""

HALT_STEPS = 10
"""Steps near the goal after which a walk without STOP is ended (l. 596)."""

ACTION_SHARES = {STOP: 3.0, FORWARD: 67.0, LEFT: 15.0, RIGHT: 15.0}
"""Percent of each action in balanced samples (l. 1737)."""

BEV_CUT = 2.3
"""m above the floor from which the bird's-eye view leaves out what is higher (ours)."""
