"""The pictures of a part: drawn from its rows, hashed, checked, and put into a cache."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from gn0.data.dataset import Dataset, FileRecord
from gn0.data.drawing_process import check_drawn_here
from gn0.data.picture_cache import DrawnStep
from gn0.data.sample_pictures import (
    Painting,
    Seen,
    StepCrowd,
    build_eyes,
    draw_episode,
    draw_files,
    draw_views,
    files_wanted,
    goal_picture,
    map_picture,
)
from gn0.data.sample_table import DEPTH, PICTURES, EpisodeRows
from gn0.data.settings import PictureSettings
from gn0.errors import DataError
from gn0.geometry import F32, U8, Pose2D
from gn0.missions.episode import Episode, MissionGoal
from gn0.render.encoding import MapPicture
from gn0.render.light import LightCondition
from gn0.render.renderer import DrawnScene
from gn0.render.share.client import RendererShared
from gn0.render.share.connection import DrawConnection
from gn0.sim.open import open_simulator
from gn0.sim.presets import find_preset
from gn0.sim.sensors import SensorSuite, paint_grid
from gn0.storage import RowDigest, content_hash, safe_join
from gn0.suites.scene_drawing import Look

if TYPE_CHECKING:
    from gn0.sim.people_eyes import PeopleEyes

PAINTED = 2**22  # pixels of a map at most that the drawing process paints dots on
AHEAD = 64  # views drawn before they are wanted, where another process draws them
T = TypeVar("T")
KEPT_STEPS = 256  # longer walks are drawn again for each mission of their path


@dataclass(eq=False)
class Eyes:
    """The eyes of a dataset's agent: of the scene and light that were asked for last.

    Args:
        dataset: whose agent, camera and scenes.
        settings: how pictures are drawn.
        drawing: address of the drawing process; "" draws here.

    Raises:
        DataError: it is to be drawn here, by a backend that is not.
    """

    dataset: Dataset
    settings: PictureSettings = PictureSettings()  # noqa: RUF009 (frozen)
    drawing: str = ""
    _key: tuple[str, LightCondition | None] | None = None
    _suite: SensorSuite | None = field(default=None, repr=False)
    _connection: DrawConnection | None = field(default=None, repr=False)
    _bare: MapPicture | None = field(default=None, repr=False)
    _people: PeopleEyes | None = field(default=None, repr=False)
    _witness: tuple[SensorSuite, PeopleEyes] | None = field(default=None, repr=False)
    bev_hash: str = ""

    def __post_init__(self) -> None:
        if self.drawing:
            self._connection = DrawConnection(self.drawing)
        else:
            check_drawn_here(self.settings)

    def of(self, episode: Episode) -> SensorSuite:
        """The sensors in an episode's scene, under its light."""
        light = episode.light
        key = (episode.scene_id, None if light is None or light.is_neutral else light)
        if self._suite is None or self._key != key:
            # let go of the old splats first
            self._suite = self._bare = self._people = self._witness = None
            about = self.dataset.about
            self._suite = build_eyes(
                self.dataset.scene(episode.scene_id),
                self.dataset.navigation(episode.scene_id),
                find_preset(about.camera),
                about.agent,
                key[1],
                visible_sets=self.settings.visible_sets,
                backend=self.settings.drawn_by,
                renderer=self.ask_for(*key),
            )
            self._key = key
            self.bev_hash = content_hash(map_picture(self._suite))
        return self._suite

    def crowd(self, episode: Episode, rows: EpisodeRows) -> StepCrowd | None:
        """The people of an episode, who are drawn with it; None of nobody.

        Raises:
            EpisodeError: the dataset's bank is another than an episode says.
        """
        suite = self.of(episode)
        if rows.people is None:
            return None
        if self._people is None:
            self._people = self._open_people(episode, suite)
        self._people.cast.check(episode.people, f"episode {episode.id!r}")
        focal = suite.config.preset.rgb.fx
        return StepCrowd(self._people, episode.people, rows.people, focal, suite.sight)

    def witness(self, episode: Episode, rows: EpisodeRows) -> Callable[[int, Pose2D], F32]:
        """What tells how much is seen of each person at a step [P, 6]; see `StepCrowd.tell_who`.

        It is drawn by the CPU, whatever draws the pictures: boxes are the same everywhere.
        """
        crowd = self.crowd(episode, rows)
        assert crowd is not None and self._suite is not None and self._people is not None
        if self._witness is None:
            suite, people = self._suite, self._people
            if self.settings.drawn_by != "cpu":  # the drawing process tells what this one would
                about, scene_id = self.dataset.about, episode.scene_id
                suite = open_simulator(
                    self.dataset.scene(scene_id), about.camera, "cpu", {"rgb"}, about.agent,
                    navigation=self.dataset.navigation(scene_id),
                ).suite  # fmt: skip
                people = self._open_people(episode, suite)
            self._witness = suite, people
        own, eyes = self._witness
        return partial(replace(crowd, eyes=eyes).tell_who, own)

    def _open_people(self, episode: Episode, suite: SensorSuite) -> PeopleEyes:
        from gn0.sim.people_eyes import PeopleEyes  # bodies are needed only where there are people

        assert suite.renderer is not None
        scene = self.dataset.scene(episode.scene_id)
        assert self._key is not None
        return PeopleEyes(scene, suite.renderer, self.dataset.bank, self._key[1])

    def painting(self, episode: Episode, *, encode: bool) -> Painting | None:
        """What the drawing process needs for the occupancy pictures of an episode.

        None where the map is too large for it. `encode`: let it make files, too.
        """
        eyes = self.of(episode)
        if eyes.map_frame.width * eyes.map_frame.height > PAINTED:
            return None
        if self._bare is None:
            grey = paint_grid(eyes.grid, eyes.map_frame)[:, :, 0]
            self._bare = MapPicture.of_pixels(np.ascontiguousarray(grey))
        return Painting(self._bare, Pose2D(*episode.start), encode)

    def ask_for(self, scene_id: str, light: LightCondition | None) -> DrawnScene | None:
        """A renderer that asks the drawing process, where there is one."""
        if self._connection is None:
            return None
        about = self.dataset.about_scene(scene_id)
        folder = safe_join(self.dataset.folder, about.folder).resolve()
        look = Look(str(folder), about.id, about.hash, light)
        shared = RendererShared(self._connection, self.settings.drawn_by)
        return shared.add_source(look.key, look.source)


