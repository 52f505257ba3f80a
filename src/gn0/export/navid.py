"""NaVid and Uni-NaVid: conversations about the video of everything seen so far.

NaVid answers with one action and its amount, Uni-NaVid with the next four words out of forward,
left, right and stop. Both turn by 30° and step by 0.25 m: NaVid's agent does `int(degrees / 30)`
turns, at most three, and takes a random action where that is none (jzhzhang/NaVid-VLN-CE @cf066cc,
`navid_agent.py` 333 to 353). So walks must be of such a body, or turns are merged, and what is left
over of them is counted. The question is the text that their agents ask; one frame is one second,
as their readers sample it (`video_fps` 1).

Where somebody is followed, "stop" stands still for one action and ends nothing, as Uni-NaVid's
"stop" is a speed of 0 in EVT-Bench (wsakobe/TrackVLA @c69f9d9, `agent_uninavid.py` 352 to 366);
what their VLN-CE agents do at it is to end. A frame is an action there as well, whatever it lasts.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import msgspec

from gn0.errors import DataError, FormatError
from gn0.export.clips import cut_clip, encode_frames, inspect_clip, read_clip
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_typed
from gn0.export.move_words import WORD, CoarseMove, coarsen_turns, fits_turns, merge_amounts
from gn0.export.names import load_names, name_of, save_names
from gn0.export.trips import RGB, Frame, Recovered, Trip
from gn0.geometry import F64
from gn0.paper import FORWARD, LEFT, RIGHT, STOP
from gn0.storage import safe_join, write_bytes

ANNOTATIONS, VIDEOS, ABOUT = "annotations.json", "nav_videos", "gn0_navid.json"
# their loaders know a navigation task by this
MARK = "a video of historical observations and an image of the current observation"
# `<image>` stands inside the text in their agents and is taken to its front, which leaves a space
QUESTION = (
    "<image>\nImagine you are a robot programmed for navigation tasks. You have been given a video "
    "of historical observations and an image of the current observation . Your assigned task is: "
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
FPS = 1
AHEAD = 4
STEP, TURN, MOST = 0.25, 30.0, 3  # m, degrees, moves of one answer
WAITS = 'answer "stop" that stands still for one action: who follows somebody goes on after it'
_TASK = re.compile(r"Your assigned task is: '(.*)'\. Analyze", re.DOTALL)
_AMOUNT = re.compile(
    r"The next action is (?:move (forward) (\d+) cm|turn (left|right) (\d+) degrees|(stop))\."
)
_WORDS = re.compile(r"(forward|left|right|stop)( (forward|left|right|stop)){3}")


class About(msgspec.Struct):
    """What the files have no place for: whether turns were merged."""

    merged: bool = False


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
    program = ""
    asks = ""
    answer = _WORDS
    follows = True

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """Steps that their words cannot say; a walk without an end, which has no last answer."""
        agent = trip.episode.agent
        if abs(agent.turn_degrees - TURN) > 1e-6 and not settings.merge_turns:
            raise DataError(
                f"the walks turn by {agent.turn_degrees:g}°, {self.program} by {TURN:g}°: its "
                "agent would take other actions than these",
                where=f"episode {trip.episode.id!r}",
                remedy=f"walk again: `gn0 missions generate SCENE --agent {self.name} --out "
                "MISSIONS` and `gn0 data build MISSIONS --out DATA`; or give --merge-turns, which "
                "drops and counts what is left over of a turn",
            )
        if not fits_turns(trip, TURN):
            return "turns of which 30° cannot be made"
        if abs(agent.forward_step - STEP) > 1e-9:
            return "steps other than 0.25 m"
        if trip.follows:
            return "" if coarse_moves(trip)[0] else "nothing but turns that are left over of 30°"
        return "" if trip.stopped else "it did not end with STOP"

    def poses(self, trip: Trip, settings: ExportSettings) -> F64:
        """Those of the longest clip."""
        return trip.poses[self.shown(trip)]

    def shown(self, trip: Trip) -> list[int]:
        """Where a move of theirs begins, up to the last that is asked: what their agents see."""
        coarse, _ = coarse_moves(trip)
        seen = self.answers([step.move for step in coarse])[-1][0]
        return [step.pose for step in coarse[:seen]]

    @abstractmethod
    def answers(self, actions: Sequence[int]) -> list[tuple[int, str]]:
        """(frames shown, answer) of each decision, of what is done at each frame."""

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """The clips of an episode: one a question."""
        settings, episode = job.settings, trip.episode
        coarse, lost = coarse_moves(trip)
        shown = set(self.shown(trip))
        answers = self.answers([step.move for step in coarse])
        last = len(answers) - 1
        asked = [a for n, a in enumerate(answers) if n % settings.every == 0 or n == last]
        seen = job.source.frames(trip, settings.preset(job.source), RGB)
        clip = encode_frames(
            (f.rgb for n, f in enumerate(seen) if n in shown and f.rgb is not None),
            FPS,
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
        notes = {"questions": len(asked)}
        if lost:
            notes[f"single {episode.agent.turn_degrees:g}° turns without a word"] = lost
        if trip.follows and (waits := trip.answers.count(STOP)):
            notes[WAITS] = waits
        merged = len(coarse) != trip.frames
        return {"gn0": name_of(trip), "talks": talks, "notes": notes, "merged": merged}

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """`annotations.json`."""
        talks = [msgspec.convert(talk, Talk) for record in records for talk in record["talks"]]
        write_bytes(job.folder / ANNOTATIONS, msgspec.json.encode(talks))
        about = About(merged=any(record["merged"] for record in records))
        write_bytes(job.folder / ABOUT, msgspec.json.encode(about) + b"\n")
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """The rules of their loaders and agents: question, answer, clip, rate, sizes."""
        faults = Faults()
        talks: list[Talk] = []
        with faults.guard():
            talks = load_typed(folder / ANNOTATIONS, list[Talk])
        faults.expect(len({t.id for t in talks}) == len(talks), "an id appears twice")
        sizes = set()
        for talk in talks:
            where = f"{ANNOTATIONS}, {talk.id!r}"
            with faults.guard():
                _, frames = _parts(talk, folder)
                question, answer = _sides(talk, folder)
                faults.expect("NAV_ID" in talk.id, f"{where}: the id lacks NAV_ID")
                faults.expect(MARK in question, f"{where}: the question lacks {MARK!r}")
                faults.expect(
                    question.count("<image>") == 1, f"{where}: the question has not one <image>"
                )
                wrong = self.misread(answer)
                faults.expect(not wrong, f"{where}: answer {answer!r:.80}: {wrong}")
                facts = inspect_clip(safe_join(folder, talk.video))
                faults.expect(
                    facts.frames == frames,
                    f"{where}: {facts.frames} frames in {talk.video}, {frames} were seen",
                )
                faults.expect(
                    abs(facts.fps - FPS) < 0.5,
                    f"{where}: {facts.fps:g} frames a second; of its scripts' video_fps 1 follows "
                    f"that one in {max(round(facts.fps), 1)} is seen",
                )
                sizes.add((facts.width, facts.height))
        faults.expect(len(sizes) <= 1, "videos of several sizes")
        return faults.told()

    def misread(self, answer: str) -> str:
        """What their agent would make of an answer, where it is not what the answer says."""
        return "" if self.answer.fullmatch(answer) else "not in its words"

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back."""
        groups: dict[int, list[Talk]] = {}
        for talk in load_typed(folder / ANNOTATIONS, list[Talk]):
            groups.setdefault(_parts(talk, folder)[0], []).append(talk)
        names = load_names(folder, len(groups))
        merged = load_typed(folder / ABOUT, About).merged
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
                    moves=None if merged else self.moves(labels),
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
    program = "NaVid"
    title = "NaVid conversations (one action with its amount)"
    reader = "NaVid: its LLaMA-VID style supervised data, `video_folder` set to this folder"
    frame = "no coordinates: pictures and amounts in cm (of 25) and degrees (of 30)"
    asks = NAVID_ASKS
    answer = _AMOUNT

    def answers(self, actions: Sequence[int]) -> list[tuple[int, str]]:
        """Moves put together, up to three."""
        found = merge_amounts(actions, STEP, TURN, MOST)
        return [(d.pose + 1, f"The next action is {d.answer}.") for d in found]

    def misread(self, answer: str) -> str:
        """See `_Conversations.misread`."""
        match = _AMOUNT.fullmatch(answer)
        if match is None:
            return "not in its words"
        if match[5]:
            return ""
        amount, unit = (int(match[2]), 25) if match[1] else (int(match[4]), 30)
        done = min(MOST, amount // unit)
        if not done:
            return "no whole step, so its agent takes a random action"
        return "" if done * unit == amount else f"its agent does {done * unit}"

    def moves(self, labels: Sequence[tuple[int, str]]) -> tuple[int, ...] | None:
        """What the answers say; None where some were not asked."""
        found: list[int] = []
        for (begin, answer), (end, _) in pairwise(labels):
            match = _AMOUNT.fullmatch(answer)
            if match is None:
                return None
            if match[5]:  # it stands still, as who follows somebody may
                if end - begin != 1:
                    return None
                found.append(STOP)
                continue
            move = FORWARD if match[1] else {"left": LEFT, "right": RIGHT}[match[3]]
            amount = int(match[2]) / 25 if match[1] else int(match[4]) / 30
            if abs(amount - (end - begin)) > 1e-6:
                return None
            found += [move] * (end - begin)
        last = _AMOUNT.fullmatch(labels[-1][1])
        if last is not None and not last[5]:  # of its moves the last leads to no further frame
            move = FORWARD if last[1] else {"left": LEFT, "right": RIGHT}[last[3]]
            amount = int(last[2]) / 25 if last[1] else int(last[4]) / 30
            found += [move] * (round(amount) - 1)
        return tuple(found)


class ExporterUniNaVid(_Conversations):
    """Uni-NaVid; see the module."""

    name = "uninavid"
    program = "Uni-NaVid"
    title = "Uni-NaVid conversations (the next four actions)"
    reader = "Uni-NaVid, finetuning: `data_path` annotations.json, `video_folder` this folder"
    frame = "no coordinates: pictures and words (forward 0.25 m, left and right 30°)"
    asks = UNINAVID_ASKS

    def answers(self, actions: Sequence[int]) -> list[tuple[int, str]]:
        """The next four words at each, filled up with stop."""
        words = [WORD[action] for action in actions] + [WORD[STOP]] * AHEAD
        return [(n + 1, " ".join(words[n : n + AHEAD])) for n in range(len(actions))]


def coarse_moves(trip: Trip) -> tuple[list[CoarseMove], int]:
    """What is done at each pose, in turns of 30°, and how many finer turns are left over."""
    return coarsen_turns(trip.answers, trip.episode.agent.turn_degrees, TURN)


def _parts(talk: Talk, folder: Path) -> tuple[int, int]:
    """(episode number, frames) by the name of the video."""
    match = re.fullmatch(rf"{VIDEOS}/(\d{{6,9}})_(\d{{1,6}})\.mp4", talk.video)
    if match is None:
        raise FormatError(f"video {talk.video!r:.80}", file=folder / ANNOTATIONS, field="video")
    return int(match[1]), int(match[2]) + 1


def _sides(talk: Talk, folder: Path) -> tuple[str, str]:
    if [turn.who for turn in talk.conversations] != ["human", "gpt"]:
        raise FormatError(
            f"{talk.id!r:.80} is not a question by human and an answer by gpt",
            file=folder / ANNOTATIONS,
            field="conversations",
        )
    return talk.conversations[0].value, talk.conversations[1].value
