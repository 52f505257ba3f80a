"""NaVid and Uni-NaVid: conversations about the video of all that was seen so far.

NaVid answers with one action and its amount, Uni-NaVid with the next four words out of forward,
left, right and stop. Both know a navigation question by the fixed phrase "a video of historical
observations and an image of the current observation", so the question is asked in their words. A
clip is encoded once and cut for each question; one frame is one second, as their readers sample it.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import msgspec

from gn0.errors import FormatError
from gn0.export.clips import cut_clip, encode_frames, inspect_clip, read_clip
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_typed
from gn0.export.names import load_names, name_of, save_names
from gn0.export.trips import FORWARD, LEFT, RGB, RIGHT, Frame, Recovered, Trip
from gn0.export.words import WORD, CoarseMove, coarsen_turns, fits_turns, merge_amounts
from gn0.geometry import F64
from gn0.storage import safe_join, write_bytes

ANNOTATIONS, VIDEOS = "annotations.json", "nav_videos"
MARK = "a video of historical observations"  # what their loaders look for
QUESTION = (
    "<image>\nImagine you are a robot programmed for navigation tasks. You have been given a video "
    "of historical observations and an image of the current observation. Your assigned task is: "
    "'{}'. "
)
NAVID_ASKS = (
    "Analyze this series of images to decide your next move, which could involve turning left or "
    "right by a specific degree or moving forward a certain distance."
)
UNINAVID_ASKS = (
    "Analyze this series of images to determine your next four actions. The predicted action "
    "should be one of the following: forward, left, right, or stop."
)
AHEAD = 4
TURN = 30.0  # degrees of Uni-NaVid's left and right
_TASK = re.compile(r"Your assigned task is: '(.*)'\. Analyze", re.DOTALL)
_AMOUNT = re.compile(
    r"The next action is (?:move forward (\d+(?:\.\d+)?) cm|"
    r"turn (left|right) (\d+(?:\.\d+)?) degrees|(stop))\."
)
_WORDS = re.compile(r"(forward|left|right|stop)( (forward|left|right|stop)){3}")


class Turn(msgspec.Struct, rename={"who": "from"}):
    """One side's words."""

    who: str
    value: str


class Talk(msgspec.Struct):
    """An entry of `annotations.json`."""

    id: str
    video: str
    conversations: list[Turn]