def eyes_of(dataset: Dataset, settings: PictureSettings | None = None, drawing: str = "") -> Eyes:
    """The eyes of a dataset, kept with it: the next part is mostly of the same scene.

    Args:
        dataset: whose eyes.
        settings: how pictures are drawn; as the dataset was built when None.
        drawing: address of the drawing process; "" draws here.
    """
    wanted = settings or dataset.about.settings.pictures
    way = (wanted.visible_sets, wanted.drawn_by, drawing)
    if dataset.kept.get("eyes_way") != way:
        dataset.kept["eyes"] = None  # let go of the old splats first
        dataset.kept["eyes"] = Eyes(dataset, wanted, drawing)
        dataset.kept["eyes_way"] = way
    kept: Eyes = dataset.kept["eyes"]
    return kept


def bare_map(eyes: SensorSuite) -> tuple[U8, str]:
    """The occupancy picture of a scene before dots are drawn, and its hash."""
    picture = paint_grid(eyes.grid, eyes.map_frame)
    return picture, content_hash(picture)


@dataclass(frozen=True, eq=False)
class Opened:
    """An episode that is about to be drawn.

    Attributes:
        eyes: of its scene and light.
        bev_hash: of their map picture.
        goal: what its goal looks like [H, W, 3] and the picture's hash, for goal missions.
    """

    eyes: SensorSuite
    bev_hash: str
    goal: tuple[U8, str] | None


