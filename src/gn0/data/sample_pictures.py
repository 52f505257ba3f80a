"""The pictures of a sample, drawn from a pose: the same ones that the simulator shows.

A step has one new rendering, the view. The history mosaic is made of earlier views, the BEV is
rendered once a scene and light, and the occupancy picture is the map with two dots.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gn0.data.sample_table import DEPTH, PICTURES
from gn0.data.settings import PictureSettings
from gn0.data.step_people import StepPeople
from gn0.geometry import F32, F64, U8, Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.people.person import EpisodePerson
from gn0.render.encoding import Dots, Encode, MapPicture
from gn0.render.light import LightCondition
from gn0.render.open import visible_backend
from gn0.render.renderer import DrawnScene, Encoder
from gn0.scenes.scene import Scene
from gn0.sim.history import (
    COLUMNS,
    LENGTH,
    History,
    build_mosaic,
)
from gn0.sim.look_plan import plan_look
from gn0.sim.motion import Moment
from gn0.sim.open import open_simulator
from gn0.sim.presets import CameraPreset
from gn0.sim.sensors import SensorSuite
from gn0.sim.simulator import goal_record, goal_view
from gn0.storage import content_hash

if TYPE_CHECKING:
    from gn0.people.sight import Sight
    from gn0.sim.people_eyes import PeopleEyes, Wanted

U16 = NDArray[np.uint16]
BATCH = 32  # views a call of the renderer
CLOUDS_AT_ONCE = 96  # posed people of a call, of its several views; all of them fit in a PosedBank
FAR = 2**24  # px: dots are kept that near, which is outside of any map that is sent
SENSORS = frozenset({"rgb", "depth", "history", "bev", "occupancy"})


def build_eyes(
    scene: Scene,
    navigation: NavigationMap,
    preset: CameraPreset,
    agent: AgentSpec,
    light: LightCondition | None = None,
    *,
    visible_sets: bool = False,
    backend: str = "cpu",
    renderer: DrawnScene | None = None,
) -> SensorSuite:
    """The sensors of an agent in a scene, under a light that the views and the BEV share.

    Args:
        scene: where.
        navigation: its map, inflated for the agent.
        preset: the cameras.
        agent: the body.
        light: None as the scene was made.
        visible_sets: draw views from the splats that show near each place, see
            `gn0.render.visible`.
        backend: name of the renderer.
        renderer: draws instead; it must hold this scene in this light.
    """
    return open_simulator(
        scene,
        preset,
        visible_backend(backend) if visible_sets else backend,
        SENSORS,
        agent,
        navigation=navigation,
        light=light,
        renderer=renderer,
    ).suite


@dataclass(frozen=True, eq=False)
class StepPictures:
    """What the agent sees at a step.

    Attributes:
        rgb: uint8 [H, W, 3], the view; None where its file and its digest are made already.
        bev: uint8 [Hb, Wb, 3], the scene from above.
        lay, paint: make `history` and `occupancy`, where somebody looks at them.
        files: encoded pictures by name, where they are made already.
        depth: uint16 [Hd, Wd] mm, see `gn0.render.depth`; None where it is not stored.
        digests: digests of raw pixels by name, where they are made already.
        people: float32 [P, 6] how much is seen of each person; None where nobody asks.
    """

    rgb: U8 | None
    bev: U8
    lay: Callable[[], U8]
    paint: Callable[[], U8]
    files: Mapping[str, bytes] = field(default_factory=dict)
    depth: U16 | None = None
    digests: Mapping[str, str] = field(default_factory=dict)
    people: F32 | None = None

    @cached_property
    def history(self) -> U8:
        """The mosaic of earlier views uint8 [4 h, 4 w, 3]."""
        return self.lay()

    @cached_property
    def occupancy(self) -> U8:
        """The map with start and agent uint8 [Hb, Wb, 3]."""
        return self.paint()

    def hashes(self, known: Mapping[str, str] | None = None) -> dict[str, str]:
        """Digest of each picture's raw pixels; `known` spares those that are known already."""
        known = {**self.digests, **(known or {})}
        names = PICTURES if self.depth is None else (*PICTURES, DEPTH)
        return {
            name: known.get(name) or content_hash(np.asarray(getattr(self, name))) for name in names
        }


@dataclass(frozen=True, eq=False)
class Seen:
    """A view, and what another process made of it.

    Attributes:
        pose: where the agent stands.
        rgb: uint8 [H, W, 3]; None where its file and its digest are made already.
        tile: the view as it is in later mosaics uint8 [h, w, 3]; None where it is to be made.
        files: encoded pictures by name, the bytes that `encode_picture` gives.
        depth: uint16 [Hd, Wd] mm; None where it is not stored.
        digests: digests of raw pixels by name, those that `content_hash` gives.
        people: float32 [P, 6] how much is seen of each person; None where nobody asks.
    """

    pose: Pose2D
    rgb: U8 | None
    tile: U8 | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    depth: U16 | None = None
    digests: Mapping[str, str] = field(default_factory=dict)
    people: F32 | None = None