class _Conversations(OwnPoses, ABC):
    """What both formats share: clips, entries, checks."""

    name = ""
    asks = ""
    answer = _WORDS

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """A walk without an end has no last answer."""
        return "" if trip.stopped else "it did not end with STOP"

    def poses(self, trip: Trip, settings: ExportSettings) -> F64:
        """Those of the longest clip."""
        return trip.poses[self.shown(trip)]

    def shown(self, trip: Trip) -> list[int]:
        """Poses whose pictures the clips hold."""
        return list(range(trip.frames))

    @abstractmethod
    def answers(self, trip: Trip) -> tuple[list[tuple[int, str]], dict[str, int]]:
        """(frames shown, answer) of each decision, and what was counted."""

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """The clips of an episode: one a question."""
        settings, episode = job.settings, trip.episode
        answers, notes = self.answers(trip)
        last = len(answers) - 1
        asked = [a for n, a in enumerate(answers) if n % settings.every == 0 or n == last]
        shown = set(self.shown(trip))
        seen = job.source.frames(trip, settings.preset(job.source), RGB)
        clip = encode_frames(
            (f.rgb for n, f in enumerate(seen) if n in shown and f.rgb is not None),
            settings.fps or 1,
        )
        talks = []
        for frames, answer in asked:
            video = f"{VIDEOS}/{place.number:06d}_{frames - 1}.mp4"
            job.shelf.put(safe_join(job.folder, video), cut_clip(clip, frames))
            question = QUESTION.format(episode.instruction) + self.asks
            talks.append(
                {
                    "id": f"NAV_ID_{settings.name}_{place.number:06d}_{frames - 1}",
                    "video": video,
                    "conversations": [
                        {"from": "human", "value": question},
                        {"from": "gpt", "value": answer},
                    ],
                }
            )
        return {"gn0": name_of(trip), "talks": talks, "notes": {"questions": len(asked), **notes}}

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """`annotations.json`."""
        talks = [msgspec.convert(talk, Talk) for record in records for talk in record["talks"]]
        write_bytes(job.folder / ANNOTATIONS, msgspec.json.encode(talks))
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """Whether each entry switches to navigation, answers in words it knows, has its clip."""
        faults = Faults()
        talks: list[Talk] = []
        with faults.guard():
            talks = load_typed(folder / ANNOTATIONS, list[Talk])
        faults.expect(len({t.id for t in talks}) == len(talks), "an id appears twice")
        sizes, rates = set(), set()
        for talk in talks:
            where = f"{ANNOTATIONS}, {talk.id!r}"
            with faults.guard():
                _, frames = _parts(talk, folder)
                question, answer = _sides(talk, folder)
                faults.expect(MARK in question, f"{where}: the question lacks {MARK!r}")
                faults.expect(question.startswith("<image>\n"), f"{where}: no <image> at the start")
                faults.expect(
                    self.answer.fullmatch(answer) is not None, f"{where}: answer {answer!r}"
                )
                facts = inspect_clip(safe_join(folder, talk.video))
                faults.expect(
                    facts.frames == frames,
                    f"{where}: {facts.frames} frames in {talk.video}, {frames} were seen",
                )
                sizes.add((facts.width, facts.height))
                rates.add(facts.fps)
        faults.expect(len(sizes) <= 1, "videos of several sizes")
        faults.expect(len(rates) <= 1, "videos of several frame rates")
        return faults.told()

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back."""
        groups: dict[int, list[Talk]] = {}
        for talk in load_typed(folder / ANNOTATIONS, list[Talk]):
            groups.setdefault(_parts(talk, folder)[0], []).append(talk)
        names = load_names(folder, len(groups))
        found = []
        for name, talks in zip(names, groups.values(), strict=True):
            longest = max(talks, key=lambda talk: _parts(talk, folder)[1])
            task = _TASK.search(_sides(longest, folder)[0])
            if task is None:
                raise FormatError("no task in the question", file=folder / ANNOTATIONS)
            labels = tuple((_parts(t, folder)[1] - 1, _sides(t, folder)[1]) for t in talks)
            path = safe_join(folder, longest.video)
            found.append(
                Recovered(
                    id=name.id,
                    scene=name.scene,
                    instruction=task[1],
                    frames=_parts(longest, folder)[1],
                    moves=self.moves(labels),
                    labels=labels,
                    picture=lambda pose, path=path: Frame(read_clip(path, pose, 1)[0], None),  # type: ignore[misc]
                )
            )
        return found

    def moves(self, labels: Sequence[tuple[int, str]]) -> tuple[int, ...] | None:
        """The moves that the answers tell; None where not every decision was asked."""
        return None


class ExporterNaVid(_Conversations):
    """NaVid; see the module."""

    name = "navid"
    title = "NaVid conversations (one action with its amount)"
    reader = "NaVid: its LLaMA-VID style supervised data, `video_folder` set to this folder"
    frame = "no coordinates: pictures and amounts in cm and degrees"
    asks = NAVID_ASKS
    answer = _AMOUNT

    def answers(self, trip: Trip) -> tuple[list[tuple[int, str]], dict[str, int]]:
        """Moves put together, up to three."""
        agent = trip.episode.agent
        found = merge_amounts(trip.moves.tolist(), agent.forward_step, agent.turn_degrees)
        return [(d.pose + 1, f"The next action is {d.answer}.") for d in found], {}

    def moves(self, labels: Sequence[tuple[int, str]]) -> tuple[int, ...] | None:
        """What the answers say; None where some were not asked, or of steps other than ours."""
        found: list[int] = []
        for (begin, answer), (end, _) in pairwise(labels):
            match = _AMOUNT.fullmatch(answer)
            if match is None or match[4]:
                return None
            move = FORWARD if match[1] else {"left": LEFT, "right": RIGHT}[match[2]]
            amount = float(match[1]) / 25 if match[1] else float(match[3]) / 15
            if abs(amount - (end - begin)) > 1e-6:
                return None
            found += [move] * (end - begin)
        return tuple(found)


class ExporterUniNaVid(_Conversations):
    """Uni-NaVid; see the module. Its turns are of 30°: two of 15° are one word."""

    name = "uninavid"
    title = "Uni-NaVid conversations (the next four actions)"
    reader = "Uni-NaVid, finetuning: `data_path` annotations.json, `video_folder` this folder"
    frame = "no coordinates: pictures and words (forward 0.25 m, left and right 30°)"
    asks = UNINAVID_ASKS

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """Turns that 30° cannot be made of."""
        if not fits_turns(trip, TURN):
            return "turns of which 30° cannot be made"
        return super().why_not(trip, settings)

    def _coarse(self, trip: Trip) -> tuple[list[CoarseMove], int]:
        return coarsen_turns(trip.moves.tolist(), trip.episode.agent.turn_degrees, TURN)

    def shown(self, trip: Trip) -> list[int]:
        """Where a word begins, and the end."""
        coarse, _ = self._coarse(trip)
        return [*(step.pose for step in coarse), trip.frames - 1]

    def answers(self, trip: Trip) -> tuple[list[tuple[int, str]], dict[str, int]]:
        """The next four words at each, filled up with stop."""
        coarse, lost = self._coarse(trip)
        words = [WORD[step.move] for step in coarse] + [WORD[0]] * AHEAD
        answers = [(n + 1, " ".join(words[n : n + AHEAD])) for n in range(len(coarse) + 1)]
        return answers, {"single 15° turns without a word": lost} if lost else {}


def _parts(talk: Talk, folder: Path) -> tuple[int, int]:
    """(episode number, frames) by the name of the video."""
    match = re.fullmatch(rf"{VIDEOS}/(\d{{6,9}})_(\d{{1,6}})\.mp4", talk.video)
    if match is None:
        raise FormatError(f"video {talk.video!r:.80}", file=folder / ANNOTATIONS, field="video")
    return int(match[1]), int(match[2]) + 1


def _sides(talk: Talk, folder: Path) -> tuple[str, str]:
    if [turn.who for turn in talk.conversations] != ["human", "gpt"]:
        raise FormatError(
            f"{talk.id!r:.80} is no question of a human and answer of gpt",
            file=folder / ANNOTATIONS,
            field="conversations",
        )
    return talk.conversations[0].value, talk.conversations[1].value
