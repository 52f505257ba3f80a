"""One part of a dataset: its episodes walked, labelled, drawn and written. Runs in a worker.

Answers depend on the payload and the files it names alone, and every file is written whole or not
at all; so a part that was interrupted is simply made again, to the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gn0.data.codec import encode_waypoints
from gn0.data.dataset import (
    DATASET_FILE,
    Dataset,
    DatasetPart,
    FileRecord,
    SkippedEpisode,
    file_digest,
    load_dataset_file,
)
from gn0.data.expert_labels import label_along, plan_expert, walk_actions
from gn0.data.sample_table import EpisodeRows, digest_labels, encode_rows, encode_table
from gn0.data.settings import PictureSettings
from gn0.errors import DataError, EpisodeError, PlanError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.progress import Progress, no_progress
from gn0.sim.collision import check_places
from gn0.storage import plain_path, safe_join, write_bytes

if TYPE_CHECKING:
    from gn0.data.picture_cache import DrawnStep
    from gn0.render.share.server_process import DrawServer


class PartPlan(msgspec.Struct, frozen=True):
    """What a worker is told.

    Attributes:
        folder: folder of the dataset.
        name: name of the part.
        number: number of the part, from 0 over all scenes.
        scene: its scene.
        episodes: its episodes.
        pictures: the cache to make; None takes what the build was asked for.
        drawing: address of the drawing process; "" lets the worker draw for itself.
        agents: episodes that a policy is driven through side by side; decides no byte.
        on_device: whether these are on the device that is here; decides no byte.
    """

    folder: str
    name: str
    number: int
    scene: str
    episodes: tuple[str, ...]
    pictures: PictureSettings | None = None
    drawing: str = ""
    agents: int = 1
    on_device: bool = False


def drawn_at(plans: Sequence[PartPlan], server: DrawServer | None) -> list[PartPlan]:
    """The plans, told where pictures are drawn."""
    address = "" if server is None else server.address
    return [msgspec.structs.replace(plan, drawing=address) for plan in plans]


class PartDone(msgspec.Struct, frozen=True):
    """What a worker has made: a line of the journal.

    Attributes:
        part: the sample table.
        files: files of the cache, with paths relative to it.
        notes: what the cache's last step must know of the part.
    """

    part: DatasetPart
    files: tuple[FileRecord, ...] = ()
    notes: dict[str, Any] = {}


@lru_cache(maxsize=1)
def _open(folder: str, stamp: int) -> Dataset:
    path = plain_path(folder)
    return Dataset(path, load_dataset_file(path))


def open_building(folder: Path | str) -> Dataset:
    """The dataset of a folder, its build ended or not; kept while dataset.json is unchanged."""
    return _open(str(folder), (Path(folder) / DATASET_FILE).stat().st_mtime_ns)


def build_part(payload: dict[str, Any], progress: Progress = no_progress) -> dict[str, Any]:
    """Walk, label and draw the episodes of a part; write its sample table and its shard.

    Raises:
        BenchError: a scene changed.
        StorageError: a file cannot be read or written.
    """
    plan = msgspec.convert(payload, PartPlan)
    dataset = open_building(plan.folder)
    blocks, skipped = collect_part(dataset, plan, progress)
    blocks, files, notes = draw_part(dataset, plan, blocks, progress)
    part = write_part(dataset, plan, blocks, skipped)
    answer: dict[str, Any] = msgspec.to_builtins(PartDone(part, tuple(files), notes))
    return answer


def render_part(payload: dict[str, Any], progress: Progress = no_progress) -> dict[str, Any]:
    """Draw a part again from its sample table: poses in, pictures out.

    The hashes that the table has are checked; where it has none, it gets them.

    Raises:
        DataError: a picture is drawn otherwise than its hash says.
        StorageError, FormatError: the table is missing or damaged.
    """
    plan = msgspec.convert(payload, PartPlan)
    dataset = open_building(plan.folder)
    known = next(part for part in dataset.about.parts if part.name == plan.name)
    blocks = dataset.part_rows(known)
    drawn, files, notes = draw_part(dataset, plan, blocks, progress)
    # a run that was killed may have written the table, hashes and all, before anybody noted it
    noted = dataset.about.rendered and all(block.rendered for block in blocks)
    part = known if noted else write_part(dataset, plan, drawn, known.skipped)
    answer: dict[str, Any] = msgspec.to_builtins(PartDone(part, tuple(files), notes))
    return answer


def draw_part(
    dataset: Dataset,
    plan: PartPlan,
    blocks: Sequence[EpisodeRows],
    progress: Progress = no_progress,
) -> tuple[list[EpisodeRows], list[FileRecord], dict[str, Any]]:
    """Draw the pictures of a part into its cache.

    Returns:
        The rows with hashes, the files of the cache, and notes for its last step.
    """
    settings = plan.pictures or dataset.about.settings.pictures
    if settings.layout == "none":
        return list(blocks), [], {}
    from gn0.data.cache_lerobot import write_videos  # labels alone need neither
    from gn0.data.cache_webdataset import write_shard
    from gn0.data.part_pictures import PartDrawer

    drawer = PartDrawer(dataset, blocks, settings, drawing=plan.drawing)
    notes: dict[str, Any] = {}
    steps = told_steps(drawer.steps(), sum(map(len, blocks)), progress)
    if settings.layout == "lerobot":
        files, notes = write_videos(dataset, plan.number, steps, settings)
    else:
        files = write_shard(dataset.folder, plan.name, steps, settings)
    return drawer.hashed_blocks(), files, notes


def told_steps(steps: Iterable[DrawnStep], count: int, progress: Progress) -> Iterator[DrawnStep]:
    """The steps of a part, each told when it is drawn."""
    progress("drawing samples", 0, count)
    for done, step in enumerate(steps, 1):
        yield step
        progress("drawing samples", done, count)


def collect_part(
    dataset: Dataset, plan: PartPlan, progress: Progress = no_progress
) -> tuple[list[EpisodeRows], list[SkippedEpisode]]:
    """The samples of a part's episodes, and the episodes that cannot be walked."""
    navigation = dataset.navigation(plan.scene)
    driver = None
    if dataset.about.settings.dagger is not None:
        from gn0.data.part_pictures import eyes_of
        from gn0.data.policy_driver import Driver  # the expert needs no simulator

        settings = plan.pictures or dataset.about.settings.pictures
        if plan.drawing:
            ask = eyes_of(dataset, settings, plan.drawing).ask_for
            driver = Driver(dataset, ask, agents=plan.agents, on_device=plan.on_device)
        else:
            driver = Driver(dataset, agents=plan.agents, on_device=plan.on_device)
    found: dict[str, EpisodeRows | EpisodeError | PlanError] = {}
    episodes = [dataset.episode(name) for name in plan.episodes]
    fitting: list[Episode] = []
    for episode in episodes:
        try:
            check_places(navigation, episode, dataset.about.agent.radius)
            fitting.append(episode.into_area(dataset.about.settings.labels.depth))
        except (EpisodeError, PlanError) as error:
            found[episode.id] = error
    walked = (
        walk_experts(navigation, fitting, dataset)
        if driver is None
        else driver.collect_all(fitting)
    )
    progress("walking episodes", len(found), len(episodes))
    for episode, made in walked:
        found[episode.id] = made
        progress("walking episodes", len(found), len(episodes))
    blocks: list[EpisodeRows] = []
    skipped: list[SkippedEpisode] = []
    for name in plan.episodes:  # in the order of the plan, whoever ended first
        made = found[name]
        if isinstance(made, EpisodeRows):
            blocks.append(made)
        else:
            skipped.append(SkippedEpisode(id=name, reason=made.what))
    return blocks, skipped


