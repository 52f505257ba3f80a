"""Follow missions from the path pool (paper, Alg. 4): a person walks a path, an agent follows it.

One scene is a unit of work of `gn0.suites.generation`, as it is of goal missions.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gn0.data.follow_judge import REFUSED, SENTENCES, FollowJudge
from gn0.data.follow_reference import FollowReference, FollowTracker, with_reference
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, MissionFollow, check_episode
from gn0.missions.generate.follow_cast import (
    choose_cast,
    draw_level,
    dress_people,
    open_cast,
    tell_whom,
)
from gn0.missions.generate.follow_company import CompanyPlanner
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.generate.follow_spawn import draw_offsets, spawn_behind
from gn0.missions.generate.follow_tracks import FollowTrackRow
from gn0.missions.generate.human_path import (
    HumanPath,
    draw_category,
    draw_speed,
    find_way,
    invalid_path,
    retime_path,
    walk_path,
)
from gn0.missions.generate.path_missions import UNSEEN, draw_light
from gn0.missions.generate.path_pool import PathRecord, PathText
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.language.follow_words import FollowText
from gn0.missions.language.words_judge import Moment
from gn0.progress import Progress, no_progress
from gn0.scenes.scene import Scene
from gn0.seeds import derive_seed, random_stream
from gn0.suites.generation import ScenePart, build_part, save_part

if TYPE_CHECKING:
    from gn0.geometry import F64

PROVIDER = "follow words"


@dataclass(frozen=True, eq=False)
class FollowMission:
    """A mission that was made: its episode, its words, its tracks."""

    episode: Episode
    text: PathText
    track: FollowTrackRow


@dataclass(frozen=True, eq=False)
class FollowMissions:
    """What became of the paths of a scene.

    Attributes:
        missions: in the order of their paths.
        candidates: how many were drawn.
        fell: for which reasons how many fell.
        refused: why the judge refused a sentence, and how often.
    """

    missions: tuple[FollowMission, ...]
    candidates: int
    fell: dict[str, int]
    refused: dict[str, int] = field(default_factory=dict)


def generate_scene(payload: dict[str, Any], progress: Progress = no_progress) -> dict[str, Any]:
    """One unit of work: whatever else is made of a scene's paths, and its follow missions.

    Raises:
        BenchError: the scene changed under the generation.
        StorageError, FormatError, SceneError: it cannot be read, or the part not written.
    """
    part = build_part(payload, progress)
    settings, request = part.request.settings, part.request
    made = make_follow_missions(
        part.scene, part.navigation, part.paths.records, settings, request.seed,
        agent=request.agent, progress=progress,
    )  # fmt: skip
    return save_part(payload["out"], _joined(part, made))


def _joined(part: ScenePart, made: FollowMissions) -> ScenePart:
    """A part with its follow missions, those of a path behind its others."""
    mine = {mission.episode.path_id: mission for mission in made.missions}
    last = {episode.path_id: k for k, episode in enumerate(part.episodes)}
    episodes: list[Episode] = []
    for k, episode in enumerate(part.episodes):
        episodes.append(episode)
        if last[episode.path_id] == k and episode.path_id in mine:
            episodes.append(mine.pop(episode.path_id).episode)
    episodes += [mission.episode for mission in mine.values()]
    return msgspec.structs.replace(
        part,
        episodes=episodes,
        texts=[*part.texts, *(mission.text for mission in made.missions)],
        tracks=tuple(mission.track for mission in made.missions),
        report=msgspec.structs.replace(
            part.report,
            follow_candidates=made.candidates,
            follow_fell=made.fell,
            fallbacks={**part.report.fallbacks, **made.refused},
        ),
    )


def make_follow_missions(
    scene: Scene,
    navigation: NavigationMap,
    records: Sequence[PathRecord],
    settings: MissionSettings,
    seed: int,
    *,
    agent: AgentSpec,
    progress: Progress = no_progress,
) -> FollowMissions:
    """A follow mission of each path that allows one; the same arguments give the same missions.

    Args:
        scene: the scene.
        navigation: its map for this agent.
        records: paths of this scene.
        settings: which missions.
        seed: root seed.
        agent: who follows.
        progress: progress sink.
    """
    maker = _Maker(scene, navigation, settings, seed, agent)
    fell: Counter[str] = Counter()
    found: list[FollowMission] = []
    candidates = 0
    for done, record in enumerate(records):
        progress("follow missions", done, len(records))
        for attempt in range(maker.follow.attempts):
            candidates += 1
            mission, reason = maker.make(record, attempt)
            if mission is not None:
                found.append(mission)
                break
            fell[reason] += 1
            if reason == "short":  # of a path, not of a draw
                break
    progress("follow missions", len(records), len(records))
    return FollowMissions(
        tuple(found), candidates, dict(sorted(fell.items())), dict(sorted(maker.refused.items()))
    )


class _Maker:
    """Makes candidates in one scene."""

    def __init__(
        self,
        scene: Scene,
        navigation: NavigationMap,
        settings: MissionSettings,
        seed: int,
        agent: AgentSpec,
    ) -> None:
        self.scene, self.navigation, self.settings = scene, navigation, settings
        self.follow: FollowSettings = settings.following
        self.seed, self.agent = seed, agent
        self.tracker = FollowTracker(scene, navigation, self.follow)
        self.company = CompanyPlanner(scene.grid)
        self.refused: Counter[str] = Counter()
        self._judge: FollowJudge | None = None
        self._ways: dict[str, F64] = {}

    def _way(self, record: PathRecord) -> F64:
        if record.path_id not in self._ways:
            self._ways = {record.path_id: find_way(self.scene.grid, record.array)}
        return self._ways[record.path_id]

    def make(self, record: PathRecord, attempt: int) -> tuple[FollowMission | None, str]:
        """(Mission, ""), or (None, why the candidate fell)."""
        follow, agent = self.follow, self.agent
        rng = random_stream(self.seed, "follow mission", record.path_id, attempt)
        distance, lateral = draw_offsets(follow, rng)
        way = self._way(record)
        if float(np.hypot(*np.diff(way, axis=0).T).sum()) < follow.least_length:
            return None, "short"
        spawn = spawn_behind(self.navigation, way, distance, lateral, follow, agent.radius)
        if spawn is None:
            return None, "no room behind"
        category = draw_category(follow, rng)
        length = float(np.hypot(*np.diff(spawn.way, axis=0).T).sum())
        speed = draw_speed(length, follow, agent, rng)
        if speed is None:
            return None, "no speed fits"
        path = walk_path(retime_path(spawn.way, category, speed, rng), category, follow)
        if path is None:
            return None, "too slow"
        reason = invalid_path(path, self.scene.grid, follow, agent)
        if reason:
            return None, reason
        return self._peopled(record, path, spawn.start, (distance, lateral), rng)

    def _peopled(
        self,
        record: PathRecord,
        path: HumanPath,
        start: tuple[float, float, float],
        offsets: tuple[float, float],
        rng: np.random.Generator,
    ) -> tuple[FollowMission | None, str]:
        follow, unseen = self.follow, self._unseen(record.split)
        level, count = draw_level(follow, rng)
        others = self.company.plan(path, start, offsets[0], count, follow, rng)
        least = min(count, 1) if follow.count is msgspec.UNSET else count
        if len(others) < least:
            return None, "no room for others"
        cast = open_cast(follow.cast_seed, follow.cast, unseen)
        chosen = choose_cast(level, len(others), cast, rng)
        if chosen is None:
            return None, "nobody like that"
        names, records = chosen
        people = dress_people([path.person, *others], names)
        end = people[0].path[-1]
        free = self.navigation.is_free(*end)
        if not free or self.navigation.region_of(*end) != self.navigation.region_of(*start[:2]):
            return None, "ends out of reach"
        mission = MissionFollow(
            goal=(float(end[0]), float(end[1])), instruction="?", human=names[0], person=1,
            category=path.category, level=level, distance=offsets[0], lateral=offsets[1],
            seconds=path.seconds,
        )  # fmt: skip
        episode = Episode(
            id=f"{record.path_id}-follow", scene_id=record.scene_id, mission=mission, start=start,
            path=(start[:2], mission.goal), split=record.split, seed=int(self.seed),
            agent=self.agent, path_id=record.path_id,
            light=draw_light(record, self.settings, self.seed), people=people,
        )  # fmt: skip
        reference, reason = self.tracker.track(check_episode(episode))
        if reference is None:
            return None, reason
        reason = self._meets(reference)
        if reason:
            return None, reason
        told, reason = self._tell(episode, path, records, offsets, reference)
        if told is None:
            return None, reason
        mission = msgspec.structs.replace(mission, instruction=told.text)
        episode = with_reference(msgspec.structs.replace(episode, mission=mission), reference)
        text = PathText(
            path_id=record.path_id, style="follow", text=told.text, provider=PROVIDER,
            version=told.version,
        )  # fmt: skip
        row = _row(episode, reference, told.decides, told.said)
        return FollowMission(check_episode(episode), text, row), ""

    def _tell(
        self,
        episode: Episode,
        path: HumanPath,
        records: Sequence[dict[str, str]],
        offsets: tuple[float, float],
        reference: FollowReference,
    ) -> tuple[FollowText | None, str]:
        """(Words, ""), or (None, why there are none); those that the judge refuses are counted."""
        judged = self.follow.judge == "pictures"
        moments: list[Moment] = []
        for attempt in range(SENTENCES if judged else 1):
            more = (attempt,) if attempt else ()
            told = tell_whom(
                self.scene, self.navigation, path, episode.people, records, episode.start, offsets,
                seed=derive_seed(self.seed, "follow words", episode.path_id, *more) % 2**31,
                held_out=self._unseen(episode.split), eye=self.agent.camera_height,
            )  # fmt: skip
            if told is None:
                return None, "no words"
            if not judged:
                return told, ""
            if self._judge is None:
                sight = self.tracker.sight(episode)
                self._judge = FollowJudge(self.scene, self.navigation, sight)
            moments = moments or self._judge.moments(episode, reference)
            verdict = self._judge.judge(episode, moments, told)
            if verdict.verdict == "fits":
                return told, ""
            self.refused[REFUSED[verdict.verdict]] += 1
        return None, "not proven"

    def _unseen(self, split: str) -> bool:
        phrasings = self.settings.phrasings
        return split in UNSEEN if phrasings == "by_split" else phrasings == "held_out"

    def _meets(self, reference: FollowReference) -> str:
        """Whether somebody met the person after all, played with the agent; "" nobody."""
        others = reference.people[1:] - reference.people[:1]
        near = len(others) and float(np.hypot(*others.transpose(2, 0, 1)).min())
        return "met by somebody" if len(others) and near < self.follow.meet else ""


def _row(
    episode: Episode, reference: FollowReference, decides: str, said: dict[str, str]
) -> FollowTrackRow:
    mission = episode.mission
    assert isinstance(mission, MissionFollow)
    step = episode.agent.step_ticks / 10
    person = reference.people[0]
    return FollowTrackRow(
        episode_id=episode.id,
        person=mission.person,
        time=[round(k * step, 1) for k in range(len(person))],
        person_x=person[:, 0].tolist(),
        person_y=person[:, 1].tolist(),
        person_yaw=[math.atan2(y, x) for x, y in reference.faces.tolist()],
        person_walked=reference.walked.tolist(),
        person_clip=reference.clips.tolist(),
        agent_x=reference.poses[:, 0].tolist(),
        agent_y=reference.poses[:, 1].tolist(),
        agent_yaw=reference.poses[:, 2].tolist(),
        actions=reference.actions.tolist(),
        violations=int((reference.violations >= 0).sum()),
        decides=decides,
        said=msgspec.json.encode(dict(sorted(said.items()))).decode(),
    )
