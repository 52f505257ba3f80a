"""What a dataset holds, in numbers: paths, turns, actions, words, places.

Paper, appendix "Expanded Dataset Statistics and Balancing Details": path lengths, episodes a scene,
static and dynamic share, object categories, action distribution before and after balancing.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.config import Config, load_json
from gn0.data.dataset import Dataset
from gn0.data.people_stats import PeopleStats, PeopleTally, count_people
from gn0.geometry import F64
from gn0.maps.grid import FREE
from gn0.missions.episode import Episode, MissionFollow, MissionGoal, MissionInstruction
from gn0.paper import ACTION_SHARES, FORWARD, LEFT, RIGHT, STOP
from gn0.progress import Progress, no_progress
from gn0.suites.generation_folder import MANIFEST, Manifest

ACTION_NAMES = ("stop", "forward", "left", "right")
_PAPER_SHARES = {  # %, after balancing
    "forward": ACTION_SHARES[FORWARD],
    "left": ACTION_SHARES[LEFT],
    "right": ACTION_SHARES[RIGHT],
    "stop": ACTION_SHARES[STOP],
}
TURN = math.radians(30)  # least change of heading, summed over a turn on the spot, that counts
BALANCE_FILE = "balance.json"
_WORD = re.compile(r"[a-z]+(?:'[a-z]+)?")
_CELL = 0.25  # m, of the coverage maps
_NARROWEST = 1e-9  # of what is spread over bins: below it a width would round to nothing


class Spread(Config, frozen=True):
    """Where values lie: their number, mean, quantiles, and a histogram.

    Attributes:
        count: how many.
        mean, low, median, high: mean; 5 %, 50 % and 95 % quantile.
        smallest, largest: of all.
        edges: of the bins [B+1].
        bins: how many in each [B].
    """

    count: int
    mean: float
    low: float
    median: float
    high: float
    smallest: float
    largest: float
    edges: tuple[float, ...]
    bins: tuple[int, ...]


class SceneStats(Config, frozen=True):
    """A scene and what happens in it.

    Attributes:
        id: id of the scene.
        source: its make: "procedural apartment 1", "world", …
        splits: of its episodes.
        area: walkable ground of the agent [m²].
        rooms, objects: how many.
        detour: mean path length over straight distance: 1 is an open hall.
        episodes, samples: how many.
        covered: share of the walkable ground within 0.25 m of a sample.
    """

    id: str
    source: str
    splits: tuple[str, ...]
    area: float
    rooms: int
    objects: int
    detour: float
    episodes: int
    samples: int
    covered: float


class DatasetStats(Config, frozen=True):
    """The content of `stats.json`.

    Attributes:
        name: name of the suite that the dataset was built from.
        scenes: in order of ids.
        episodes: by split, then mission.
        samples: by split.
        missions: episodes by mission: goal, instruction, follow.
        styles: episodes by the style of their instruction.
        lights: episodes by the name of their light.
        paths: how many different paths the episodes share.
        length: length of reference paths [m].
        turns: turns of 30° and more in an episode.
        steps: actions in an episode.
        categories: episodes by goal category, most first.
        actions: share of each action among the labels [%], before balancing.
        balanced: the same after, {} where the dataset was not balanced.
        paper: the table of the paper.
        words: in an instruction.
        vocabulary: different words.
        texts: different instructions.
        frequent: the most frequent words.
        candidates: how many candidate paths there were, fell at each filter and were accepted.
        skipped: episodes without samples, by reason.
        people: who is in the samples; unset where nobody is.
    """

    name: str
    scenes: tuple[SceneStats, ...]
    episodes: dict[str, dict[str, int]]
    samples: dict[str, int]
    missions: dict[str, int]
    styles: dict[str, int]
    lights: dict[str, int]
    paths: int
    length: Spread
    turns: Spread
    steps: Spread
    categories: dict[str, int]
    actions: dict[str, float]
    balanced: dict[str, float]
    paper: dict[str, float]
    words: Spread
    vocabulary: int
    texts: int
    frequent: dict[str, int]
    candidates: dict[str, int]
    skipped: dict[str, int]
    people: PeopleStats | msgspec.UnsetType = msgspec.UNSET


@dataclass(frozen=True, eq=False)
class Coverage:
    """Where samples lie in a scene: visits [H, W] a cell of 0.25 m, and which cells are ground.

    Attributes:
        scene: its id.
        visits: samples a cell, row 0 at the least y.
        ground: share of each cell that the agent can stand on [H, W].
    """

    scene: str
    visits: NDArray[np.int64]
    ground: F64


@dataclass
class _Tally:
    """What is counted over the samples, table by table."""

    samples: Counter[str] = field(default_factory=Counter)
    actions: NDArray[np.int64] = field(default_factory=lambda: np.zeros(4, np.int64))
    steps: list[int] = field(default_factory=list)
    turns: list[int] = field(default_factory=list)
    places: dict[str, list[F64]] = field(default_factory=dict)
    rows: Counter[str] = field(default_factory=Counter)
    people: PeopleTally = field(default_factory=PeopleTally)


def measure_dataset(
    dataset: Dataset, progress: Progress = no_progress
) -> tuple[DatasetStats, list[Coverage]]:
    """Count everything that a dataset holds; reads each table once.

    Raises:
        StorageError, FormatError: a table or a scene is missing or damaged.
    """
    episodes = {episode.id: episode for episode in dataset.episodes}
    tally = _Tally()
    parts = dataset.about.parts
    for done, part in enumerate(parts):
        progress("samples", done, len(parts))
        for block in dataset.part_rows(part):
            episode = episodes[block.episode_id]
            split = episode.split
            tally.samples[split] += len(block)
            tally.people.add(block, episode)
            tally.rows[episode.scene_id] += len(block)
            tally.actions += np.bincount(block.actions[:, 0], minlength=4)[:4]
            tally.steps.append(len(block))
            tally.turns.append(count_turns(block.executed, dataset.about.agent.turn_degrees))
            tally.places.setdefault(episode.scene_id, []).append(block.poses[:, :2])
    progress("samples", len(parts), len(parts))
    scenes, coverage = [], []
    for done, about in enumerate(dataset.about.scenes):
        progress("scenes", done, len(dataset.about.scenes))
        mine = [e for e in dataset.episodes if e.scene_id == about.id]
        stats, cover = _measure_scene(dataset, about.id, mine, tally)
        scenes.append(stats)
        coverage.append(cover)
    progress("scenes", len(scenes), len(scenes))
    return _collect(dataset, tally, scenes), coverage


def count_turns(actions: NDArray[np.integer], turn_degrees: float) -> int:
    """How often an action sequence [T] changes its heading by 30° or more between two steps."""
    turns, heading = 0, 0
    for action in [*np.asarray(actions).tolist(), 1]:
        if action == 2 or action == 3:
            heading += 1 if action == 2 else -1
        elif heading:
            turns += abs(heading) * math.radians(turn_degrees) >= TURN - 1e-9
            heading = 0
    return int(turns)


def spread_of(values: Sequence[float], bins: int = 24, *, whole: bool = False) -> Spread:
    """Where values lie; with `whole` numbers the bins are whole, too."""
    v = np.asarray(values, np.float64)
    if not len(v):
        return Spread(
            count=0, mean=0.0, low=0.0, median=0.0, high=0.0, smallest=0.0, largest=0.0,
            edges=(0.0, 1.0), bins=(0,),
        )  # fmt: skip
    top = float(v.max())
    if whole:
        width = float(max(1, math.ceil((top + 1) / bins)))
    else:
        width = _round_width(max(top or 1.0, _NARROWEST) / bins)
    edges = width * np.arange(math.floor(top / width) + 2)
    counts, _ = np.histogram(v, edges)
    low, median, high = (float(q) for q in np.quantile(v, (0.05, 0.5, 0.95)))
    return Spread(
        count=len(v),
        mean=float(v.mean()),
        low=low,
        median=median,
        high=high,
        smallest=float(v.min()),
        largest=top,
        edges=tuple(edges.tolist()),
        bins=tuple(int(c) for c in counts),
    )


def _round_width(width: float) -> float:
    """The next greater of 1, 2, 2.5, 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(width))
    return next(step * power for step in (1.0, 2.0, 2.5, 5.0, 10.0) if step * power >= width)