def walk_experts(
    navigation: NavigationMap, episodes: Sequence[Episode], dataset: Dataset
) -> Iterator[tuple[Episode, EpisodeRows | EpisodeError | PlanError]]:
    """The expert's own rows of episodes of one scene, or why one cannot be walked."""
    for episode in episodes:
        try:
            if episode.people:
                from gn0.data.expert_people import PeopleExpert  # others need no simulator

                expert = dataset.kept.setdefault("people_expert", PeopleExpert(dataset))
                yield episode, expert.collect(episode)
            else:
                yield episode, collect_expert(navigation, episode, dataset)
        except (EpisodeError, PlanError) as error:
            yield episode, error


def write_part(
    dataset: Dataset,
    plan: PartPlan,
    blocks: Sequence[EpisodeRows],
    skipped: Sequence[SkippedEpisode],
) -> DatasetPart:
    """Write a part's sample table, and say what is in it."""
    data = encode_table(encode_rows(blocks))
    part = DatasetPart(
        name=plan.name,
        scene=plan.scene,
        episodes=tuple(block.episode_id for block in blocks),
        rows=sum(map(len, blocks)),
        labels=digest_labels(blocks),
        file=file_digest(data),
        size=len(data),
        skipped=tuple(skipped),
    )
    write_bytes(safe_join(dataset.folder, part.path), data)
    return part


def collect_expert(navigation: NavigationMap, episode: Episode, dataset: Dataset) -> EpisodeRows:
    """The expert's own walk through an episode, labelled along the way.

    Raises:
        PlanError: the goal cannot be reached.
    """
    settings = dataset.about.settings
    poses, actions = plan_expert(navigation, episode, settings.labels)
    labels = label_along(navigation, episode, poses, actions, settings.labels)
    collided = np.zeros(len(actions), bool)
    if settings.labels.variant == "field":  # the others' steps are whole ones
        collided = walk_actions(navigation, episode.agent, episode.start, actions)[1]
    frame = settings.tokens.of_grid(navigation.grid)
    distance = navigation.geodesic(episode.destination).distance(poses[:-1, :2])
    return EpisodeRows(
        episode_id=episode.id,
        poses=poses[:-1],
        executed=actions,
        actions=labels.actions6,
        waypoints=labels.waypoints,
        pixels=encode_waypoints(frame, labels.waypoints, poses[:-1]),
        valid=labels.valid,
        distance=distance.astype(np.float32),
        collided=collided,
    )


def check_plan(plan: PartPlan, made: PartDone) -> None:
    """Refuse a part that is not the planned one.

    Raises:
        DataError: it is of another scene, or of other episodes.
    """
    part = made.part
    found = {*part.episodes, *(skipped.id for skipped in part.skipped)}
    if part.scene != plan.scene or found != set(plan.episodes):
        raise DataError(
            f"part {part.name!r} holds other episodes than planned",
            where=plan.folder,
            remedy="choose another --out",
        )
