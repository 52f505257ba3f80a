"""The protocol card: what the harness really did, in words; and the identity of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from gn0.bench.identity import tell_identity
from gn0.bench.results import Isolation, Moves, PolicyCard
from gn0.counted import counted
from gn0.missions.controls import CONTROL_WORDS, Control
from gn0.missions.episode import Episode, MissionFollow, PathSource, tell_pace
from gn0.missions.follow_rules import follow_rules
from gn0.render.open import name_drawing
from gn0.render.renderer import VISIBLE_BACKENDS
from gn0.sim.presets import find_preset
from gn0.sim.state import MapMode
from gn0.storage import content_hash
from gn0.suites.profiles import DIFFERENCES, ONE_STEP_PROFILES, RELEASE
from gn0.suites.suite import Suite
from gn0.suites.track import judge_policy, tell_track
from gn0.version import source_version

# what decides a result; the rest of the package may change between two sessions of one run
_DECIDING = (
    "geometry.py", "paper.py", "seeds.py", "gaussians", "maps", "render", "missions", "sim",
    "policies", "bench/metrics.py", "bench/release_score.py", "bench/episode_worker.py",
    "bench/episode_group.py", "bench/company_watch.py", "bench/follow_metrics.py",
    "bench/follow_recorder.py", "data/follow.py", "data/follow_oracle.py", "data/follow_search.py",
    "data/follow_reference.py", "people", "avatars", "device/kernels",
)  # fmt: skip


def code_version() -> str:
    """The package's version and a digest of the source that decides results."""
    return source_version(_DECIDING)


def config_hash(
    suite: Suite,
    policy: str,
    options: Mapping[str, Any],
    backend: str,
    episodes: int,
    isolated: bool = False,
    control: Control = "none",
    bank: str = "",
) -> str:
    """Digest of what decides a result beside suite and code; workers and order do not.

    Isolation does not either, but a run is isolated as a whole or not at all. `bank` is the content
    hash of the bank of people that is shown.
    """
    return content_hash(
        suite.hash,
        policy,
        msgspec.json.encode(dict(options), order="deterministic"),
        backend,
        episodes,
        *(["isolated"] if isolated else []),
        *([f"control {control}"] if control != "none" else []),
        *([f"bank {bank}"] if bank else []),
    )


MAP_WORDS: dict[MapMode, str] = {
    "prior": "bev and occupancy show the whole scene, as a robot that was here before has it",
    "explored": "bev and occupancy show what the agent's own depth has seen since reset; of the "
    "rest only the extent of the map is known",
    "none": "there is no bev and no occupancy picture",
}


VISIBLE_WORDS = (
    "drawn from visible sets: only splats that show from free places of the same 0.5 m floor cell; "
    "nearly, not exactly, the pictures of all splats"
)


SLIDING_WORDS = (
    "what is left of it is projected on the wall's tangent, at most twice, never into a blocked "
    "cell, and it counts as a collision; upstream's agent slides on Habitat's navmesh, so that the "
    "two agree in kind and not to the centimetre"
)

CUDA_WORDS = "drawn by the CUDA renderer: the CPU renderer's pictures up to rounding"


PATH_WORDS: dict[PathSource, str] = {
    "": "as the suite has it",
    "truth": "the set's dense ground truth as it stands, seen from above (VLN-CE's gt locations)",
    "file": "the set's own path as it stands, points at most 0.25 m apart",
    "resampled": "the set's sparse nodes joined by straight lines, points at most 0.25 m apart; "
    "not what its own benchmark scores, if that has a dense ground truth",
}


def describe_paths(episodes: Sequence[Episode]) -> str:
    """What nDTW and SDTW compare with, and in how many episodes if not in all alike."""
    counts = Counter(episode.path_source for episode in episodes)
    told = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    if len(told) == 1:
        words = PATH_WORDS[told[0][0]]
    else:
        words = "; ".join(f"in {counted(n, 'episode')} {PATH_WORDS[source]}" for source, n in told)
    return f"nDTW and SDTW, by exact DTW: {words}"


def describe_moves(suite: Suite, moves: Moves | None) -> str:
    """What a Teleport or Displacement costs, and how far those of the run went."""
    body = suite.about.agent
    if suite.about.profile in ONE_STEP_PROFILES:
        rule = "a Displacement or Teleport takes one step whatever its length"
    else:
        rule = (
            f"a Displacement or Teleport over d m takes max(1, ⌈d / {body.forward_step:g} m⌉ + "
            f"⌈turns / {body.turn_degrees:g}°⌉) steps, turns being that to its bearing and that at "
            "its end; cut, it is one collision among its steps"
        )
    if moves is None or not moves.count:
        return f"{rule}; this run made none" if moves is not None else rule
    told = f"{moves.count:,} in this run, {moves.metres:,.1f} m in all, the longest "
    return f"{rule}; {told}{moves.longest:.1f} m"


