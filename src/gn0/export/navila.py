"""NaVILA: question, answer, and the pictures seen so far, one entry per decision.

Answers are in the words its evaluator looks for: "is move forward 25|50|75 cm", "is turn left|right
15|30|45 degree…", or "stop"; equal moves are put together up to three.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import msgspec

from gn0.errors import FormatError
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_typed
from gn0.export.move_words import merge_amounts
from gn0.export.names import Name, load_names, name_of, save_names
from gn0.export.picture_files import encode_jpeg, load_picture, picture_size
from gn0.export.trips import RGB, Frame, Recovered, Trip
from gn0.paper import FORWARD, LEFT, RIGHT
from gn0.storage import safe_join, write_bytes

ANNOTATIONS, FRAMES = "annotations.json", "train"
STEP, TURN = 0.25, 15.0  # the amounts of its evaluator are multiples of these
ANSWER = re.compile(
    r"The next action is (?:move forward (25|50|75) cm|turn (left|right) (15|30|45) degrees|"
    r"(stop))\."
)


class Question(msgspec.Struct):
    """An entry of `annotations.json`."""

    video_id: str
    frames: list[str]
    q: str
    a: str


class ExporterNaVila(OwnPoses):
    """See the module."""

    name = "navila"
    title = "NaVILA question-and-answer data"
    reader = (
        "NaVILA, training: a VLN dataset with `data_path` annotations.json and `image_path` train"
    )
    frame = "no coordinates: pictures and amounts in cm and degrees"

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """Other steps than its amounts are made of."""
        agent = trip.episode.agent
        if abs(agent.forward_step - STEP) > 1e-9 or abs(agent.turn_degrees - TURN) > 1e-9:
            return "steps that its amounts (25, 50, 75 cm; 15, 30, 45°) cannot say"
        return "" if trip.stopped else "it did not end with STOP"

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """The pictures of an episode."""
        folder = job.folder / FRAMES / f"{place.number:06d}"
        preset = job.settings.preset(job.source)
        for number, frame in enumerate(job.source.frames(trip, preset, RGB)):
            assert frame.rgb is not None
            job.shelf.put(
                folder / f"frame_{number:04d}.jpg", encode_jpeg(frame.rgb, job.settings.quality)
            )
        episode = trip.episode
        decisions = merge_amounts(trip.answers, STEP, TURN)
        asked = [d for n, d in enumerate(decisions) if n % job.settings.every == 0 or
                 d is decisions[-1]]  # fmt: skip
        return {
            "number": place.number,
            "gn0": name_of(trip),
            "q": episode.instruction,
            "asked": [[d.pose, d.answer] for d in asked],
            "notes": {"questions": len(asked)},
        }

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """`annotations.json`."""
        entries = []
        for record in records:
            video = f"{record['number']:06d}"
            for pose, answer in record["asked"]:
                frames = [f"{video}/frame_{n:04d}.jpg" for n in range(pose + 1)]
                entries.append(
                    Question(
                        f"{video}-{pose}", frames, record["q"], f"The next action is {answer}."
                    )
                )
        write_bytes(job.folder / ANNOTATIONS, msgspec.json.encode(entries))
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """Whether each answer is one its evaluator reads, and each picture is there."""
        faults = Faults()
        entries: list[Question] = []
        with faults.guard():
            entries = load_typed(folder / ANNOTATIONS, list[Question])
        faults.expect(
            len({e.video_id for e in entries}) == len(entries),
            f"{ANNOTATIONS}: a video_id appears twice",
        )
        known: dict[str, tuple[int, int]] = {}
        for entry in entries:
            where = f"{ANNOTATIONS}, {entry.video_id!r}"
            faults.expect(ANSWER.fullmatch(entry.a) is not None, f"{where}: answer {entry.a!r}")
            faults.expect(bool(entry.q.strip()), f"{where}: the question is empty")
            faults.expect(bool(entry.frames), f"{where}: no frames")
            for name in entry.frames:
                if name not in known:
                    with faults.guard():
                        known[name] = picture_size(safe_join(folder / FRAMES, name))
        faults.expect(len(set(known.values())) <= 1, "pictures of several sizes")
        return faults.told()

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back: the moves follow from the answers where every decision was asked."""
        entries = load_typed(folder / ANNOTATIONS, list[Question])
        groups: dict[str, list[Question]] = {}
        for entry in entries:
            if not entry.frames:
                raise FormatError("no frames", file=folder / ANNOTATIONS, field="frames")
            groups.setdefault(entry.frames[0].split("/")[0], []).append(entry)
        names = load_names(folder, len(groups))
        return [
            _recover(video, group, name, folder)
            for (video, group), name in zip(groups.items(), names, strict=True)
        ]


def _recover(video: str, group: list[Question], name: Name, folder: Path) -> Recovered:
    labels = [(len(entry.frames) - 1, entry.a) for entry in group]
    moves: list[int] | None = []
    for (begin, answer), (end, _) in pairwise(labels):
        found = ANSWER.fullmatch(answer)
        if found is None:
            raise FormatError(f"answer {answer!r}", file=folder / ANNOTATIONS, field="a")
        forward, side, angle, _ = found.groups()
        move = FORWARD if forward else {"left": LEFT, "right": RIGHT}.get(side)
        count = round(int(forward or angle or 0) / (100 * STEP if forward else TURN))
        if move is None or end - begin != count:  # not every decision was asked
            moves = None
            break
        assert moves is not None
        moves += [move] * count
    at = safe_join(folder / FRAMES, video)
    return Recovered(
        id=name.id,
        scene=name.scene,
        instruction=group[0].q,
        frames=len(group[-1].frames),
        moves=None if moves is None else tuple(moves),
        labels=tuple(labels),
        picture=lambda pose: Frame(load_picture(at / f"frame_{pose:04d}.jpg"), None),
    )
