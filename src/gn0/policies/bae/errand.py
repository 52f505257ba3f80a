"""An errand: a text, a place to begin, and no known goal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gn0.errors import ConfigError, PolicyError
from gn0.geometry import Pose2D
from gn0.maps.goal_places import points_in_polygon
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, MissionInstruction
from gn0.policies.bae.decision import StepAsked
from gn0.policies.bae.policy_bae import PolicyBae
from gn0.policies.bae.prompt_fields import clean_instruction
from gn0.policies.parse_then_astar import search_target
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action


@dataclass(frozen=True)
class ErrandEnd:
    """How an errand ended.

    Attributes:
        stopped: by STOP, as opposed to running out of steps.
        steps: actions, STOP included.
        metres: walked.
        forwards, cut_short: FORWARDs, and those that an obstacle cut short.
        pose: where it ended.
        room: in which room; "" where the scene names none there.
        target: the name that the text sends to; "" where it has none.
        targets: places known by that name.
        distance: walking distance to the nearest of them [m]; infinite where none can be reached.
    """

    stopped: bool
    steps: int
    metres: float
    forwards: int
    cut_short: int
    pose: Pose2D
    room: str
    target: str
    targets: int
    distance: float

    @property
    def lines(self) -> tuple[str, ...]:
        """In words."""
        how = "it said STOP" if self.stopped else "it ran out of steps"
        walked = f"{self.metres:.1f} m walked" if self.forwards else "it never went forward"
        cut = f", {self.cut_short} of {self.forwards} FORWARDs cut short" if self.forwards else ""
        degrees = math.degrees(self.pose.yaw) % 360
        where = (
            f"it stands at ({self.pose.x:.2f}, {self.pose.y:.2f}) m, looking along {degrees:.0f}°"
        )
        if not self.target:
            goal = "the text names nothing that is known by name, so nobody can say how near it is"
        elif not self.targets:
            goal = f"no {self.target} is labelled in this scene that one can walk up to"
        elif math.isinf(self.distance):
            goal = f"no way leads from there to a {self.target}"
        else:
            goal = f"a place beside the nearest {self.target} is {self.distance:.2f} m away on foot"
        return (
            f"{how} after {self.steps} steps: {walked}{cut}",
            where + (f", in the {self.room}" if self.room else ""),
            goal,
        )


def check_errand(policy: PolicyBae, text: str) -> str:
    """The text as it is asked, before a scene is opened for it.

    Raises:
        ConfigError: it is empty, says nothing but tokens, or is too long for the checkpoint.
        PolicyError: the checkpoint is shown its goal as a picture, and there is none.
    """
    words = clean_instruction(text)
    policy.questions.check(words)
    if "goal_picture" in policy.sensors:
        raise PolicyError(
            "this checkpoint is shown its goal as a picture, and an errand is words",
            where=policy.questions.folder,
            remedy="ask a checkpoint whose prompt has the instruction",
        )
    return words


def choose_start(navigation: NavigationMap, agent: AgentSpec, scene: Scene, seed: int) -> Pose2D:
    """A free place of the largest region, and a heading, drawn by a seed."""
    stream = random_stream(seed, "errand", scene.id)
    cells = np.argwhere(navigation.regions == 0)
    x, y = navigation.grid.centres_of(cells[int(stream.integers(len(cells)))][None])[0].tolist()
    turns = max(round(360 / agent.turn_degrees), 1)
    return Pose2D(x, y, math.radians(float(stream.integers(turns)) * agent.turn_degrees))


def build_errand(
    simulator: Simulator, text: str, start: Pose2D | None = None, seed: int = 0
) -> Episode:
    """An episode of a text; what it has for a goal is where it begins, and nobody looks at it.

    Args:
        simulator: of the scene.
        text: of `check_errand`.
        start: where; a free place by the seed when None.
        seed: of everything random.

    Raises:
        ConfigError: the agent cannot stand at the start.
    """
    navigation, scene = simulator.navigation, simulator.scene
    pose = start or choose_start(navigation, simulator.agent, scene, seed)
    if not navigation.is_free(pose.x, pose.y):
        near = navigation.nearest_free(pose.x, pose.y)
        raise ConfigError(
            f"the agent cannot stand at ({pose.x:g}, {pose.y:g}) m",
            where="start",
            remedy="leave it out, and a free place is chosen"
            if near is None
            else f"the nearest free place is {near[0]:.2f},{near[1]:.2f}",
        )
    here = (pose.x, pose.y)
    return Episode(
        id="errand",
        scene_id=scene.id,
        mission=MissionInstruction(goal=here, instruction=text),
        start=(pose.x, pose.y, pose.yaw),
        path=(here,),
        seed=seed,
        agent=simulator.agent,
    )


def end_errand(simulator: Simulator, text: str, steps: list[StepAsked]) -> ErrandEnd:
    """How a walk ended; the nearest thing of the name in the text is found by the labels."""
    end = steps[-1].after
    said, places = search_target(simulator, text)
    distance = math.inf
    if places:
        field = simulator.navigation.geodesic((end.x, end.y), keep=False)
        distance = float(np.min(field.distance(np.array(places, np.float64))))
    here = np.array([[end.x, end.y]])
    rooms = [
        room.type
        for room in simulator.scene.rooms
        if points_in_polygon(here, np.array(room.polygon, np.float64))[0]
    ]
    forwards = [step for step in steps if step.action == Action.FORWARD]
    metres = sum(
        math.hypot(step.after.x - step.pose.x, step.after.y - step.pose.y) for step in steps
    )
    return ErrandEnd(
        stopped=steps[-1].action == Action.STOP,
        steps=len(steps),
        metres=metres,
        forwards=len(forwards),
        cut_short=sum(step.collided for step in forwards),
        pose=end,
        room=rooms[0] if rooms else "",
        target=said,
        targets=len(places),
        distance=distance,
    )