ISOLATION_WORDS: dict[Isolation, str] = {
    "in-process": "in-process: the policy runs in the harness's own memory, where nothing keeps it "
    "from looking for the simulator",
    "own process": "own process, same user: no memory is shared with the harness, an empty folder, "
    "no path of suite or scene; files are not isolated",
    "server": "behind a socket, wherever its server runs",
    "a person": "a person at a page that shows what is named above and nothing else",
}


def protocol_card(
    suite: Suite,
    card: PolicyCard,
    code: str,
    backend: str = "auto",
    moves: Moves | None = None,
    control: Control = "none",
    episodes: Sequence[Episode] | None = None,
) -> tuple[tuple[str, str], ...]:
    """(what, how) rows of a run; nothing here depends on workers, order or host.

    `moves` are the Teleports and Displacements of the run, once it has been run; `control` is what
    was taken away from the policy; `episodes` are those of the run, all of the suite when None.
    """
    played = suite.episodes if episodes is None else episodes
    few = ""
    if len(played) < len(suite.episodes):
        few = f"; of its {counted(len(suite.episodes), 'episode')} the first {len(played):,}, by id"
    about, agent = suite.about, suite.about.agent
    preset = find_preset(about.camera)
    width, height = preset.picture_size
    sees = ", ".join(card.sensors) or "nothing but the instruction and its bumper"
    if card.privileged:
        sees += "; and the simulator itself (map, pose, goal): an oracle, no robot could do this"
    elif "goal_vector" in card.sensors:
        sees += "; goal_vector tells it where the goal is"
    if "pose" in card.sensors:
        sees += "; pose is exact: odometry without drift, from a start known in the scene's frame"
    radius = about.success_radius
    rows = (
        ("suite", f"{suite.name}, version {about.version}, hash {suite.hash}{few}"),
        ("policy", card.name),
        *_identity_rows(card),
        ("the policy sees", sees),
        *((("control", CONTROL_WORDS[control]),) if control != "none" else ()),
        ("track", tell_track(suite.track, suite.map_mode)),
        *_standing_rows(suite, card),
        ("isolation", ISOLATION_WORDS[card.isolation]),
        *card.rows,
        (
            "camera",
            f"{about.camera}: {width}×{height}, hfov {preset.rgb.hfov:.2f}°, "
            f"vfov {preset.rgb.vfov:.2f}°, {agent.camera_height:g} m above the floor, "
            f"pitch {preset.pitch_degrees:g}°",
        ),
        *((("pictures", VISIBLE_WORDS),) if backend in VISIBLE_BACKENDS else ()),
        *((("pictures", CUDA_WORDS),) if name_drawing(backend) == "cuda" else ()),
        (
            "agent",
            f"disc of radius {agent.radius:g} m between centres of cells; against exact geometry "
            "its rim may enter a blocked cell, by less than √2 cells (docs/maps.md)",
        ),
        (
            "actions",
            f"STOP, FORWARD {agent.forward_step:g} m, LEFT and RIGHT {agent.turn_degrees:g}°"
            + tell_pace(agent),
        ),
        ("moves", describe_moves(suite, moves)),
        (
            "collision",
            "a move is cut at the first blocked cell of the inflated map; "
            + (SLIDING_WORDS if agent.sliding else "no sliding"),
        ),
        ("success", f"STOP at a walking distance < {radius:g} m; equality is a failure"),
        ("oracle success", f"walking distance < {radius:g} m at any pose, start included"),
        ("distances", "geodesic: any-angle shortest path on the agent's inflated map"),
        ("reference path", describe_paths(played)),
        *_goal_rows(played),
        *_follow_rows(suite, played),
        *_people_rows(played),
        (
            "navigation error",
            "both are reported; profile "
            + (
                "paper: NE is the straight distance"
                if about.profile == "paper"
                else "default: NE is the walking distance"
            ),
        ),
        ("step limit", f"{about.max_steps} steps; running out is not a STOP and no success"),
        (
            "the harness",
            "never acts for the agent: it sends no STOP, no retry within an episode, no hint",
        ),
        ("map mode", f"{suite.map_mode}: {MAP_WORDS[suite.map_mode]}"),
        (
            "the scene's map",
            "unknown cells count as occupied; what moves, collides and measures is always the "
            "whole map, which does not change in an episode",
        ),
        ("time", "simulated; a slow policy is not punished"),
        (
            "episodes without a score",
            "counted and named, never averaged; the exit code is not 0 when there is one",
        ),
        ("randomness", "one stream an episode, named by seed, policy and episode"),
        ("intervals", "95 %, percentile bootstrap over scenes where there are several, else "
                      "episodes, 10,000 draws"),
        ("code", f"gn0 {code}"),
    )  # fmt: skip
    return _release_rows(rows) if about.profile == RELEASE else rows


