"""VLN-CE: `{split}/{split}.json.gz` with its ground truth, in the style of R2R or of RxR.

Positions are in Habitat's y-up frame with the floor at 0. R2R style has the tokens of every
instruction, padded to 200, and one vocabulary for all splits: R2R's own where the user points to a
file that has it, else ours, which R2R's models misread. RxR style has languages and annotators, and
lacks the text features that its models read. Missions of one path share a `trajectory_id`;
`reference_path` has nodes as far apart as R2R's. Ground truth: every place a FORWARD led to (turns
repeat none), and the actions with the STOP at the end. The loader refuses keys it does not know, so
our ids are kept beside the files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gn0.errors import FormatError, Gn0Error
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_typed
from gn0.export.names import load_names, name_of, save_names
from gn0.export.nodes import thin_path
from gn0.export.schema import Shape, describe_shape, shape_differences
from gn0.export.trips import Recovered, Trip
from gn0.geometry import F64
from gn0.missions.coordinate_frames import habitat_rotation, habitat_to_world, world_to_habitat
from gn0.missions.episode import Episode
from gn0.missions.sets.episode_set import EpisodeSet, Task
from gn0.missions.sets.json_file import load_exact, save_exact
from gn0.missions.sets.lost_goals import find_lost
from gn0.missions.sets.vlnce import TOKENS, ExporterVlnce, VlnceFile
from gn0.missions.sets.vocabulary import (
    R2R_COUNT,
    are_r2r_words,
    count_unknown,
    cut_words,
    load_r2r_words,
    tell_unknown,
)
from gn0.paper import FORWARD, LEFT, RIGHT, STOP
from gn0.sim.kinematics import heading_yaw
from gn0.storage import safe_join, write_bytes

ABOUT = "gn0_vlnce.json"
MAPS = ("word2idx_dict", "stoi", "truth")
_PLACE: Shape = ["float"]
_RECORD: Shape = {
    "episode_id": "int",
    "trajectory_id": "int",
    "scene_id": "str",
    "start_position": _PLACE,
    "start_rotation": ["float|int"],
    "info": {"geodesic_distance": "float"},
    "goals": [{"position": _PLACE, "radius": "float"}],
    "instruction": {"instruction_text": "str", "instruction_tokens": ["int"]},
    "reference_path": [_PLACE],
}
R2R_SHAPE: Shape = {
    "episodes": [_RECORD],
    "instruction_vocab": {
        "word_list": ["str"],
        "word2idx_dict": {"*": "int"},
        "stoi": {"*": "int"},
        "itos": ["str"],
        "num_vocab": "int",
        "UNK_INDEX": "int",
        "PAD_INDEX": "int",
    },
}
RXR_SHAPE: Shape = {
    "episodes": [
        {
            **_RECORD,
            "instruction": {
                "instruction_id": "str",
                "instruction_text": "str",
                "language": "str",
                "annotator_id": "str",
                "edit_distance": "float",
                "timed_instruction": [None],
            },
        }
    ]
}
TRUTH_SHAPE: Shape = {"*": {"locations": [_PLACE], "forward_steps": "int", "actions": ["int"]}}
LANGUAGE, ANNOTATOR = "en-US", "gn0"
RXR_TURN = 30.0  # degrees
OTHER_TURNS = "ground truth in turns other than the 30° of RxR's agent"
UNKNOWN_WORDS = "word that R2R's vocabulary lacks, read as <unk>"
CUT = f"instruction cut at {TOKENS} tokens"
MISREAD = (
    "the models of VLN-CE and InternNav will misread the instructions: they look tokens up in "
    f"R2R's table of {R2R_COUNT:,} words, and these are of another list of {{count:,}}. Export "
    "again with --vocabulary and any file of R2R, or train with use_pretrained_embeddings False "
    "and vocab_size {count}"
)
NO_FEATURES = (
    "RxR's models read text features that are not here: text_features/rxr_{split}/"
    "{id:06}_en_text_features.npz, `features` float32 [subwords, at most 512][768] of the last "
    "layer of multilingual cased BERT. docs/export.md has the lines that make them"
)


class About(msgspec.Struct):
    """What the files have no place for: turn of an action [degrees], styles, splits, odd words.

    Attributes:
        turn_degrees: turn of an action.
        splits: their names.
        role: role of RxR's files; "" for R2R's.
        unknown: words that the vocabulary lacks, and how often they come.
    """

    turn_degrees: float
    splits: list[str]
    role: str = ""
    unknown: dict[str, int] = {}


def read_words(settings: ExportSettings) -> tuple[str, ...]:
    """R2R's words from the file that the settings name; () where they name none.

    Raises:
        StorageError, FormatError: see `load_r2r_words`.
    """
    return load_r2r_words(settings.vocabulary) if settings.vocabulary else ()


def remember(trip: Trip, settings: ExportSettings, tokens: bool = True) -> Record:
    """What a record keeps of a trip for VLN-CE files; counts what `tokens` lose."""
    words = cut_words(trip.episode.instruction) if tokens else []
    known = frozenset(read_words(settings)) if tokens else frozenset()
    unknown = sum(word not in known for word in words) if known else 0
    notes = {UNKNOWN_WORDS: unknown, CUT: int(len(words) > TOKENS)}
    notes |= find_lost(trip.episode, several=True)
    locations, actions = ground_truth(trip)
    return {
        "episode": msgspec.to_builtins(trip.episode),
        "locations": locations,
        "actions": actions,
        "gn0": name_of(trip),
        "notes": {what: count for what, count in notes.items() if count},
    }


def ground_truth(trip: Trip) -> tuple[list[list[float]], list[int]]:
    """The places [m] that each FORWARD led to, the start before them, and the actions.

    Who follows somebody stands still now and then: that is left out, as a STOP ends an episode
    there, and one stands at the end.
    """
    if not trip.follows:
        kept = np.r_[True, trip.moves == FORWARD]
        return trip.poses[kept, :2].tolist(), trip.actions
    done = np.array(trip.answers)
    ends = np.vstack([trip.poses[1:, :2], trip.episode.path[-1:] or trip.poses[-1:, :2]])
    moves = [int(code) for code in done if code != STOP]
    return [trip.poses[0, :2].tolist(), *ends[done == FORWARD].tolist()], [*moves, STOP]


class ExporterVlnceR2R(OwnPoses):
    """VLN-CE in the style of R2R; see the module."""

    name = "vlnce-r2r"
    title = "VLN-CE episodes and ground truth, R2R style"
    reader = (
        "VLN-CE and its descendants: dataset type VLN-CE-v1, `DATA_PATH` {split}/{split}.json.gz"
    )
    frame = "Habitat: x right, y up, z back [m], floor at y = 0; rotations (x, y, z, w)"
    follows = True
    pictures = False
    has_splits = True
    role = ""

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """Ground truth ends with STOP; their encoder takes no instruction without words."""
        if not cut_words(trip.episode.instruction):
            return "an instruction without words"
        return "" if trip.stopped or trip.follows else "it did not end with STOP"

    def reads(self, settings: ExportSettings) -> str:
        """R2R's vocabulary."""
        return "R2R" if read_words(settings) else ""

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """Nothing yet: the files hold all episodes of a split."""
        return remember(trip, job.settings)

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """All files."""
        write_splits(records, job, job.folder, self.role)
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """Shape, tokens, vocabulary and ground truth, as the loader and its metrics use them."""
        faults = Faults()
        check_splits(folder, faults)
        return faults.told()

    def remarks(self, folder: Path) -> list[str]:
        """What their models would misread, or lack."""
        return remark_splits(folder)

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back, poses from the ground truth."""
        about = load_typed(folder / ABOUT, About)
        found: list[tuple[int, Recovered]] = []
        for split in about.splits:
            episodes = _load_split(folder, split, about.role)
            for number, task in enumerate(episodes.tasks):
                if not task.id.isdecimal():
                    raise FormatError(f"episode_id {task.id!r:.40}", file=folder / split)
                found.append((int(task.id), _recover(episodes, number, about, folder)))
        found.sort(key=lambda pair: pair[0])
        names = load_names(folder, len(found))
        return [recovered.named(name.id) for name, (_, recovered) in zip(names, found, strict=True)]


class ExporterVlnceRxR(ExporterVlnceR2R):
    """VLN-CE in the style of RxR; see the module."""

    name = "vlnce-rxr"
    title = "VLN-CE episodes and ground truth, RxR style"
    reader = (
        "VLN-CE: dataset type RxR-VLN-CE-v1, `DATA_PATH` {split}/{split}_{role}.json.gz, role "
        "guide, language en-US"
    )
    role = "guide"

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """As in R2R style; turns other than RxR's are counted."""
        other = abs(trip.episode.agent.turn_degrees - RXR_TURN) > 1e-9
        remembered = remember(trip, job.settings, tokens=False)
        return {**remembered, "notes": remembered["notes"] | ({OTHER_TURNS: 1} if other else {})}

    def reads(self, settings: ExportSettings) -> str:
        """Nothing: there are no tokens."""
        return ""


