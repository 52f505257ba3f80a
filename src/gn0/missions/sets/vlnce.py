"""VLN-CE R2R: `{split}.json.gz` with its ground truth `{split}_gt.json.gz` beside it.

Positions are in Habitat's y-up frame, rotations (x, y, z, w) with the agent looking along −z. An
episode's id is a number there and a text in the ground truth. The agent receives
`instruction.instruction_text`; tokens and vocabulary are kept and not used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import msgspec
import numpy as np

from gn0.errors import EpisodeError, FormatError
from gn0.geometry import polyline_length
from gn0.maps.grid import OccupancyGrid
from gn0.missions.coordinate_frames import (
    Placement,
    habitat_rotation,
    habitat_to_world,
    world_to_habitat,
    yaw_from_habitat,
)
from gn0.missions.episode import Episode, MissionFollow, check_episode
from gn0.missions.episode_files import check_unique
from gn0.missions.sets.episode_set import EpisodeSet, Task
from gn0.missions.sets.json_file import GZIP_MAGIC, load_exact, save_exact
from gn0.missions.sets.vocabulary import PAD_INDEX, UNKNOWN_INDEX, cut_words, own_words
from gn0.paper import FORWARD, STOP
from gn0.storage import plain_path

TOKENS = 200  # an instruction is padded with zeros to this length
GOAL_RADIUS = 3.0  # m
_XYZ = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
_XYZW = Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]


class _Goal(msgspec.Struct):
    position: _XYZ


class _Instruction(msgspec.Struct):
    instruction_text: str


class _Episode(msgspec.Struct):
    """What we read of an episode; the rest is kept and not looked at."""

    episode_id: int | str
    scene_id: str
    start_position: _XYZ
    start_rotation: _XYZW
    instruction: _Instruction
    goals: list[_Goal] | None = None
    reference_path: list[_XYZ] | None = None


class _Truth(msgspec.Struct):
    locations: list[_XYZ]
    forward_steps: int
    actions: list[int]


@dataclass(frozen=True)
class VlnceFile:
    """The decoded files: the document, and the ground truth by episode id where there is one."""

    document: dict[str, Any]
    truth: dict[str, Any] | None

    @property
    def words(self) -> list[str]:
        """The words that its tokens are of; none in RxR's files."""
        vocabulary = self.document.get("instruction_vocab")
        words = vocabulary.get("word_list") if isinstance(vocabulary, dict) else None
        return [str(word) for word in words] if isinstance(words, list) else []


def truth_path(path: Path) -> Path:
    """`{split}_gt.json.gz` of `{split}.json.gz`."""
    stem = path.name.removesuffix(".gz").removesuffix(".json")
    return path.with_name(f"{stem}_gt{path.name[len(stem) :]}")