@dataclass(frozen=True, eq=False)
class StepCrowd:
    """The people of an episode's steps, for whoever draws them.

    Attributes:
        eyes: show them in the scene.
        people: who they are.
        steps: what they do.
        focal: of the picture [px].
        sight: what is seen in it; see `PeopleEyes.want`.
    """

    eyes: PeopleEyes
    people: tuple[EpisodePerson, ...]
    steps: StepPeople
    focal: float
    sight: Sight | None = None

    def want(self, poses: Sequence[Pose2D], begin: int) -> list[Wanted]:
        """What is to be seen of them from the poses of the steps from `begin` on."""
        return [
            self.eyes.want(self.steps.at(begin + k, self.people), pose, self.focal, self.sight)
            for k, pose in enumerate(poses)
        ]

    def tell_who(self, suite: SensorSuite, step: int, pose: Pose2D) -> F32:
        """How much is seen of each of them at a step: share, pixels, box [P, 6].

        `suite` is the one whose renderer `eyes` tell; its backend must be the CPU's.
        """
        from gn0.sim.people_eyes import read_who  # bodies are needed only for pictures

        (view,) = self.want([pose], step)
        (parts,) = self.eyes.show_many([view])
        table = read_who(suite, pose, parts, view.numbers)[1]
        return table[[person.number - 1 for person in self.people]]

    def show(self, wanted: Sequence[Wanted]) -> list[Moment]:
        """They as parts of pictures that are drawn in one call."""
        shown = self.eyes.show_many(wanted)
        return [Moment(0.0, p, w.key) for p, w in zip(shown, wanted, strict=True)]


def draw_episode(
    eyes: SensorSuite,
    episode: Episode,
    poses: F64,
    views: Iterator[Seen] | None = None,
    *,
    crowd: StepCrowd | None = None,
    black: bool = False,
) -> Iterator[StepPictures]:
    """The pictures at each of the poses [T, 3] of an episode, from its first step on.

    `views` are its views where they are drawn already, else `crowd` are the people in them. With
    `black` the history is black, as TRACKING samples have it.
    """
    tile = eyes.config.preset.history_tile
    history = History(size=tile)
    start = Pose2D(*episode.start)
    bev = map_picture(eyes)
    for seen in draw_views(eyes, poses, crowd=crowd) if views is None else views:
        lay = partial(build_mosaic, () if black else history.tiles, tile)
        paint = partial(eyes.occupancy_picture, start, seen.pose)
        yield StepPictures(
            seen.rgb, bev, lay, paint, seen.files, seen.depth, seen.digests, seen.people
        )
        if seen.tile is not None:
            history.add_tile(seen.tile)
        else:
            assert seen.rgb is not None
            history.add(seen.rgb)


def draw_views(
    eyes: SensorSuite,
    poses: F64,
    *,
    depth: bool = False,
    moments: Sequence[Moment] = (),
    crowd: StepCrowd | None = None,
) -> Iterator[Seen]:
    """The view at each of some poses [T, 3], with its depth; one rendering for equal neighbours.

    `moments` are those of the poses, where something moves; or `crowd` are the people of the steps.
    """
    outputs = frozenset({"rgb", "depth"} if depth else {"rgb"})
    for _, batch, distinct, numbers, now in _find_batches(poses, crowd, moments):
        seen = eyes.look_many(distinct, outputs, now, True)
        rgb, far = seen["rgb"], seen.get("depth")
        for pose, number in zip(batch, numbers, strict=True):
            yield Seen(pose, rgb[number], depth=None if far is None else far[number])


def _find_batches(
    poses: F64, crowd: StepCrowd | None, moments: Sequence[Moment] = ()
) -> Iterator[tuple[int, list[Pose2D], list[Pose2D], list[int], list[Moment]]]:
    """Steps whose pictures are drawn in one call, each different picture once.

    Yields:
        The first step, the poses of all, the poses of the different pictures, the number of each
        step's picture, and what moves in the different ones (empty where nothing does).
    """
    begin = 0
    while begin < len(poses):
        batch = [Pose2D(*map(float, row)) for row in poses[begin : begin + BATCH]]
        wanted = [] if crowd is None else _fitting(crowd.want(batch, begin))
        batch = batch[: len(wanted) or None]
        then = wanted or moments[begin : begin + BATCH]
        keys = [(pose, then[k].key if then else b"") for k, pose in enumerate(batch)]
        places = {key: index for index, key in enumerate(dict.fromkeys(keys))}
        first = [keys.index(key) for key in places]
        numbers = [places[key] for key in keys]
        if crowd is not None:
            now = crowd.show([wanted[k] for k in first])
        else:
            now = [moments[begin + k] for k in first] if moments else []
        yield begin, batch, [batch[k] for k in first], numbers, now
        begin += len(batch)


def _fitting(wanted: list[Wanted]) -> list[Wanted]:
    """As many of the first pictures as one call can have; at least one."""
    clouds: set[Hashable] = set()
    for count, view in enumerate(wanted):
        clouds |= {key for key, _ in view.clouds}
        if count and len(clouds) > CLOUDS_AT_ONCE:
            return wanted[:count]
    return wanted