def instruction_tokens(
    episodes: Sequence[Mapping[str, Any]], words: Sequence[str] = ()
) -> list[list[int]]:
    """Tokens of each episode's instruction, padded to 200; by their own words if none are given."""
    built = _build([msgspec.convert(e, Episode) for e in episodes], words)
    return [r["instruction"]["instruction_tokens"] for r in built.native.document["episodes"]]


def _build(episodes: Sequence[Episode], words: Sequence[str] = ()) -> EpisodeSet:
    return ExporterVlnce().build(episodes, {}, "gn0", words)


def _lift(places: F64) -> list[list[float]]:
    """Places [N, 2] of the floor in Habitat's frame."""
    flat = np.column_stack([places, np.zeros(len(places))])
    return [[float(v) for v in place] for place in world_to_habitat(flat) + 0.0]


def write_splits(
    records: Sequence[Record], job: Job, folder: Path, role: str = "", first_trajectory: int = 1
) -> None:
    """Write the files of every split, and what they have no place for.

    Raises:
        StorageError: a file cannot be written.
    """
    episodes = [msgspec.convert(record["episode"], Episode) for record in records]
    words = () if role else read_words(job.settings)
    built = _build(episodes, words)
    document, truth = built.native.document, {}
    paths: dict[tuple[str, str], int] = {}
    for number, (entry, episode, record) in enumerate(
        zip(document["episodes"], episodes, records, strict=True), 1
    ):
        way = (episode.scene_id, episode.path_id or f"\0{episode.id}")
        entry["trajectory_id"] = paths.setdefault(way, len(paths) + first_trajectory)
        _, sine, _, cosine = habitat_rotation(episode.start[2])
        entry["start_rotation"] = [0, sine, 0, cosine]  # as the real files have it
        entry["reference_path"] = _lift(
            thin_path(np.array(episode.path, np.float64).reshape(-1, 2))
        )
        if role:
            entry["instruction"] = {
                "instruction_id": str(number),
                "instruction_text": episode.instruction,
                "language": LANGUAGE,
                "annotator_id": ANNOTATOR,
                "edit_distance": 0.0,
                "timed_instruction": [],
            }
        truth[str(number)] = {
            "locations": _lift(np.array(record["locations"], np.float64).reshape(-1, 2)),
            "forward_steps": record["actions"].count(FORWARD),
            "actions": record["actions"],
        }
    if role:
        del document["instruction_vocab"]
    splits = list(dict.fromkeys(episode.split for episode in episodes))
    for split in splits:
        rows = [n for n, episode in enumerate(episodes) if episode.split == split]
        part: VlnceFile = ExporterVlnce().take(VlnceFile(document, truth), rows)
        path = split_path(folder, split, role)
        save_exact(path, part.document)
        save_exact(path.with_name(path.name.replace(".json.gz", "_gt.json.gz")), part.truth)
    odd = count_unknown((e.instruction for e in episodes), words) if words else {}
    about = About(episodes[0].agent.turn_degrees, splits, role, odd)
    write_bytes(folder / ABOUT, msgspec.json.encode(about) + b"\n")


