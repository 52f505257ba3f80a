"""People who walk on the spot before cameras, a phase further each picture: to time renders on."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gn0.avatars.bank import digest_avatar
from gn0.avatars.detail import SHARES, choose_level
from gn0.avatars.identity import draw_people
from gn0.avatars.motion.gait import PHASES
from gn0.avatars.motion.library import look_class, speed_class
from gn0.avatars.person import build_person
from gn0.geometry import F32, F64
from gn0.people.cast import Actor, Cast
from gn0.people.shown import PoseShown, Shown
from gn0.render.cpu import RendererCpu
from gn0_figures.device_scenes import FigureScene
from gn0_figures.flat import flat_camera

LIGHT: F32 = np.array(
    [[0.8, 0.75, 0.7], [0.2, 0.2, 0.15], [0.1, 0.0, 0.0], [0.15, 0.2, 0.25]], np.float32
)
PIXELS = 224
QUARTER = SHARES.index(1 / 4)  # the level of detail of a quarter of all splats
_SIDES = (0.0, -0.6, 0.6, -1.2, 1.2, -0.3, 0.3, 0.9)  # where who stands, m to the left
_FURTHER = (0.0, 0.1, 0.2, 0.1, 0.4, 0.8, 0.9, 0.7)  # behind the first, m


@lru_cache(2)
def open_actors(count: int, tiny: bool) -> tuple[Actor, ...]:
    """People of the first bank, with their levels; sparse ones without, where tiny."""
    if not tiny:
        cast = Cast()
        return tuple(cast.find(f"drawn:3:{k}") for k in range(count))
    one = build_person(draw_people(3, 1)[0], name="sparse", density=0.03)
    return (Actor("sparse", digest_avatar(one), (one,) * len(SHARES)),) * count


@dataclass(frozen=True)
class Walkers:
    """People before each view.

    Attributes:
        actors: who; as many stand there.
        away: of the first from the eye [m].
        focal: of the camera [px].
        speed: of their walk [m/s].
    """

    actors: tuple[Actor, ...]
    away: float
    focal: float
    speed: float = 1.0

    def wanted(self, turn: int) -> list[tuple[Hashable, PoseShown]]:
        """Keys of a bank, and what poses them, of picture `turn`."""
        found: list[tuple[Hashable, PoseShown]] = []
        for k, actor in enumerate(self.actors):
            shown = Shown(
                *("walk", (turn + 8 * k) % PHASES, "", 0, 4),
                *(speed_class(self.speed), look_class(0.0)),
                seat=0.45,
            )
            level = choose_level(self.away + _FURTHER[k], self.focal)
            found.append(((actor.digest, shown, level), PoseShown(actor, shown, level)))
        return found

    def poses(self, view: F64) -> F64:
        """Where they stand before a view, on the floor, part-to-world [K, 4, 4]."""
        back = np.linalg.inv(view)
        poses = np.tile(np.eye(4), (len(self.actors), 1, 1))
        for k, pose in enumerate(poses):
            pose[:2, 3] = (back @ (-_SIDES[k], 0.0, self.away + _FURTHER[k], 1.0))[:2]
            c, s = np.cos(2.0 * k), np.sin(2.0 * k)
            pose[:2, :2] = (c, -s), (s, c)
        return poses


def find_views(scene: FigureScene, count: int, clear: float, tiny: bool) -> F64:
    """Views of a scene that see so far ahead [m]; any where tiny."""
    if tiny:
        return scene.views(count, 3)
    camera, found = flat_camera(32, 32), []
    cpu = RendererCpu(scene.cloud)
    for stream in range(3, 40):
        views = scene.views(64, stream)
        depth = cpu.render(camera, views, outputs=("depth",)).depth
        assert depth is not None
        ahead = np.median(depth[:, 12:20, 12:20], axis=(1, 2))
        found += [view for view, far in zip(views, ahead, strict=True) if far > clear]
        if len(found) >= count:
            return np.stack(found[:count])
    raise RuntimeError(f"the flat has no {count} views that see {clear} m ahead")