@dataclass(frozen=True, eq=False)
class Painting:
    """Occupancy pictures that the drawing process is to paint.

    Attributes:
        bare: the map before dots are drawn.
        start: start of the walk.
        encode: whether files are wanted, too; else digests alone.
    """

    bare: MapPicture
    start: Pose2D
    encode: bool

    def place(self, eyes: SensorSuite, poses: Sequence[Pose2D]) -> tuple[Dots, list[int]]:
        """The pictures of some steps, equal ones once, and the number of each step's."""
        frame, start = eyes.map_frame, self.start
        first = frame.pixel_of(start.x, start.y)
        rows = [(*first, *frame.pixel_of(pose.x, pose.y)) for pose in poses]
        distinct = {row: number for number, row in enumerate(dict.fromkeys(rows))}
        places = np.clip(np.array(list(distinct)), -FAR, FAR).astype(np.int32)
        dots = Dots(places.tobytes(), eyes.config.disc_radius, self.encode)
        return dots, [distinct[row] for row in rows]


def draw_files(
    eyes: SensorSuite,
    poses: F64,
    quality: int,
    *,
    depth: bool = False,
    painting: Painting | None = None,
    crowd: StepCrowd | None = None,
    black: bool = False,
) -> Iterator[Seen]:
    """As `draw_views`, but jpg files and digests that the drawing process makes, not pixels.

    The poses are those of one walk, from its first step on. What that process has not made is left
    to who needs it. `painting`: let it make the occupancy pictures, too. `black`: leave the history
    out, see `draw_episode`.
    """
    encoder, preset = _encoder_of(eyes), eyes.config.preset
    assert encoder is not None
    plan = plan_look(preset, frozenset({"rgb", "depth"} if depth else {"rgb"}), True)
    first, both = plan.shots[0], "depth" in plan.shots[0].outputs
    width, height = preset.history_tile
    pixels = preset.rgb.width * preset.rgb.height + width * height * LENGTH
    for begin, batch, distinct, numbers, moments in _find_batches(poses, crowd):
        parts = [moment.parts for moment in moments] if any(m.parts for m in moments) else []
        dots, shown, spots = None, None, [0] * len(batch)
        room = len(batch) * pixels * 3 // 2
        if painting is not None:
            shown = painting.bare
            dots, spots = painting.place(eyes, batch)
            room += dots.count * len(shown.grey) * 3 // 2 if dots.encode else 0
        wish = Encode(
            quality=quality,
            room=room,
            tile=(width, height),
            cells=LENGTH,
            columns=COLUMNS,
            steps=np.array(numbers, np.int32).tobytes(),
            begin=begin == 0,
            dots=dots,
            pixels=False,
        )
        found = encoder.render_files(
            first.camera, eyes.views_of(distinct), wish, plan.background, first.outputs, shown,
            parts,
        )  # fmt: skip
        far = found.pictures.get("depth")
        if depth and far is None:
            far = eyes.look_many(distinct, frozenset({"depth"}), moments, True)["depth"]
        rgb, made = found.pictures.get("rgb"), bool(found.mosaics)
        assert made or rgb is not None
        hashes = found.hashes
        for step, (pose, number) in enumerate(zip(batch, numbers, strict=True)):
            files, digests = {}, {}
            if made:
                files = {"rgb": found.files[number], "history": found.mosaics[step]}
                digests = {"rgb": hashes["rgb"][number], "history": hashes["mosaics"][step]}
                if black:
                    del files["history"], digests["history"]
                if both and hashes["depth"]:
                    digests[DEPTH] = hashes["depth"][number]
                if found.maps:
                    files["occupancy"] = found.maps[spots[step]]
                if hashes["maps"]:
                    digests["occupancy"] = hashes["maps"][spots[step]]
            tile = found.pictures["tiles"][number] if made else None
            deep = None if far is None else far[number]
            yield Seen(pose, None if rgb is None else rgb[number], tile, files, deep, digests)


def files_wanted(eyes: SensorSuite, settings: PictureSettings) -> bool:
    """Whether the drawing process should make the jpg files, too: it must know their pixels."""
    preset = eyes.config.preset
    width, height = preset.history_tile
    return (
        _encoder_of(eyes) is not None
        and (settings.layout, settings.format) == ("webdataset", "jpg")
        and preset.picture_size == (preset.rgb.width, preset.rgb.height)
        and preset.rgb.width % width == 0
        and preset.rgb.height % height == 0
    )


def _encoder_of(eyes: SensorSuite) -> Encoder | None:
    return None if eyes.renderer is None else eyes.renderer.encoder


def goal_picture(eyes: SensorSuite, episode: Episode) -> U8:
    """What an episode's goal looks like [H, W, 3]: the simulator's sensor of that name."""
    return eyes.look_at_goal(goal_record(episode), goal_view(episode))


def map_picture(eyes: SensorSuite) -> U8:
    """The BEV picture [H, W, 3] of a scene and light."""
    return eyes.bev_picture
