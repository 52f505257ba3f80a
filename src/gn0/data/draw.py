"""The pictures of a part: drawn from its rows, hashed, checked, and put into a cache."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gn0.data.cache import DrawnStep
from gn0.data.dataset import Dataset, FileRecord
from gn0.data.pictures import build_eyes, draw_episode, goal_picture, map_picture
from gn0.data.samples import PICTURES, EpisodeRows
from gn0.data.settings import PictureSettings
from gn0.errors import DataError
from gn0.geometry import U8
from gn0.missions.episode import Episode, MissionGoal
from gn0.render.light import LightCondition
from gn0.sim.presets import find_preset
from gn0.sim.sensors import SensorSuite, paint_grid
from gn0.storage import content_hash

KEPT_STEPS = 256  # longer walks are drawn again for each mission of their path


@dataclass(eq=False)
class Eyes:
    """The eyes of a dataset's agent: of the scene and light that were asked for last.

    Args:
        dataset: whose agent, camera and scenes.
        visible_sets: see `PictureSettings`.
    """

    dataset: Dataset
    visible_sets: bool = False
    _key: tuple[str, LightCondition | None] | None = None
    _suite: SensorSuite | None = field(default=None, repr=False)
    bev_hash: str = ""

    def of(self, episode: Episode) -> SensorSuite:
        """The sensors in an episode's scene, under its light."""
        light = episode.light
        key = (episode.scene_id, None if light is None or light.is_neutral else light)
        if self._suite is None or self._key != key:
            self._suite = None  # let go of the old splats first
            about = self.dataset.about
            self._suite = build_eyes(
                self.dataset.scene(episode.scene_id),
                self.dataset.navigation(episode.scene_id),
                find_preset(about.camera),
                about.agent,
                key[1],
                visible_sets=self.visible_sets,
            )
            self._key = key
            self.bev_hash = content_hash(map_picture(self._suite))
        return self._suite


def eyes_of(dataset: Dataset, visible_sets: bool) -> Eyes:
    """The eyes of a dataset, kept with it: the next part is mostly of the same scene."""
    kept = dataset.kept.get("eyes")
    if not isinstance(kept, Eyes) or kept.visible_sets != visible_sets:
        kept = dataset.kept["eyes"] = Eyes(dataset, visible_sets)
    return kept


def bare_map(eyes: SensorSuite) -> tuple[U8, str]:
    """The occupancy picture of a scene before dots are drawn, and its hash."""
    picture = paint_grid(eyes.grid, eyes.map_frame)
    return picture, content_hash(picture)


class PartDrawer:
    """Draws the steps of a part one after the other, and keeps the hashes.

    Args:
        dataset: whose episodes.
        blocks: the part's rows; hashes that they have are checked.
        settings: how pictures are drawn.
        check: refuse a picture that has another hash than its row says.
    """

    def __init__(
        self,
        dataset: Dataset,
        blocks: Sequence[EpisodeRows],
        settings: PictureSettings,
        *,
        check: bool = True,
    ) -> None:
        self._dataset = dataset
        self._check = check
        self._blocks = blocks
        self._eyes = eyes_of(dataset, settings.visible_sets)
        self._hashes: list[dict[str, list[str]]] = []
        self.files: list[FileRecord] = []

    def steps(self) -> Iterator[DrawnStep]:
        """Every sample of the part, in order.

        Raises:
            DataError: a picture is not the one that its row names.
        """
        row = 0
        self._hashes = []
        base: tuple[str, tuple[U8, str]] | None = None
        kept: list[DrawnStep] = []
        episodes = [self._dataset.episode(block.episode_id) for block in self._blocks]
        for number, (episode, block) in enumerate(zip(episodes, self._blocks, strict=True)):
            own: dict[str, list[str]] = {name: [] for name in PICTURES}
            self._hashes.append(own)
            if kept:
                source: Iterator[DrawnStep] = iter(kept)
            else:
                eyes = self._eyes.of(episode)
                if base is None or base[0] != episode.scene_id:
                    base = (episode.scene_id, bare_map(eyes))
                source = self._draw(eyes, episode, block, base[1])
            goal = self._draw_goal(episode)
            again = len(block) <= KEPT_STEPS and number + 1 < len(episodes)
            again = again and _alike(episode, block, episodes[number + 1], self._blocks[number + 1])
            kept = []
            for t, step in enumerate(source):
                mine = replace(step, row=row, step=t, block=block, episode=episode, goal=goal)
                for name in PICTURES:
                    own[name].append(mine.hashes[name])
                if self._check:
                    _check(mine)
                if again:
                    kept.append(mine)
                yield mine
                row += 1

    def _draw_goal(self, episode: Episode) -> tuple[U8, str] | None:
        if not isinstance(episode.mission, MissionGoal):
            return None
        picture = goal_picture(self._eyes.of(episode), episode)
        return picture, content_hash(np.asarray(picture))

    def _draw(
        self, eyes: SensorSuite, episode: Episode, block: EpisodeRows, base: tuple[U8, str]
    ) -> Iterator[DrawnStep]:
        frame = eyes.map_frame
        start = frame.pixel_of(*episode.start[:2])
        known = {"bev": self._eyes.bev_hash}
        for t, pictures in enumerate(draw_episode(eyes, episode, block.poses)):
            x, y = map(float, block.poses[t, :2])
            places = (start, frame.pixel_of(x, y))
            hashes = pictures.hashes(known)
            yield DrawnStep(t, t, block, episode, pictures, hashes, places, base)

    def hashed_blocks(self) -> list[EpisodeRows]:
        """The rows with the hashes of what `steps` has drawn."""
        return [
            block.with_hashes(own) for block, own in zip(self._blocks, self._hashes, strict=True)
        ]


def _alike(one: Episode, rows: EpisodeRows, other: Episode, others: EpisodeRows) -> bool:
    """Whether two episodes show the same pictures: missions of one path in one light."""
    return (one.scene_id, one.light, one.start) == (
        other.scene_id,
        other.light,
        other.start,
    ) and np.array_equal(rows.poses, others.poses)


def _check(step: DrawnStep) -> None:
    if not step.block.hashes:
        return
    for name in PICTURES:
        wanted = step.block.hashes[name][step.step]
        if wanted and wanted != step.hashes[name]:
            raise DataError(
                f"the {name} picture is drawn otherwise than when the dataset was made",
                where=f"episode {step.episode.id!r}, step {step.step}",
                remedy="use the version of gn0 that dataset.json names, or restore the row "
                "with `gn0 data repair`",
            )  # fmt: skip