class PartDrawer:
    """Draws the steps of a part one after the other, and keeps the hashes.

    Where another process draws, views are asked for ahead, so that it draws the next ones while
    these are hashed and encoded; at most `AHEAD` are held.

    Args:
        dataset: whose episodes.
        blocks: the part's rows; hashes that they have are checked.
        settings: how pictures are drawn.
        check: refuse a picture that has another hash than its row says.
        drawing: address of the drawing process; "" draws here.
        files: let that process encode, too, where it can.
    """

    def __init__(
        self,
        dataset: Dataset,
        blocks: Sequence[EpisodeRows],
        settings: PictureSettings,
        *,
        check: bool = True,
        drawing: str = "",
        files: bool = True,
    ) -> None:
        self._dataset = dataset
        self._files = files
        self._check = check
        self._settings = settings
        self._blocks = blocks
        self._eyes = eyes_of(dataset, settings, drawing)
        self._ahead = bool(drawing)
        # rows have their hashes also where this cache does not keep the pictures
        self._depth = bool(settings.depth or dataset.about.settings.pictures.depth)
        self._names = (*PICTURES, DEPTH) if self._depth else PICTURES
        self._hashes: list[dict[str, list[str]]] = []
        self._seen: list[list[F32]] = []
        self.files: list[FileRecord] = []

    def steps(self) -> Iterator[DrawnStep]:
        """Every sample of the part, in order.

        Raises:
            DataError: a picture is not the one that its row names.
        """
        row = 0
        self._hashes, self._seen = [], []
        base: tuple[str, tuple[U8, str]] | None = None
        kept: list[DrawnStep] = []
        episodes = [self._dataset.episode(block.episode_id) for block in self._blocks]
        again = self._find_alike(episodes)
        seen = self._see(episodes, again)
        if self._ahead:
            seen = look_ahead(seen, AHEAD)
        with contextlib.closing(seen):  # type: ignore[type-var]
            for number, (episode, block) in enumerate(zip(episodes, self._blocks, strict=True)):
                own: dict[str, list[str]] = {name: [] for name in self._names}
                self._hashes.append(own)
                self._seen.append([])
                opened = next(seen)
                assert isinstance(opened, Opened)
                if kept:
                    source: Iterator[DrawnStep] = iter(kept)
                else:
                    if base is None or base[0] != episode.scene_id:
                        base = (episode.scene_id, bare_map(opened.eyes))
                    source = self._draw(opened, episode, block, base[1], seen)
                kept = []
                for t, step in enumerate(source):
                    mine = replace(
                        step, row=row, step=t, block=block, episode=episode, goal=opened.goal
                    )
                    for name in self._names:
                        own[name].append(mine.hashes[name])
                    if mine.pictures.people is not None:
                        self._seen[number].append(mine.pictures.people)
                    if self._check:
                        _check(mine)
                    if again[number]:
                        kept.append(mine)
                    yield mine
                    row += 1

    def _find_alike(self, episodes: Sequence[Episode]) -> list[bool]:
        """Of each episode, whether the one after it shows the same pictures."""
        blocks = self._blocks
        return [
            number + 1 < len(episodes)
            and len(blocks[number]) <= KEPT_STEPS
            and _alike(episode, blocks[number], episodes[number + 1], blocks[number + 1])
            for number, episode in enumerate(episodes)
        ]

    def _see(self, episodes: Sequence[Episode], again: Sequence[bool]) -> Iterator[Opened | Seen]:
        """All that needs a renderer, in order: of each episode its eyes, then its views."""
        for number, (episode, block) in enumerate(zip(episodes, self._blocks, strict=True)):
            eyes = self._eyes.of(episode)
            goal = None
            if isinstance(episode.mission, MissionGoal):
                picture = goal_picture(eyes, episode)
                goal = (picture, content_hash(np.asarray(picture)))
            yield Opened(eyes, self._eyes.bev_hash, goal)
            if not (number and again[number - 1]):
                views = self._see_views(eyes, episode, block)
                yield from self._with_people(views, episode, block) if block.person else views

    def _see_views(self, eyes: SensorSuite, episode: Episode, block: EpisodeRows) -> Iterator[Seen]:
        crowd = self._eyes.crowd(episode, block)
        if not (self._files and files_wanted(eyes, self._settings)):
            return draw_views(eyes, block.poses, depth=self._depth, crowd=crowd)
        every = self._settings.maps == "every"
        return draw_files(
            eyes, block.poses, self._settings.quality, depth=self._depth,
            painting=self._eyes.painting(episode, encode=every), crowd=crowd,
            black=bool(block.person),
        )  # fmt: skip

    def _with_people(
        self, views: Iterator[Seen], episode: Episode, block: EpisodeRows
    ) -> Iterator[Seen]:
        """Views with how much is seen of each person, as TRACKING samples have it."""
        tell = self._eyes.witness(episode, block)
        for step, seen in enumerate(views):
            yield replace(seen, people=tell(step, seen.pose))

    def _draw(
        self,
        opened: Opened,
        episode: Episode,
        block: EpisodeRows,
        base: tuple[U8, str],
        seen: Iterator[Opened | Seen],
    ) -> Iterator[DrawnStep]:
        eyes = opened.eyes
        frame = eyes.map_frame
        start = frame.pixel_of(*episode.start[:2])
        digest, dot = RowDigest(), 0  # above the agent's dot nothing changes
        radius = eyes.config.disc_radius

        shared: dict[str, bytes] = {}  # the BEV is the same at each step

        def views() -> Iterator[Seen]:
            for _ in range(len(block)):
                item = next(seen)
                assert isinstance(item, Seen)
                yield item

        steps = draw_episode(eyes, episode, block.poses, views(), black=bool(block.person))
        for t, pictures in enumerate(steps):
            x, y = map(float, block.poses[t, :2])
            places = (start, frame.pixel_of(x, y))
            known = {"bev": opened.bev_hash}
            if "occupancy" not in pictures.digests:
                same, dot = min(dot, places[1][0]) - radius, places[1][0]
                known["occupancy"] = digest.of(pictures.occupancy, same)
            hashes = pictures.hashes(known)
            kept = {**pictures.files, **shared}
            yield DrawnStep(t, t, block, episode, pictures, hashes, places, base, kept=kept)
            if "bev" in kept:
                shared["bev"] = kept["bev"]

    def hashed_blocks(self) -> list[EpisodeRows]:
        """The rows with the hashes of what `steps` has drawn."""
        return [
            block.with_hashes(own, np.stack(seen) if seen else None)
            for block, own, seen in zip(self._blocks, self._hashes, self._seen, strict=True)
        ]