def split_path(folder: Path, split: str, role: str = "") -> Path:
    """The file of a split."""
    return safe_join(folder, f"{split}/{split}{f'_{role}' if role else ''}.json.gz")


def _load_split(folder: Path, split: str, role: str) -> EpisodeSet:
    return ExporterVlnce().load(split_path(folder, split, role))


def remark_splits(folder: Path) -> list[str]:
    """What models would misread in the files of all splits, or lack; never raises."""
    try:
        about = load_typed(folder / ABOUT, About)
        if about.role:
            return [NO_FEATURES]
        document = load_exact(split_path(folder, about.splits[0]))
        words = document["instruction_vocab"]["word_list"]
        if not are_r2r_words(words):
            return [MISREAD.format(count=len(words))]
    except (Gn0Error, LookupError, TypeError, AttributeError):
        return []  # the check tells what is wrong
    return [tell_unknown(about.unknown)] if about.unknown else []


def check_splits(folder: Path, faults: Faults) -> None:
    """Note what is wrong with the files of all splits."""
    with faults.guard():
        about = load_typed(folder / ABOUT, About)
        faults.expect(bool(about.splits), f"{folder / ABOUT}: no splits")
        vocabularies = set()
        for split in about.splits:
            with faults.guard():
                vocabularies.add(_check_split(split_path(folder, split, about.role), about, faults))
        faults.expect(
            len(vocabularies - {""}) <= 1 or bool(faults.found),
            f"{folder}: splits with different vocabularies",
        )


