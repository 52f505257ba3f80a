"""What people add to a step of an agent who sees them walk: simulator, poses and pictures."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.people.plan import plan_people
from gn0.people.settings import PeopleSettings
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.open import open_simulator
from gn0.sim.simulator import Simulator
from gn0.testing.scenes import build_map_scene, build_point_episodes
from gn0_figures.board import FigureContext, FigureRow
from gn0_figures.device_rates import WALK
from gn0_figures.flat import build_flat, flat_floor
from gn0_figures.people_sim import FOLLOWER

SPLATS, PEOPLE, IDENTITIES = 300_000, 8, 8
_EPISODES, _STEPS = 3, 80  # of each
_NAMES = "nobody", "people", "all"


def measure_among(ctx: FigureContext, splats: int = SPLATS, steps: int = _STEPS) -> list[FigureRow]:
    """Milliseconds that eight people add to a step of an agent with RGB-D, by turns."""
    scene, episodes = _walk_in_flat(splats)
    sims = {name: _open(scene) for name in _NAMES}
    suite = sims["all"]._suite
    suite.sight = None  # who is not behind is posed
    spent: dict[str, list[float]] = {name: [] for name in _NAMES}
    asked = dict.fromkeys(_NAMES, 0)
    for number, episode in enumerate(episodes):
        for name, sim in sims.items():
            alone = msgspec.structs.replace(episode, people=())
            sim.reset(alone if name == "nobody" else episode)
            if sim._people is not None:  # read, not when they come into view
                for person in episode.people:
                    sim._people.cast.find(person.identity).reach_of(person)
        actions = random_stream(number, "figure actions").choice(4, steps, p=WALK).tolist()
        for turn, action in enumerate(actions):
            ctx.progress("among people", number * steps + turn, len(episodes) * steps)
            for name, sim in sims.items():
                begin = time.perf_counter()
                sim.step(action or 1)
                spent[name].append(time.perf_counter() - begin)
    for name in _NAMES[1:]:
        eyes: Any = sims[name]._people
        asked[name] = eyes.posed.hits + eyes.posed.misses
    mean = {name: 1e3 * float(np.mean(taken)) for name, taken in spent.items()}
    detail = (
        f"standard flat, {splats:,} splats, RGB-D of 224x224; {len(episodes)} episodes of {steps} "
        f"steps, agents at random among {PEOPLE} of {IDENTITIES} identities who walk, opened "
        f"before; {mean['nobody']:.2f} ms with nobody there; means by turns, poses included. "
    )
    told = f"{asked['people'] / len(spent['people']):.1f} people posed or found a step"
    other = f"{asked['all'] / len(spent['all']):.1f}"
    return [
        FigureRow(
            name="a step among eight who walk", value=mean["people"] - mean["nobody"], unit="ms",
            detail=detail + told,
        ),
        FigureRow(
            name="the same if all were posed who are not behind",
            value=mean["all"] - mean["nobody"], unit="ms", detail=f"{detail}{other} a step",
        ),
    ]  # fmt: skip


def _open(scene: Scene) -> Simulator:
    return open_simulator(
        scene, "rgbd_224", sensors=("rgb", "depth"), backend="cpu", agent=FOLLOWER,
        max_steps=10**6,
    )  # fmt: skip


def _walk_in_flat(splats: int) -> tuple[Scene, list[Episode]]:
    """A flat, and episodes in it with people who walk; everybody is built."""
    cloud = build_flat(splats)
    scene = replace(
        build_map_scene(flat_floor(0.0), "flat"),
        load_cloud=lambda: cloud,
        cloud_hash=cloud.content_hash,
    )
    walks = PeopleSettings(count=PEOPLE, seed=3, groups=0.0, seated=0.0, variety=IDENTITIES)
    ground = NavigationMap(scene.grid, FOLLOWER.radius)
    episodes = [
        msgspec.structs.replace(
            bare, people=plan_people(scene, bare, walks, radius=FOLLOWER.radius)
        )
        for bare in build_point_episodes(scene, ground, _EPISODES, agent=FOLLOWER)
    ]
    return scene, episodes
