"""The people around an agent as instances for its renderer, in the light of their places."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec
import numpy as np

from gn0.avatars.bank import AvatarBank
from gn0.avatars.detail import choose_level
from gn0.avatars.light import LightProbes, find_probes
from gn0.avatars.posed_bank import BUDGET, NEARER
from gn0.geometry import F32, F64, U8, Pose2D
from gn0.people.cast import Cast
from gn0.people.crowd import CrowdState
from gn0.people.person import PEOPLE_MOST, EpisodePerson
from gn0.people.poser import name_posed, open_posed
from gn0.people.shown import PoseShown, show_person
from gn0.people.sight import Sight
from gn0.render.instance import Instance
from gn0.render.light import LightCondition
from gn0.storage import content_hash

if TYPE_CHECKING:
    from gn0.render.renderer import DrawnScene
    from gn0.scenes.scene import Scene
    from gn0.sim.motion import Moment
    from gn0.sim.people import Company
    from gn0.sim.sensors import SensorSuite

BEHIND = 1.0  # m behind an eye from where nobody is drawn: an arm's length and more


class PeopleAround(Protocol):
    """People, and what they do: a `Company`, say."""

    @property
    def people(self) -> tuple[EpisodePerson, ...]:
        """Who they are."""
        ...

    @property
    def state(self) -> CrowdState:
        """What they do now."""
        ...

    @property
    def places(self) -> F64:
        """Where they are [P, 2] m."""
        ...


@dataclass(frozen=True, eq=False)
class Wanted:
    """People in one picture, before their clouds are there.

    Attributes:
        clouds: [K] a key of `PosedBank` and what poses it.
        poses: [K] of them in the scene, [4, 4] m.
        places: [K] where they stand (x, y) [m].
        numbers: [K] of the people.
        key: equal where pictures from the same place in the same scene are.
    """

    clouds: tuple[tuple[Hashable, PoseShown], ...]
    poses: tuple[F64, ...]
    places: tuple[tuple[float, float], ...]
    numbers: tuple[int, ...]
    key: bytes


class PeopleEyes:
    """Shows people in a scene; they are posed where they are drawn.

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
        self.posed = open_posed(renderer.renderer, self.cast.bank, budget)
        self._light = light
        self._probes: LightProbes | None = None

    @property
    def probes(self) -> LightProbes:
        """The scene's light, found the first time that it is asked for."""
        if self._probes is None:
            self._probes = find_probes(self.scene.gaussians, self.scene.grid)
        return self._probes

    def want(
        self, company: PeopleAround, eye: Pose2D, focal: float, sight: Sight | None = None
    ) -> Wanted:
        """What an eye is to see of people, nothing of which is made yet.

        Args:
            company: the people, and what they do.
            eye: where it is, and where it looks.
            focal: of its picture [px], which decides levels of detail.
            sight: what it sees; whoever is beside is left out, and not built where he need not be.
                All who are not behind it when None.

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
            if sight is not None and not sight.may_show(eye, x, y):
                continue
            actor = self.cast.find(person.identity)
            shown, pose = show_person(
                person, actor, state.real[0, row], state.whole[0, row], (eye.x, eye.y)
            )
            away = float(np.hypot(x - eye.x, y - eye.y))
            level = choose_level(away, focal)
            if sight is not None and not sight.shows(
                *(eye, pose, actor.reach_of(person), shown, level),
                on_script=person.behaviour == "script",
            ):
                continue
            key = (actor.digest, shown, level)
            wanted.append((key, PoseShown(actor, shown, level)))
            poses.append(pose)
            places.append((x, y))
            numbers.append(person.number)
        about = content_hash(
            msgspec.json.encode([each for each, _ in wanted]), *(pose.tobytes() for pose in poses)
        )
        return Wanted(
            tuple(wanted), tuple(poses), tuple(places), tuple(numbers), bytes.fromhex(about)
        )

    def show_many(self, views: Sequence[Wanted]) -> list[tuple[Instance, ...]]:
        """The people of pictures that are drawn in one call, one tuple each.

        The renderer knows their clouds until the next call.

        Raises:
            ConfigError: together they are larger than the budget.
        """
        wanted = [each for view in views for each in view.clouds]
        names = iter(name_posed(self.posed, self.renderer, wanted))
        condition = self._light
        change = () if condition is None else (condition,)
        return [
            tuple(
                Instance(next(names), pose, self.probes.gain_at(x, y, *change), NEARER)
                for pose, (x, y) in zip(view.poses, view.places, strict=True)
            )
            for view in views
        ]

    def show(
        self, company: PeopleAround, eye: Pose2D, focal: float, sight: Sight | None = None
    ) -> tuple[tuple[Instance, ...], tuple[int, ...], bytes]:
        """People as an eye sees them; see `want` for the arguments.

        Returns:
            Instances whose clouds the renderer knows, the person number of each, and a key that
            differs where their pictures may.

        Raises:
            EpisodeError: nobody plays one of them.
        """
        view = self.want(company, eye, focal, sight)
        (parts,) = self.show_many([view])
        return parts, view.numbers, view.key

    def tell_who(
        self, suite: SensorSuite, company: Company, pose: Pose2D, moment: Moment
    ) -> tuple[U8, F32]:
        """Which person each pixel shows, and how much is seen of each; see `gn0.sim.sensor.who`.

        Args:
            suite: whose colour camera looks.
            company: the people, and what they do.
            pose: of the eye.
            moment: what else moves, then.
        """
        parts, numbers, _ = self.show(company, pose, suite.config.preset.rgb.fx, suite.sight)
        return read_who(suite, pose, (*moment.parts, *parts), numbers)


def read_who(
    suite: SensorSuite, pose: Pose2D, parts: tuple[Instance, ...], numbers: tuple[int, ...]
) -> tuple[U8, F32]:
    """Person numbers [H, W], and what is seen of each [16, 6], where the last parts are people."""
    camera, renderer = suite.config.preset.rgb, suite.renderer
    picture = np.zeros((camera.height, camera.width), np.uint8)
    table = np.zeros((PEOPLE_MOST, 6), np.float32)
    if renderer is None or not parts:
        return picture, table
    numbers = (*(0 for _ in parts[len(numbers) :]), *numbers)
    found = renderer.render_who(camera, suite.views_of([pose]), [parts])
    picture[:] = np.array((0, *numbers), np.uint8)[found.numbers[0]]
    for number, seen in zip(numbers, found.seen[0], strict=True):
        if number:
            table[number - 1] = seen.share, seen.pixels, *(seen.box or (0, 0, 0, 0))
    return picture, table
