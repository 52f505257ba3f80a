"""The people around an agent as instances for its renderer, in the light of their places."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from gn0.avatars.bank import AvatarBank
from gn0.avatars.detail import choose_level
from gn0.avatars.light import LightProbes, find_probes
from gn0.avatars.posed_bank import BUDGET, PosedBank
from gn0.geometry import Pose2D
from gn0.people.cast import Cast
from gn0.people.shown import pose_shown, show_person
from gn0.render.instance import Instance
from gn0.render.light import LightCondition
from gn0.storage import content_hash

if TYPE_CHECKING:
    from gn0.render.renderer import DrawnScene
    from gn0.scenes.scene import Scene
    from gn0.sim.people import Company

BEHIND = 1.0  # m behind an eye from where nobody is drawn: an arm's length and more


class PeopleEyes:
    """Shows people in a scene.

    Args:
        scene: where.
        renderer: draws.
        bank: of named people, its folder or itself.
        light: how the scene is lit; as it was made when None.
        budget: bytes of posed clouds.
    """

    def __init__(
        self,
        scene: Scene,
        renderer: DrawnScene,
        bank: AvatarBank | Path | str | None = None,
        light: LightCondition | None = None,
        budget: int = BUDGET,
    ) -> None:
        self.scene, self.renderer = scene, renderer
        self.cast = Cast(bank)
        self.posed = PosedBank(budget)
        self._light = light
        self._probes: LightProbes | None = None

    @property
    def probes(self) -> LightProbes:
        """The scene's light, found the first time that it is asked for."""
        if self._probes is None:
            self._probes = find_probes(self.scene.gaussians, self.scene.grid)
        return self._probes

    def show(
        self, company: Company, eye: Pose2D, focal: float
    ) -> tuple[tuple[Instance, ...], tuple[int, ...], bytes]:
        """People as an eye sees them.

        Args:
            company: the people, and what they do.
            eye: where it is, and where it looks.
            focal: of its picture [px], which decides levels of detail.

        Returns:
            Instances whose clouds the renderer knows, the person number of each, and a key that
            differs where their pictures may.

        Raises:
            EpisodeError: nobody plays one of them.
        """
        ahead = np.array([np.cos(eye.yaw), np.sin(eye.yaw)])
        state = company.state
        wanted, poses, numbers, places = [], [], [], []
        for row, person in enumerate(company.people):
            x, y = company.places[row].tolist()
            if (x - eye.x) * ahead[0] + (y - eye.y) * ahead[1] < -BEHIND:
                continue
            actor = self.cast.find(person.identity)
            shown, pose = show_person(
                person, actor, state.real[0, row], state.whole[0, row], (eye.x, eye.y)
            )
            away = float(np.hypot(x - eye.x, y - eye.y))
            level = choose_level(away, focal)
            key = (actor.digest, shown, level)
            wanted.append((key, partial(pose_shown, actor, shown, level)))
            poses.append(pose)
            places.append((x, y))
            numbers.append(person.number)
        posed = self.posed.fetch(wanted)
        self.posed.tell(self.renderer, posed)
        condition = self._light
        parts = []
        for each, pose, (x, y) in zip(posed, poses, places, strict=True):
            change = () if condition is None else (condition,)
            gain = self.probes.gain_at(x, y, *change)
            parts.append(Instance(each.name, pose, gain=gain))
        about = content_hash(
            msgspec.json.encode([each for each, _ in wanted]),
            *(part.pose.tobytes() for part in parts),
        )
        return tuple(parts), tuple(numbers), bytes.fromhex(about)
