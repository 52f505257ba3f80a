"""A suite of two missions in the example flat: follow who walks through it, and pass who stands."""

from __future__ import annotations

from pathlib import Path

from gn0.missions.episode import Episode, MissionFollow, MissionGoal
from gn0.people.person import EpisodePerson
from gn0.scenes import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.presets import find_preset
from gn0.suites.suite import Suite, save_suite

BODY = find_preset("follower_small").agent
WALKER = EpisodePerson(
    number=3, identity="drawn:0:1", path=((2.7, 2.25), (6.5, 2.25)), behaviour="script", speed=0.9
)
STANDER = EpisodePerson(number=8, identity="drawn:0:2", path=((3.2, 2.2),), behaviour="stand")


def follow_episode(*others: EpisodePerson, **more: object) -> Episode:
    mission = MissionFollow(
        goal=(6.5, 2.25), instruction="Follow the person ahead.", human=WALKER.identity, person=3,
        level="single", category="cruise", distance=1.5, seconds=5.5, **more,  # type: ignore[arg-type]
    )  # fmt: skip
    start = (1.2, 2.25, 0.0)
    return Episode(
        id="a-follow", scene_id="example-flat", mission=mission, start=start,
        path=(start[:2], mission.goal), agent=BODY, people=(WALKER, *others),
    )  # fmt: skip


def goal_episode(*people: EpisodePerson) -> Episode:
    mission = MissionGoal(
        goal=(6.0, 2.25), object_id="", category="bed", instruction="Go to the bed."
    )
    start = (1.2, 2.25, 0.0)
    return Episode(
        id="b-goal", scene_id="example-flat", mission=mission, start=start,
        path=(start[:2], mission.goal), agent=BODY, people=people,
    )  # fmt: skip


def save_small(folder: Path, *episodes: Episode) -> Suite:
    """The suite on disk, with the small camera of the follower."""
    kept = folder.with_name(f"{folder.name}-scene")
    save_scene(build_example_scene(), kept)
    return save_suite(
        folder,
        [load_scene(kept)],
        episodes or (follow_episode(), goal_episode(STANDER)),
        name="small",
        camera="follower_small",
        agent=BODY,
        max_steps=300,
    )