def _standing_rows(suite: Suite, card: PolicyCard) -> tuple[tuple[str, str], ...]:
    """How the policy stands to the suite's track."""
    standing, beyond = judge_policy(suite.track, card.sensors, card.privileged)
    if standing == "no track":
        return ()
    words = {
        "on the track": "it asks for nothing that the track does not allow",
        "off the track": f"off the track: it is also told {', '.join(beyond)}; not to be compared "
        "with policies that are not",
        "oracle": "an oracle, outside any track",
    }
    return (("policy and track", words[standing]),)


def _identity_rows(card: PolicyCard) -> tuple[tuple[str, str], ...]:
    """Who the policy is; one of GN0's own that declares nothing is told by the code's digest."""
    if not card.source and not card.identity:
        return ()
    parts = [f"source {card.source}"] if card.source else []
    parts.append(tell_identity(card.identity))
    return (("policy identity", "; ".join(parts)),)


def _goal_rows(episodes: Sequence[Episode]) -> tuple[tuple[str, str], ...]:
    """What counts where words fit several places; no row in a run that has no such episode."""
    several = sum(e.goal_set is not None and not e.in_area for e in episodes)
    areas = sum(e.in_area for e in episodes)
    if not several and not areas:
        return ()
    return (
        (
            "goals",
            f"{several} of {counted(len(episodes), 'episode')} accept every instance that their "
            f"words fit: distances are to the nearest; {areas} end in an area: success is a STOP "
            "inside it, at no distance",
        ),
    )


def _follow_rows(suite: Suite, episodes: Sequence[Episode]) -> tuple[tuple[str, str], ...]:
    """What counts where somebody is followed; no row in a run that has no such episode."""
    count = sum(isinstance(e.mission, MissionFollow) for e in episodes)
    if not count:
        return ()
    rules = follow_rules(suite.about.profile)
    pixels = f", more than {rules.least_pixels} pixels" if rules.least_pixels else ""
    touch = (
        f"a centre distance below {rules.touch_within:g} m"
        if rules.touch_within
        else "a move cut short because of a person, by the agent"
    )
    return (
        (
            "following",
            f"{count} of {counted(len(episodes), 'episode')}: a step follows within "
            f"{rules.reach:g} m of the person, who fills {rules.least_share:.1%} to "
            f"{rules.most_share:.0%} of the picture{pixels}; STOP "
            f"{'ends the episode' if rules.stop_ends else 'stands still'}; "
            f"the end is {rules.linger:g} s after the person's track, at a touch ({touch}), when "
            f"lost ({rules.lost_after} steps beyond {rules.lost_beyond:g} m) or after "
            f"{rules.max_steps} steps; success is to follow then (docs/following.md). Rows on "
            "success and step limit are of other missions",
        ),
    )


def _people_rows(episodes: Sequence[Episode]) -> tuple[tuple[str, str], ...]:
    """How people count in missions to a goal; no row in a run that has no such episode."""
    among = [
        episode.people
        for episode in episodes
        if episode.people and not isinstance(episode.mission, MissionFollow)
    ]
    if not among:
        return ()
    most = max(map(len, among))
    return (
        (
            "people",
            f"{len(among)} of {counted(len(episodes), 'episode')} have people, {most} at most: "
            "they move while the agent acts, and are obstacles; a touch is a move cut short "
            "because of one, by the agent; it ends nothing, and CR is the share of episodes that "
            "have one",
        ),
    )


def _release_rows(rows: tuple[tuple[str, str], ...]) -> tuple[tuple[str, str], ...]:
    """The card of a run under the official harness: its own words wherever it differs."""
    told = {rule.what: rule.told for rule in DIFFERENCES}
    del told["moves"]  # its row says how far they went as well
    read = next(rule.source for rule in DIFFERENCES if rule.what == "moves")
    camera = told.pop("camera")
    told["agent"] = told.pop("body")
    told["navigation error"] = "gn0-release: octile distance left; ours beside it"
    card = {what: told.pop(what, how) for what, how in rows}
    card["camera"] += f"; {camera}"
    card["moves"] += f" ({read})"
    return tuple({"profile": "gn0-release; each score stands beside ours", **card, **told}.items())
