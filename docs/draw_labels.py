"""Draw docs/pictures/labels.png: one label on a plan, and labels along the way of a policy."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gn0 import Simulator
from gn0.data import EXACT, DaggerSettings, collect_visited, label_states, walk_actions
from gn0.maps import NavigationMap
from gn0.missions import sample_goal_episodes
from gn0.policies import PolicyStraight
from gn0.scenes import build_example_scene
from gn0.sim import SensorConfig

OUT = Path(__file__).resolve().parent / "pictures" / "labels.png"
SCALE = 7  # pixels of the picture a cell
GREY, WALL, BODY = (236, 236, 232), (70, 70, 74), (176, 178, 182)
ORANGE, BLUE, RED, GREEN = (235, 120, 20), (25, 95, 200), (200, 30, 40), (20, 140, 70)


class Plan:
    """A map to draw on, in metres."""

    def __init__(
        self, navigation: NavigationMap, window: tuple[float, float, float, float]
    ) -> None:
        self.window = window
        grid, (x0, y0, x1, y1) = navigation.grid, window
        s = grid.resolution
        width, height = round((x1 - x0) / s), round((y1 - y0) / s)
        c, r = round((x0 - grid.origin[0]) / s), round((y0 - grid.origin[1]) / s)
        colours = np.array([GREY, WALL, WALL], np.uint8)[grid.cells]
        colours[navigation.blocked & ~grid.blocked] = BODY
        part = colours[r : r + height, c : c + width][::-1]
        self.scale = SCALE / s
        self.image = Image.fromarray(part.repeat(SCALE, 0).repeat(SCALE, 1))
        self.draw = ImageDraw.Draw(self.image)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """The pixel of a point."""
        return (x - self.window[0]) * self.scale, (self.window[3] - y) * self.scale

    def line(self, points: np.ndarray, colour: tuple[int, int, int], width: int = 3) -> None:
        """A polyline."""
        self.draw.line([self.at(x, y) for x, y in points], fill=colour, width=width)

    def dot(self, x: float, y: float, colour: tuple[int, int, int], radius: float = 5) -> None:
        """A disc."""
        u, v = self.at(x, y)
        self.draw.ellipse([u - radius, v - radius, u + radius, v + radius], fill=colour)

    def agent(self, pose: np.ndarray, colour: tuple[int, int, int], size: float = 0.13) -> None:
        """A triangle that looks where the agent looks."""
        x, y, yaw = pose
        corners = [(yaw, 1.3), (yaw + 2.5, 1.0), (yaw - 2.5, 1.0)]
        self.draw.polygon(
            [self.at(x + size * k * math.cos(a), y + size * k * math.sin(a)) for a, k in corners],
            fill=colour,
        )

    def text(self, x: float, y: float, text: str, colour: tuple[int, int, int] = WALL) -> None:
        """A few words beside a point."""
        u, v = self.at(x, y)
        self.draw.text((u + 7, v - 9), text, fill=colour, font=ImageFont.load_default(17))


def to_world(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points of the agent's frame in the world."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def draw_one(plan: Plan, navigation: NavigationMap, episode, pose: np.ndarray) -> None:
    """One state with its label."""
    label = label_states(navigation, episode, pose[None])
    way = to_world(pose, label.waypoints[0].astype(float))
    plan.line(way, ORANGE, 2)
    for k, (x, y) in enumerate(way[: int(label.valid[0])]):
        plan.dot(x, y, ORANGE, 5)
        if k in (0, 4, 8, 12):
            plan.text(x - 0.1, y + 0.32, str(k), ORANGE)
    poses, _ = walk_actions(navigation, episode.agent, pose, label.actions6[0])
    for at in poses[1:]:
        plan.agent(at, BLUE, 0.06)
    plan.agent(pose, RED)
    names = " ".join(["STOP", "FWD", "LEFT", "RIGHT"][code] for code in label.actions6[0])
    x0, _, _, y1 = plan.window
    plan.text(x0 + 0.1, y1 - 0.16, names, BLUE)


def main() -> None:
    """Draw both halves and write the picture."""
    scene = build_example_scene()
    navigation = NavigationMap(scene.grid, 0.20)
    episodes = sample_goal_episodes(scene, navigation, 12, 0)
    episode = max(episodes, key=lambda e: navigation.geodesic(e.goal).distance_at(*e.start[:2]))
    bounds = scene.grid.bounds
    left, right = Plan(navigation, bounds), Plan(navigation, bounds)
    draw_one(left, navigation, episode, np.array([episode.start[0] + 0.6, episode.start[1], -0.55]))
    left.dot(*episode.goal, GREEN, 8)
    config = SensorConfig(active=frozenset({"goal_vector"}))
    simulator = Simulator(scene, navigation=navigation, sensors=config, max_steps=90)
    settings = DaggerSettings(policy="straight", beta=0.15, seed=3, halting="none", max_steps=90)
    rows = collect_visited(simulator, PolicyStraight(), episode, settings, EXACT)
    for t in range(0, len(rows), 7):
        way = to_world(rows.poses[t], rows.waypoints[t].astype(float))
        right.line(way, ORANGE, 2)
    right.line(rows.poses[:, :2], RED, 3)
    for t in range(0, len(rows), 7):
        right.agent(rows.poses[t], RED, 0.10)
    right.dot(*episode.goal, GREEN, 8)
    width, height = left.image.size
    whole = Image.new("RGB", (width, 2 * height + 12), "white")
    whole.paste(left.image, (0, 0))
    whole.paste(right.image, (0, height + 12))
    whole.quantize(48).save(OUT, optimize=True)


if __name__ == "__main__":
    main()
