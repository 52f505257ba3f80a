"""Draw the pictures of people in the docs anew: pictures/people.jpg, _moving.jpg and _lit.jpg.

python docs/draw_people.py [people] [moving] [lit]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from gn0.avatars import Avatar, build_person, draw_people
from gn0.avatars.light import find_probes
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.motion.library import ClipLibrary
from gn0.avatars.motion.play import play_motion
from gn0.avatars.posed_bank import NEARER
from gn0.avatars.poses import standing_pose
from gn0.geometry import F64, U8, view_from_pose
from gn0.render import Camera, Instance, RendererCpu
from gn0.scenes.procedural.generate import GenerateSettings, build_generated
from gn0.viewer.avatar_film import film_motion
from gn0.viewer.avatar_sheet import draw_avatars

PICTURES = Path(__file__).resolve().parent / "pictures"
SEED, COUNT = 5, 24
MOVES = (  # person, clip, speed [m/s], seconds, from where it is seen [rad]
    (0, "walk", 1.3, 0.0, 1.57),
    (2, "walk", 1.0, 0.0, 1.57),
    (1, "walk", 0.6, 0.0, 1.57),
    (20, "run", 1.0, 0.0, 1.57),
    (5, "sit_down", 1.0, 0.0, 1.57),
    (18, "wave", 1.0, 1.5, 0.0),
)
TILE = (150, 230)  # px of a picture of a movement
VIEW = Camera.from_vfov(960, 720, 70.0)
PI = np.pi


def build(numbers: set[int]) -> dict[int, Avatar]:
    """Some of the people."""
    drawn = draw_people(SEED, COUNT)
    return {k: build_person(drawn[k], name=f"p{k:04d}") for k in sorted(numbers)}


def draw_page(people: dict[int, Avatar]) -> Image.Image:
    """All of them, front and back."""
    sheet = draw_avatars([people[k] for k in range(COUNT)])
    return sheet.resize((sheet.width * 4 // 5, sheet.height * 4 // 5), Image.Resampling.LANCZOS)


def draw_moves(people: dict[int, Avatar]) -> Image.Image:
    """Eight pictures of each movement, side by side."""
    page = Image.new("RGB", (8 * TILE[0], len(MOVES) * TILE[1]))
    for row, (number, clip, speed, seconds, turn) in enumerate(MOVES):
        avatar = people[number]
        measured = measure_build(avatar.joints, avatar.points, avatar.weights)
        motion = play_motion(ClipLibrary(measured, 0, 0.45).motion(clip, speed), 30, seconds)
        frames = np.linspace(0, len(motion) - 1, 8).round().astype(int).tolist()
        for column, picture in enumerate(film_motion(avatar, motion, frames, turn=turn)):
            tile = (
                Image.fromarray(picture)
                .crop((43, 0, 277, 360))
                .resize(TILE, Image.Resampling.LANCZOS)
            )
            page.paste(tile, (column * TILE[0], row * TILE[1]))
    return page


def draw_lit(people: dict[int, Avatar]) -> Image.Image:
    """People in three views: a living room, a hallway, a school's corridor."""
    strides = standing_pose()
    strides[1, 0], strides[2, 0], strides[4, 0], strides[5, 0] = -0.35, 0.28, 0.12, 0.35
    strides[16, 1] += 0.3
    strides[17, 1] += 0.3
    still = standing_pose()
    flat = GenerateSettings(kind="apartment", seed=3, size="small")
    school = GenerateSettings(kind="corridor", seed=2, size="small")
    home, halls = (Lit(settings, people) for settings in (flat, school))
    views = [
        home.draw(
            (9.3, 0.9, 1.3), 0.75,
            [(0, 11.6, 2.2, PI + 0.6, strides), (10, 11.0, 3.6, -PI / 2 - 0.4, still),
             (13, 12.4, 3.4, PI, still)],
        ),
        home.draw(
            (0.8, 0.8, 1.3), 0.0,
            [(15, 3.0, 0.7, PI, strides), (20, 4.6, 1.2, PI + 0.4, still),
             (17, 6.2, 0.8, 0.0, strides)],
        ),
        halls.draw(
            (7.3, 1.0, 1.3), PI / 2,
            [(1, 7.0, 3.2, -PI / 2, strides), (2, 7.9, 4.6, -PI / 2 + 0.5, still),
             (13, 7.2, 8.5, PI / 2, strides)],
        ),
    ]  # fmt: skip
    page = Image.fromarray(np.concatenate(views, axis=1))
    return page.resize((1440, 360), Image.Resampling.LANCZOS)


class Lit:
    """A generated scene, and people in its light."""

    def __init__(self, settings: GenerateSettings, people: dict[int, Avatar]) -> None:
        scene = build_generated(settings, settings.kind)
        self.people = people
        self.probes = find_probes(scene.gaussians, scene.grid)
        self.renderer = RendererCpu(scene.gaussians)

    def draw(
        self,
        eye: tuple[float, float, float],
        yaw: float,
        placed: list[tuple[int, float, float, float, F64]],
    ) -> U8:
        """A view from `eye` [m] along `yaw` [rad] with people at x, y [m], yaw, in poses."""
        parts = []
        for k, (number, x, y, turn, pose) in enumerate(placed):
            self.renderer.name_cloud(f"p{k}", self.people[number].pose(pose))
            at = np.eye(4)
            at[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
            at[:2, 3] = x, y
            parts.append(Instance(f"p{k}", at, self.probes.gain_at(x, y), NEARER))
        views = view_from_pose(*eye, yaw)[None]
        drawn = self.renderer.render(VIEW, views, parts=parts, outputs=("rgb",)).rgb
        assert drawn is not None
        return np.asarray(drawn[0], np.uint8)


def main(wanted: list[str]) -> None:
    """Draw what is wanted; everything without a word."""
    pages = {
        "people": ("people", set(range(COUNT)), draw_page),
        "moving": ("people_moving", {move[0] for move in MOVES}, draw_moves),
        "lit": ("people_lit", {0, 1, 2, 10, 13, 15, 17, 20}, draw_lit),
    }
    chosen = wanted or list(pages)
    people = build(set().union(*(pages[word][1] for word in chosen)))
    for word in chosen:
        name, _, draw = pages[word]
        draw(people).save(PICTURES / f"{name}.jpg", quality=84, optimize=True)


if __name__ == "__main__":
    main(sys.argv[1:])