class ExporterVlnce:
    """VLN-CE R2R; `native` is a `VlnceFile`."""

    name = "vlnce"
    title = "VLN-CE R2R or RxR, a {split}.json.gz"
    camera = "vlnce_r2r"

    def recognises(self, path: Path) -> bool:
        """Whether it is a JSON file, gzipped or not."""
        try:
            with open(path, "rb") as stream:
                head = stream.read(64)
        except OSError:
            return False
        return head[:2] == GZIP_MAGIC or head.lstrip()[:1] == b"{"

    def load(self, path: Path) -> EpisodeSet:
        """Read a split, and its ground truth if that lies beside it.

        Raises:
            StorageError: missing or unreadable.
            FormatError: damaged, or an episode lacks a field; names file, episode and field.
        """
        path = plain_path(path)
        document = load_exact(path)
        if not isinstance(document, dict) or not isinstance(document.get("episodes"), list):
            raise FormatError(
                "no list of 'episodes'",
                file=path,
                field="episodes",
                remedy="give {split}.json.gz, not the ground truth",
            )
        tasks = tuple(
            _task(record, number, path) for number, record in enumerate(document["episodes"], 1)
        )
        check_unique(tasks, path)
        truth = None
        beside = truth_path(path)
        notes = []
        if beside.is_file():
            truth = load_exact(beside)
            known = _read_truth(truth, beside)
            notes = _compare_truth(known, tasks)
            tasks = tuple(_with_truth(task, known.get(task.id)) for task in tasks)
        else:
            notes = [f"no ground truth {beside.name} beside it"]
        name = path.name.removesuffix(".gz").removesuffix(".json")
        # RxR's instructions name their language, R2R's do not
        spoken = bool(tasks) and "language" in document["episodes"][0]["instruction"]
        return EpisodeSet(
            self.name,
            name,
            tasks,
            VlnceFile(document, truth),
            tuple(notes),
            "vlnce_rxr" if spoken else "",
        )

    def save(self, episodes: EpisodeSet, path: Path) -> None:
        """Write `path` (and the ground truth beside it): value for value what was read.

        Raises:
            FormatError: the set is of another format, or the name does not end in .json or .gz.
            StorageError: a file cannot be written.
        """
        native = episodes.native
        if not isinstance(native, VlnceFile):
            raise FormatError(f"a set of format {episodes.format!r} is not a VLN-CE file")
        path = plain_path(path)
        if not path.name.endswith((".json", ".json.gz")):
            raise FormatError(
                "the name must end in .json or .json.gz",
                file=path,
                remedy=f"for example {path / (episodes.name + '.json.gz')}",
            )
        save_exact(path, native.document)
        if native.truth is not None:
            save_exact(truth_path(path), native.truth)

    def build(
        self,
        episodes: Sequence[Episode],
        grids: Mapping[str, OccupancyGrid],
        name: str,
        words: Sequence[str] = (),
    ) -> EpisodeSet:
        """A document of our episodes with a vocabulary, by default of their words.

        `info.geodesic_distance` is the length of the reference path. Floors are at height 0. There
        is no ground truth but of missions to follow somebody: their reference's, without waits.

        Raises:
            EpisodeError: an episode makes no sense.
        """
        texts = [cut_words(episode.instruction) for episode in episodes]
        words = list(words) or own_words(texts)
        index = {word: number for number, word in enumerate(words)}
        records = [
            _record(
                check_episode(episode), number, [index.get(w, UNKNOWN_INDEX) for w in text][:TOKENS]
            )
            for number, (episode, text) in enumerate(zip(episodes, texts, strict=True), 1)
        ]
        document = {
            "episodes": records,
            "instruction_vocab": {
                "word_list": words,
                "word2idx_dict": index,
                "stoi": index,
                "itos": words,
                "num_vocab": len(words),
                "UNK_INDEX": UNKNOWN_INDEX,
                "PAD_INDEX": PAD_INDEX,
            },
        }
        tasks = tuple(_task(r, number, Path(name)) for number, r in enumerate(records, 1))
        truth = {
            str(number): _reference_truth(episode)
            for number, episode in enumerate(episodes, 1)
            if isinstance(episode.mission, MissionFollow) and episode.mission.actions
        }
        return EpisodeSet(self.name, name, tasks, VlnceFile(document, truth or None))

    def take(self, native: VlnceFile, rows: Sequence[int]) -> VlnceFile:
        """These episodes, their ground truth, and the rest of the document as it is."""
        records = [native.document["episodes"][row] for row in rows]
        document = {**native.document, "episodes": records}
        truth = native.truth
        if truth is not None:
            ids = {str(record["episode_id"]) for record in records}
            truth = {key: value for key, value in truth.items() if key in ids}
        return VlnceFile(document, truth)

    def placements(self, grid: OccupancyGrid) -> tuple[Placement, ...]:
        """The z-up turn of Habitat's frame; or the mirrored frame of GN0's CE occupancy maps."""
        x0, y0, x1, y1 = grid.bounds
        return (
            Placement("documented"),
            Placement("ce_occupancy", (1, -1), (x0 + x1, y0 + y1)),
            Placement("mirror_y", (1, -1)),
            Placement("mirror_x", (-1, 1)),
            Placement("turned", (-1, -1)),
        )