def _check_split(path: Path, about: About, faults: Faults) -> str:
    ExporterVlnce().load(path)
    document = load_exact(path)
    wanted = RXR_SHAPE if about.role else R2R_SHAPE
    for wrong in shape_differences(describe_shape(document, MAPS), wanted):
        faults.add(f"{path}: {wrong.lstrip('.')}")
    truth_file = path.with_name(path.name.replace(".json.gz", "_gt.json.gz"))
    truth = load_exact(truth_file)
    for wrong in shape_differences(describe_shape({"truth": truth}, MAPS)["truth"], TRUTH_SHAPE):
        faults.add(f"{truth_file}: {wrong.lstrip('.')}")
    if faults.found:
        return ""
    words: dict[str, Any] = document.get("instruction_vocab", {"word_list": []})
    size = len(words["word_list"])
    if not about.role:
        index = {word: number for number, word in enumerate(words["word_list"])}
        faults.expect(
            words["itos"] == words["word_list"] and words["num_vocab"] == size
            and words["stoi"] == words["word2idx_dict"] == index
            and 0 <= words["PAD_INDEX"] < size and 0 <= words["UNK_INDEX"] < size,
            f"{path}: the lists of instruction_vocab do not agree",
        )  # fmt: skip
    for entry in document["episodes"]:
        _check_entry(path, entry, truth, size, about, faults)
    return "\n".join(words["word_list"])


def _check_entry(
    path: Path, entry: Any, truth: Any, words: int, about: About, faults: Faults
) -> None:
    where = f"{path}, episode {entry['episode_id']}"
    if not about.role:
        tokens = entry["instruction"]["instruction_tokens"]
        text = [token for token in tokens if token]
        faults.expect(
            len(tokens) == TOKENS and text == tokens[: len(text)] and bool(text)
            and all(0 < token < words for token in text),
            f"{where}: instruction_tokens are not words and then zeros, {TOKENS} in all",
        )  # fmt: skip
    gt = truth.get(str(entry["episode_id"]))
    if not faults.expect(gt is not None, f"{where}: no ground truth"):
        return
    actions, places = gt["actions"], gt["locations"]
    faults.expect(
        actions[-1:] == [0] and all(a in (1, 2, 3) for a in actions[:-1]),
        f"{where}: ground-truth actions are not 1, 2, 3 with a STOP at the end",
    )
    faults.expect(
        gt["forward_steps"] == actions.count(FORWARD) == len(places) - 1,
        f"{where}: {len(places)} locations for {actions.count(FORWARD)} forward actions",
    )
    faults.expect(
        bool(places) and np.allclose(places[0], entry["start_position"], rtol=0, atol=1e-6),
        f"{where}: the ground truth does not begin at the start",
    )


def _recover(episodes: EpisodeSet, number: int, about: About, folder: Path) -> Recovered:
    task: Task = episodes.tasks[number]
    truth = (episodes.native.truth or {}).get(task.id)
    if truth is None or task.goal is None:
        raise FormatError(f"episode {task.id} has no ground truth or no goal", file=folder)
    moves = [int(a) for a in truth["actions"] if a != 0]
    places = habitat_to_world(truth["locations"])[:, :2]
    ahead = np.r_[0, np.cumsum([move == FORWARD for move in moves], dtype=np.int64)]
    turns = np.r_[0, np.cumsum([{LEFT: 1, RIGHT: -1}.get(m, 0) for m in moves], dtype=np.int64)]
    if len(places) != ahead[-1] + 1:
        raise FormatError(f"episode {task.id}: locations do not fit its actions", file=folder)
    yaws = [heading_yaw(task.start[2], int(t), about.turn_degrees) for t in turns]
    return Recovered(
        id=task.id,
        scene=task.scene,
        instruction=task.instruction,
        moves=tuple(moves),
        poses=np.column_stack([places[ahead], yaws]),
        start=np.array([task.start]),
        goal=np.array([[*task.goal, 0.0]]),
    )