def path_length(episode: Episode) -> float:
    """Length of an episode's reference path [m]."""
    points = np.asarray(episode.path, np.float64).reshape(-1, 2)
    return float(np.hypot(*np.diff(points, axis=0).T).sum()) if len(points) > 1 else 0.0


def _measure_scene(
    dataset: Dataset, scene_id: str, episodes: Sequence[Episode], tally: _Tally
) -> tuple[SceneStats, Coverage]:
    scene, navigation = dataset.scene(scene_id), dataset.navigation(scene_id)
    grid = navigation.inflated
    per = max(1, round(_CELL / grid.resolution))
    h, w = (-(-n // per) for n in grid.shape)
    free = np.zeros((h * per, w * per))
    free[: grid.shape[0], : grid.shape[1]] = grid.cells == FREE
    ground = free.reshape(h, per, w, per).mean(axis=(1, 3))
    visits = np.zeros((h, w), np.int64)
    for places in tally.places.get(scene_id, []):
        cells = np.clip(grid.cells_of(places) // per, 0, (h - 1, w - 1))
        np.add.at(visits, (cells[:, 0], cells[:, 1]), 1)
    near = visits > 0
    near[1:] |= visits[:-1] > 0
    near[:-1] |= visits[1:] > 0
    near[:, 1:] |= visits[:, :-1] > 0
    near[:, :-1] |= visits[:, 1:] > 0
    standable = ground > 0
    # behind a person the path ends before the person does
    ends = [e.path[-1] if isinstance(e.mission, MissionFollow) else e.goal for e in episodes]
    straight = [math.dist(e.start[:2], end) for e, end in zip(episodes, ends, strict=True)]
    walked = [path_length(e) for e in episodes]
    detour = [a / b for a, b in zip(walked, straight, strict=True) if b > 0.5]
    source = f"{scene.source.kind} {scene.source.detail}"
    return (
        SceneStats(
            id=scene_id,
            source=source if scene.source.kind == "procedural" else scene.source.kind,
            splits=tuple(sorted({e.split for e in episodes})),
            area=float(grid.free_area),
            rooms=len(scene.rooms),
            objects=len(scene.objects),
            detour=float(np.mean(detour)) if detour else 1.0,
            episodes=len(episodes),
            samples=tally.rows[scene_id],
            covered=float((near & standable).sum() / max(int(standable.sum()), 1)),
        ),
        Coverage(scene_id, visits, ground),
    )


def _mission_name(episode: Episode) -> str:
    return str(episode.mission.__struct_config__.tag)


def _collect(dataset: Dataset, tally: _Tally, scenes: Sequence[SceneStats]) -> DatasetStats:
    episodes = dataset.episodes
    by_split: dict[str, Counter[str]] = {}
    for episode in episodes:
        by_split.setdefault(episode.split, Counter())[_mission_name(episode)] += 1
    texts = [e.instruction for e in episodes]
    words = [_WORD.findall(text.lower()) for text in texts]
    seen = Counter(word for text in words for word in text)
    goals = [
        e.mission.category
        for e in episodes
        if isinstance(e.mission, MissionGoal | MissionInstruction) and e.mission.category
    ]
    styles = Counter(
        e.mission.style or "as given" if isinstance(e.mission, MissionInstruction)
        else "follow" if isinstance(e.mission, MissionFollow) else "base"
        for e in episodes
    )  # fmt: skip
    total = max(int(tally.actions.sum()), 1)
    shares = dict(zip(ACTION_NAMES, (100 * tally.actions / total).tolist(), strict=True))
    skipped = Counter(s.reason for part in dataset.about.parts for s in part.skipped)
    return DatasetStats(
        name=dataset.about.suite.name,
        scenes=tuple(scenes),
        episodes={split: _ordered(counts) for split, counts in sorted(by_split.items())},
        samples=dict(sorted(tally.samples.items())),
        missions=_ordered(Counter(map(_mission_name, episodes))),
        styles=_ordered(styles),
        lights=_ordered(Counter(e.light.name if e.light else "as made" for e in episodes)),
        paths=len({e.path_id or e.id for e in episodes}),
        length=spread_of([path_length(e) for e in episodes]),
        turns=spread_of(tally.turns, whole=True),
        steps=spread_of(tally.steps, whole=True),
        categories=_ordered(Counter(goals)),
        actions=shares,
        balanced=_read_balance(dataset.folder),
        paper=_PAPER_SHARES,
        words=spread_of([len(text) for text in words], whole=True),
        vocabulary=len(seen),
        texts=len(set(texts)),
        frequent=dict(sorted(seen.items(), key=lambda item: (-item[1], item[0]))[:40]),
        candidates=_read_candidates(dataset.folder),
        skipped=_ordered(skipped),
        people=count_people(dataset, tally.people) or msgspec.UNSET,
    )


def _ordered(counts: Counter[str]) -> dict[str, int]:
    """Most first, then by name."""
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def _read_balance(folder: Path) -> dict[str, float]:
    """Shares after balancing [%], {} where there is no balance."""
    path = folder / BALANCE_FILE
    if not path.is_file():
        return {}
    after = load_json(path, dict[str, Any]).get("after", {})
    shares = {name: after.get(name.upper(), {}).get("percent") for name in ACTION_NAMES}
    return {name: float(share) for name, share in shares.items() if share is not None}


def _read_candidates(folder: Path) -> dict[str, int]:
    """What became of candidate paths, {} for episodes that were not generated."""
    path = folder / MANIFEST
    if not path.is_file():
        return {}
    totals = load_json(path, Manifest).totals
    return {"candidates": totals.candidates, **totals.fell, "accepted": totals.paths}