def look_ahead(source: Iterator[T], most: int) -> Iterator[T]:
    """The items of `source`, made by another thread; at most `most` wait to be taken."""
    waiting: queue.Queue[tuple[T | None, BaseException | None]] = queue.Queue(most)
    stopped = threading.Event()

    def put(item: T | None, error: BaseException | None) -> None:
        while not stopped.is_set():
            with contextlib.suppress(queue.Full):
                waiting.put((item, error), timeout=0.1)
                return

    def work() -> None:
        try:
            for item in source:
                put(item, None)
                if stopped.is_set():
                    return
            put(None, StopIteration())
        except BaseException as error:
            put(None, error)

    thread = threading.Thread(target=work, name="look ahead", daemon=True)
    thread.start()
    try:
        while True:
            item, error = waiting.get()
            if isinstance(error, StopIteration):
                return
            if error is not None:
                raise error
            yield item  # type: ignore[misc]
    finally:
        stopped.set()
        thread.join()


def _alike(one: Episode, rows: EpisodeRows, other: Episode, others: EpisodeRows) -> bool:
    """Whether two episodes show the same pictures: missions of one path in one light."""
    if rows.people is not None:  # the same people, who do the same
        alike = one.people == other.people and rows.people.same_as(others.people)
    else:
        alike = others.people is None
    return (
        alike
        and (one.scene_id, one.light, one.start, rows.person)
        == (other.scene_id, other.light, other.start, others.person)
        and np.array_equal(rows.poses, others.poses)
    )


def sees_otherwise(step: DrawnStep) -> bool:
    """Whether another part of somebody is seen than the step's row says."""
    known, found = step.block.seen, step.pictures.people
    return known is not None and found is not None and not np.array_equal(known[step.step], found)


def _check(step: DrawnStep) -> None:
    if not step.block.hashes:
        return
    if sees_otherwise(step):
        raise DataError(
            "more or less is seen of people than when the dataset was made",
            where=f"episode {step.episode.id!r}, step {step.step}",
            remedy="use the version of gn0 that dataset.json names, or restore the row "
            "with `gn0 data repair`",
        )
    for name, found in step.hashes.items():
        if name not in step.block.hashes:
            continue
        wanted = step.block.hashes[name][step.step]
        if wanted and wanted != found:
            raise DataError(
                f"the {name} picture differs from the one drawn when the dataset was made",
                where=f"episode {step.episode.id!r}, step {step.step}",
                remedy="use the version of gn0 that dataset.json names, or restore the row "
                "with `gn0 data repair`",
            )  # fmt: skip
