"""Profiles of a suite, and how `gn0-release` differs from `default`, item by item.

`default` is what this package stands for; `paper` reports the straight distance as NE;
`gn0-release` reproduces the official harness beside it; `vlnce` gives each VLN-CE set the body of
its own task; `evt` judges following by EVT-Bench's own numbers, with its camera. A profile is part
of a suite's hash, hence of a run's identity: numbers of two profiles are never compared by
accident.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import msgspec

from gn0.errors import ConfigError
from gn0.maps.release_map import MARGINS
from gn0.missions.episode import AgentSpec
from gn0.sim.presets import find_preset

Profile = Literal["default", "paper", "gn0-release", "vlnce", "evt"]
PROFILES: tuple[str, ...] = ("default", "paper", "gn0-release", "vlnce", "evt")
RELEASE: Profile = "gn0-release"
VLNCE: Profile = "vlnce"
EVT: Profile = "evt"
EVT_CAMERA = "evt"  # of 640 × 480 px and 90°, of which its 3,000 px are a share
ONE_STEP_PROFILES = ("paper", RELEASE)  # where a Teleport or Displacement takes one step
_DISCS = ", ".join(map(str, MARGINS))

OFFICIAL = "GN0 87ea953"  # TeleHuman/GN0, 2026-07-14
FORK = (
    "GN-Bench-Tools 64a00cb, which GN0 pinned at 76b13d7: from a public fork, the pinned submodule "
    "is not public"
)


class Difference(NamedTuple):
    """One thing that `gn0-release` does otherwise: what, both ways, and where theirs was read."""

    what: str
    default: str
    release: str
    source: str

    @property
    def told(self) -> str:
        """The release's way with its source, as the protocol card says it."""
        return f"{self.release} ({self.source})"


# every difference by name; the tests know each of them
DIFFERENCES: tuple[Difference, ...] = (
    Difference(
        "camera",
        "what the suite says, hfov and vfov by name",
        "gn_bench: 480×360, its 'HFOV: 70' is used as the vertical angle (hfov 86.07°)",
        f"the 70 in {OFFICIAL}, bae_InteriorGS_test_seen.yaml; the angle in {FORK}",
    ),
    Difference(
        "body",
        "a disc in metres; beyond the map is wall",
        f"a margin in pixels ({MARGINS[-1]} px for motion); the map's edge is no wall",
        FORK,
    ),
    Difference(
        "unfit places",
        "an episode with a blocked start or goal, or no way between them, is refused and named",
        "every episode is run; for distances a blocked start or goal is moved to the nearest "
        "passable pixel by square rings; an agent on blocked ground cannot leave it",
        FORK,
    ),
    Difference(
        "collision",
        "a move is cut at the first blocked cell; no slipping between two cells that touch",
        "Bresenham over pixels, cut in the centre of the last free pixel, also between two pixels "
        "that touch in a corner; no test within one pixel",
        FORK,
    ),
    Difference(
        "moves",
        "a Displacement or Teleport takes the steps of turning and walking there",
        "one step whatever its length, cut like any move; the metres jumped stand on the card",
        FORK,
    ),
    Difference(
        "distances",
        "any-angle shortest path on the agent's map",
        f"octile pixel paths: A* with margins {_DISCS} px in turn, lines of sight at "
        f"{MARGINS[0]} px, drawn by Bresenham; up to 8 % longer than straight",
        FORK,
    ),
    Difference(
        "the harness",
        "never acts for the agent",
        "sends STOP after more than 25 checks of unchanged distance; that STOP may score a success "
        "(counted and logged per episode)",
        f"{OFFICIAL}, run.py",
    ),
    Difference(
        "no action",
        "a policy that returns none loses its episode, by name",
        "read as STOP (counted per episode)",
        f"{OFFICIAL}, bae_agent.py and remote_nav_agent.py",
    ),
    Difference(
        "success",
        "STOP by the agent at a walking distance < 3.0 m",
        "STOP, said or forced, at 0 < distance < 3.0 m: in the goal's own pixel it is a failure",
        FORK,
    ),
    Difference(
        "oracle success",
        "walking distance < 3.0 m at any pose",
        "octile distance < 3.0 m at any pose, the goal's own pixel included (76b13d7 forgot it "
        "there)",
        f"{OFFICIAL}, measures.py, since a87e567",
    ),
    Difference(
        "SPL",
        "any-angle shortest / max(shortest, TL)",
        "octile shortest / max(shortest, TL)",
        FORK,
    ),
    Difference(
        "no way to the goal",
        "the episode is invalid, named, and in no mean",
        "its NaN and infinity become 0.0, which improves NE",
        f"{OFFICIAL}, analyze_results.py",
    ),
    Difference(
        "what means divide by",
        "scored episodes; the others are counted beside them",
        "episodes with a log; one that failed to run is left out without a word",
        f"{OFFICIAL}, analyze_results.py",
    ),
    Difference(
        "order of episodes",
        "by name",
        "by row number as text (1, 10, 100, 2): it decides which come first under --episodes",
        f"{OFFICIAL}, run.py and task.py",
    ),
    Difference(
        "not reproduced",
        "–",
        "the fitted camera transform and its half pixel, colours of its PLY decoder, a last "
        "position that survives from the episode before, start = goal dividing by zero, "
        "float32 poses",
        FORK,
    ),
)


# radius [m] and sliding of the two tasks, by the camera preset that is theirs. jacobkrantz/VLN-CE
# 729d141, habitat_extensions/config: vlnce_task.yaml names no radius, hence Habitat's 0.1
# (habitat-lab 0.1.7, AGENT.RADIUS), and ALLOW_SLIDING: True; rxr_vlnce_english_task.yaml has
# RADIUS: 0.18 and ALLOW_SLIDING: False
VLNCE_BODIES: dict[str, tuple[float, bool]] = {
    "vlnce_r2r": (0.10, True),
    "vlnce_rxr": (0.18, False),
}


def vlnce_body(own: str, eyes: AgentSpec) -> AgentSpec:
    """The body of a VLN-CE set: radius and sliding of its task, the rest of the chosen eyes.

    Args:
        own: the set's own camera preset, which says which task it is.
        eyes: the body of the camera preset in use.

    Raises:
        ConfigError: no VLN-CE set has that camera.
    """
    if own not in VLNCE_BODIES:
        raise ConfigError(
            f"profile vlnce knows no body for camera {own!r}",
            remedy="it is for sets of VLN-CE: " + ", ".join(VLNCE_BODIES),
        )
    radius, sliding = VLNCE_BODIES[own]
    return msgspec.structs.replace(eyes, radius=radius, sliding=sliding)


def profile_settings(profile: str, own: str = "", camera: str = "") -> dict[str, Any]:
    """Fields of a `SuiteFile` that a profile decides, beside its own name.

    `own` is the camera preset of the set or suite, `camera` the one in use, where another was
    chosen; only vlnce asks for them.

    Raises:
        ConfigError: vlnce, and the set is not of VLN-CE.
    """
    if profile == VLNCE:
        own = find_preset(own or "gn_bench").name
        return {"profile": profile, "agent": vlnce_body(own, find_preset(camera or own).agent)}
    if profile == EVT:
        return {"profile": profile, "camera": EVT_CAMERA}
    if profile != RELEASE:
        return {"profile": profile}
    return {
        "profile": profile,
        "camera": "gn_bench",
        "agent": AgentSpec(),
        "max_steps": 500,
        "success_radius": 3.0,
    }


def release_order(seed: int, episode_id: str) -> tuple[str, str]:
    """Sort key of the official harness: the row number, which an import keeps as seed, as text."""
    return str(seed), episode_id