def _task(record: Any, number: int, file: Path) -> Task:
    try:
        e = msgspec.convert(record, _Episode)
        yaw = yaw_from_habitat(e.start_rotation)
    except (msgspec.ValidationError, FormatError) as error:
        who = record.get("episode_id", number) if isinstance(record, dict) else number
        raise FormatError(
            f"episode {who!r:.40}: {getattr(error, 'what', error)}",
            file=file,
            field="episodes",
            remedy="see the episode formats in docs/formats.md",
        ) from None
    start = habitat_to_world(e.start_position)[0]
    goal = habitat_to_world(e.goals[0].position)[0] if e.goals else None
    path = habitat_to_world(e.reference_path or np.zeros((0, 3)))
    heights = [start[2], *path[:, 2], *([] if goal is None else [goal[2]])]
    return Task(
        id=str(e.episode_id),
        scene=PurePosixPath(e.scene_id).stem,
        kind="instruction",
        instruction=e.instruction.instruction_text,
        start=(float(start[0]), float(start[1]), yaw),
        goal=None if goal is None else (float(goal[0]), float(goal[1])),
        path=tuple((float(x), float(y)) for x, y, _ in path),
        heights=(float(min(heights)), float(max(heights))),
        number=number,
    )


def _with_truth(task: Task, truth: _Truth | None) -> Task:
    """The task with the positions that upstream's NDTW compares with, seen from above."""
    if truth is None or not truth.locations:
        return task
    points = habitat_to_world(truth.locations)[:, :2].tolist()
    return msgspec.structs.replace(task, truth=tuple((x, y) for x, y in points))


def _read_truth(truth: Any, file: Path) -> dict[str, _Truth]:
    try:
        known = msgspec.convert(truth, dict[str, _Truth])
    except msgspec.ValidationError as error:
        raise FormatError(f"ground truth: {error}", file=file, remedy="restore the file") from None
    for key, value in known.items():
        if value.forward_steps != value.actions.count(1):
            raise FormatError(
                f"episode {key!r} has {value.actions.count(1)} forward actions, forward_steps says "
                f"{value.forward_steps}",
                file=file,
                field="forward_steps",
                remedy="restore the file",
            )
    return known


def _compare_truth(known: Mapping[str, _Truth], tasks: Sequence[Task]) -> list[str]:
    ids = {task.id for task in tasks}
    lacking, strange = len(ids - set(known)), len(set(known) - ids)
    notes = [f"ground truth of {len(ids) - lacking} of {len(ids)} episodes"]
    if strange:
        notes.append(f"ground truth names {strange} episodes that the split does not have")
    return notes


def _lift(x: float, y: float) -> list[float]:
    return [float(v) for v in world_to_habitat([[x, y, 0.0]])[0] + 0.0]


def _reference_truth(episode: Episode) -> dict[str, Any]:
    """Where the reference of a mission to follow somebody went, and by which actions.

    STOP ends an episode there, so that its waits are left out, and one stands at the end.
    """
    assert isinstance(episode.mission, MissionFollow)
    moves = [code for code in episode.mission.reference_actions if code != STOP]
    return {
        "locations": [_lift(x, y) for x, y in episode.path],
        "forward_steps": moves.count(FORWARD),
        "actions": [*moves, STOP],
    }


def _record(episode: Episode, number: int, tokens: list[int]) -> dict[str, Any]:
    path = np.array(episode.path or (episode.start[:2], episode.goal), np.float64)
    if not math.isfinite(polyline_length(path)):
        raise EpisodeError("its path has no length", where=f"episode {episode.id!r}")
    radius = GOAL_RADIUS if episode.in_area else episode.success_within(GOAL_RADIUS)
    return {
        "episode_id": number,
        "trajectory_id": number,
        "scene_id": f"gn0/{episode.scene_id}/{episode.scene_id}.glb",
        "start_position": _lift(*episode.start[:2]),
        "start_rotation": list(habitat_rotation(episode.start[2])),
        "info": {"geodesic_distance": float(polyline_length(path))},
        "goals": [{"position": _lift(*place), "radius": radius} for place in episode.goals],
        "instruction": {
            "instruction_text": episode.instruction,
            "instruction_tokens": tokens + [0] * (TOKENS - len(tokens)),
        },
        "reference_path": [_lift(x, y) for x, y in episode.path],
    }
