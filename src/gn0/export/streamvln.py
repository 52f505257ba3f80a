"""StreamVLN: `annotations.json` and a folder of numbered JPEGs for each episode.

`actions` begins with −1 for the first picture and names, for each further picture, the action that
led to it; the STOP at the end is left to the loader, so there are as many actions as pictures. The
loader skips an episode with more than 498 actions and ignores one with fewer than four.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from gn0.errors import FormatError
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_typed
from gn0.export.names import Name, load_names, name_of, save_names
from gn0.export.picture_files import encode_jpeg, load_picture, picture_size
from gn0.export.trips import RGB, Frame, Recovered, Trip
from gn0.storage import safe_join, write_bytes

ANNOTATIONS = "annotations.json"
MOST_ACTIONS, FEWEST_ACTIONS = 498, 4
BEGIN = -1
STEP, TURN = 0.25, 15.0  # m, degrees: its question says so


class Annotation(msgspec.Struct):
    """An entry of `annotations.json`."""

    id: int
    video: str
    instructions: list[str]
    actions: list[int]


class ExporterStreamVln(OwnPoses):
    """See the module."""

    name = "streamvln"
    title = "StreamVLN trajectory data"
    reader = "StreamVLN, training: its VLN action dataset, `video_folder` set to this folder"
    frame = "no coordinates: pictures and actions (0.25 m forward, 15° turns)"

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """Its loader's own limits, and an agent of other steps."""
        agent = trip.episode.agent
        if abs(agent.forward_step - STEP) > 1e-9 or abs(agent.turn_degrees - TURN) > 1e-6:
            return "steps other than the 25 cm and 15° that its question names"
        if not trip.stopped:
            return "it did not end with STOP"
        if trip.frames > MOST_ACTIONS:
            return f"more than {MOST_ACTIONS} actions: the loader skips it"
        if trip.frames < FEWEST_ACTIONS:
            return f"fewer than {FEWEST_ACTIONS} actions: the loader ignores it"
        return ""

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """The pictures of an episode."""
        episode = trip.episode
        video = f"images/{episode.scene_id}_{job.settings.name}_{place.number:06d}"
        folder = safe_join(job.folder, video)
        preset = job.settings.preset(job.source)
        for number, frame in enumerate(job.source.frames(trip, preset, RGB), 1):
            assert frame.rgb is not None
            job.shelf.put(
                folder / "rgb" / f"{number:03d}.jpg", encode_jpeg(frame.rgb, job.settings.quality)
            )
        return {
            "id": place.number,
            "video": video,
            "instructions": [episode.instruction],
            "actions": [BEGIN, *map(int, trip.moves)],
            "gn0": name_of(trip),
        }

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """`annotations.json`, and whose episodes they are."""
        keys = Annotation.__struct_fields__
        entries = [{key: record[key] for key in keys} for record in records]
        write_bytes(job.folder / ANNOTATIONS, msgspec.json.encode(entries))
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """Whether the loader takes every entry as it is meant."""
        faults = Faults()
        entries: list[Annotation] = []
        with faults.guard():
            entries = load_typed(folder / ANNOTATIONS, list[Annotation])
        faults.expect(
            len({e.id for e in entries}) == len(entries), f"{ANNOTATIONS}: an id appears twice"
        )
        for entry in entries:
            with faults.guard():
                _check(entry, folder, faults)
        return faults.told()

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back."""
        entries = load_typed(folder / ANNOTATIONS, list[Annotation])
        names = load_names(folder, len(entries))
        return [_recover(e, name, folder) for e, name in zip(entries, names, strict=True)]


def _check(entry: Annotation, folder: Path, faults: Faults) -> None:
    where = f"{ANNOTATIONS}, id {entry.id}"
    actions = entry.actions
    faults.expect(actions[:1] == [BEGIN], f"{where}: actions do not begin with -1")
    faults.expect(
        all(a in (1, 2, 3) for a in actions[1:]),
        f"{where}: actions after the first are not all 1, 2 or 3 (a STOP at the end is the "
        "loader's)",
    )
    faults.expect(
        FEWEST_ACTIONS <= len(actions) <= MOST_ACTIONS,
        f"{where}: {len(actions)} actions, the loader takes {FEWEST_ACTIONS} to {MOST_ACTIONS}",
    )
    faults.expect(
        bool(entry.instructions) and all(text.strip() for text in entry.instructions),
        f"{where}: an instruction is empty",
    )
    pictures = sorted(p.name for p in (safe_join(folder, entry.video) / "rgb").glob("*"))
    wanted = sorted(f"{number:03d}.jpg" for number in range(1, len(actions) + 1))
    if faults.expect(
        pictures == wanted,
        f"{where}: {len(pictures)} pictures in {entry.video}/rgb for {len(actions)} actions",
    ):
        sizes = {picture_size(safe_join(folder, f"{entry.video}/rgb/{n}")) for n in pictures}
        faults.expect(len(sizes) == 1, f"{where}: pictures of several sizes")


def _recover(entry: Annotation, name: Name, folder: Path) -> Recovered:
    rgb = safe_join(folder, entry.video) / "rgb"
    if not entry.instructions:
        raise FormatError("no instruction", file=folder / ANNOTATIONS, field="instructions")
    return Recovered(
        id=name.id,
        scene=name.scene,
        instruction=entry.instructions[0],
        frames=len(list(rgb.glob("*.jpg"))),
        moves=tuple(entry.actions[1:]),
        picture=lambda pose: Frame(load_picture(rgb / f"{pose + 1:03d}.jpg"), None),
    )
