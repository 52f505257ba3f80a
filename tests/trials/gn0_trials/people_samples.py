"""A suite to make samples of: nobody about, somebody who crosses, somebody to follow; of a bank."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from gn0.avatars import generate_bank
from gn0.missions.episode import AgentSpec, Episode, MissionFollow, MissionGoal
from gn0.people.person import EpisodePerson
from gn0.render.light import LightCondition
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.scene import Scene
from gn0.suites.suite import Suite, save_suite

BODY = AgentSpec(radius=0.25, step_seconds=0.2)
CAMERA = "tiny_128"
EVENING = LightCondition(name="evening", exposure=-1.0, kelvin=3200.0)
REFERENCE = "110101023100"  # what the agent does behind the person


def save_bank(folder: Path) -> Path:
    """Two people of few splats."""
    generate_bank(folder, count=2, seed=1, density=0.03)
    return folder


def save_flat(folder: Path) -> Scene:
    """The example flat in a folder there."""
    save_scene(replace(build_example_scene(), id="flat"), folder / "flat")
    return load_scene(folder / "flat")


def goal_episode(name: str, *people: EpisodePerson) -> Episode:
    """Two metres straight on."""
    goal = MissionGoal(goal=(3.3, 2.5), object_id="", category="bed", instruction="Go there.")
    return Episode(
        id=name, scene_id="flat", mission=goal, start=(1.3, 2.5, 0.0), path_id=name, agent=BODY,
        path=((1.3, 2.5), (3.3, 2.5)), people=people, split="train",
    )  # fmt: skip


def crossed_episode() -> Episode:
    """The same, and somebody walks across."""
    crosser = EpisodePerson(
        number=3, identity="p0001", path=((2.3, 1.4), (2.3, 2.6)), speed=0.6, after="back"
    )
    return goal_episode("b-crossed", crosser)


def follow_episode(bank_hash: str = "") -> Episode:
    """In the evening a person walks ahead, another stands aside; the agent goes after the first."""
    person = EpisodePerson(
        number=5, identity="p0000", bank=bank_hash, path=((2.6, 2.5), (3.8, 2.5)), speed=0.8
    )
    other = EpisodePerson(
        number=2, identity="p0001", path=((2.6, 1.4),), behaviour="stand", yaw=2.0
    )
    mission = MissionFollow(
        goal=(3.8, 2.5), instruction="Follow the one ahead.", human="p0000", person=5,
        category="cruise", level="distractors", distance=1.2, seconds=3.0, actions=REFERENCE,
    )  # fmt: skip
    return Episode(
        id="c-follow", scene_id="flat", mission=mission, start=(1.3, 2.5, 0.0), path_id="c",
        agent=BODY, path=((1.3, 2.5), (2.8, 2.5)), people=(other, person), split="train",
        light=EVENING,
    )  # fmt: skip


def save_peopled(folder: Path, bank: Path) -> Suite:
    """All three, in that order."""
    hashed = json.loads((bank / "bank.json").read_text())["hash"]
    return save_some(folder, goal_episode("a-alone"), crossed_episode(), follow_episode(hashed))


def save_some(folder: Path, *episodes: Episode) -> Suite:
    """A suite of some of them."""
    scene = save_flat(folder.with_name(f"{folder.name}-scene"))
    return save_suite(
        folder, [scene], episodes, name="peopled", max_steps=60, camera=CAMERA, agent=BODY
    )
