"""A folder of walks: `walks.jsonl`, a line an episode, and `walks.json`, which says of what.

Walks are gathered in a journal, chunk by chunk, so whoever was stopped goes on; the two files are
there once all are.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gn0.config import Config, decode_json, load_json
from gn0.errors import TrainingError
from gn0.locked_folder import check_room, forget_folder, holds_leftovers_only, lock_folder
from gn0.missions.controls import Control
from gn0.policies.bae.waypoint_plan import Carried
from gn0.storage import (
    Journal,
    check_contained,
    plain_path,
    read_bytes,
    safe_join,
    write_bytes,
    write_json,
)
from gn0.training.exams.walks import Walk

WALKS, ABOUT, JOURNAL = "walks.jsonl", "walks.json", "walks.journal"
LIMIT = 2 * 2**30  # bytes of walks that are read
_FREE = ("checkpoint", "device", "version", "finished", "digest", "seconds")
_ROOM = 64 << 20  # bytes


class WalksAbout(Config, frozen=True):
    """`walks.json`: of what, by what and how.

    Attributes:
        suite: name of the suite; suite_hash is its digest.
        splits: of the suite; all when empty.
        episodes: how many were asked for; episodes_hash is the digest of their ids.
        left_out: episodes whose text was too long for the policy.
        checkpoint: folder of the policy; weights is the digest of what answers hang on.
        control: what was taken away.
        inputs: in which of its ways the policy was asked; "" for its default.
        executed: actions of an answer that were carried out.
        draw_after: actions without getting anywhere after which answers were drawn; 0: never.
        confirm_stop: a STOP behind the first action was asked again.
        carried: the actions of answers, or their waypoints.
        agents: that walked side by side, all asked in one batch.
        dtype: of what was computed.
        device: where.
        version: of gn0.
        finished: all episodes were walked.
        digest: SHA-256 of `walks.jsonl`.
        seconds: of walking.
    """

    suite: str
    suite_hash: str
    splits: tuple[str, ...]
    episodes: int
    episodes_hash: str
    left_out: int
    checkpoint: str
    weights: str
    control: Control
    executed: int
    confirm_stop: bool
    agents: int
    dtype: str
    device: str
    version: str
    inputs: str = ""
    carried: Carried = "actions"
    draw_after: int = 0
    finished: bool = False
    digest: str = ""
    seconds: float = 0.0


class WalksFolder:
    """The folder of walks that are being made; see `open_walks`.

    Attributes:
        folder: where it lies.
        about: of what.
        walks: those that there are, as they came to an end; in order of the suite once finished.
    """

    def __init__(self, folder: Path, about: WalksAbout, walks: list[Walk]) -> None:
        self.folder, self.about, self.walks = folder, about, walks
        self._journal = Journal(folder / JOURNAL)

    def add(self, walks: Sequence[Walk]) -> None:
        """Add some; they are on the disk when this returns.

        Raises:
            StorageError: the disk is full or refuses.
        """
        self._journal.append({"walks": msgspec.to_builtins(list(walks))})
        self.walks += walks

    def finish(self, episodes: Sequence[str]) -> None:
        """Write the two files; the journal goes.

        Args:
            episodes: their ids, in the order in which walks are written.

        Raises:
            StorageError: the disk is full or refuses.
        """
        self._journal.close()
        own = {walk.episode: walk for walk in self.walks}
        self.walks = [own[one] for one in episodes]
        data = b"".join(msgspec.json.encode(walk, order="sorted") + b"\n" for walk in self.walks)
        self.about = msgspec.structs.replace(
            self.about,
            finished=True,
            digest=hashlib.sha256(data).hexdigest(),
            seconds=round(sum(walk.seconds for walk in self.walks), 3),
        )
        write_bytes(self.folder / WALKS, data)
        write_json(self.folder / ABOUT, msgspec.to_builtins(self.about))
        (self.folder / JOURNAL).unlink(missing_ok=True)

    def close(self) -> None:
        """Close the journal."""
        self._journal.close()


@contextlib.contextmanager
def open_walks(
    folder: Path | str, about: WalksAbout, *, fresh: bool = False
) -> Iterator[WalksFolder]:
    """Begin walks in a folder, or go on with those that are there; alone, until the block ends.

    Args:
        folder: made where it is not there.
        about: of what; a folder of others is refused.
        fresh: forget what is there.

    Raises:
        TrainingError: somebody else writes there, or it holds other walks, or something else.
        StorageError, FormatError: the system refuses, or a file is damaged.
    """
    folder = plain_path(folder)
    check_room(folder, _ROOM)
    if fresh:
        forget_folder(folder, ABOUT)
    with lock_folder(folder, refuse=TrainingError, writer="examination"):
        before = _read_about(folder)
        walks: list[Walk] = []
        if before is not None:
            _check_same(folder, before, about)
            about = msgspec.structs.replace(
                about, finished=before.finished, digest=before.digest, seconds=before.seconds
            )
            walks = load_walks(folder)[1] if before.finished else _read_journal(folder)
        write_json(folder / ABOUT, msgspec.to_builtins(about))
        own = WalksFolder(folder, about, walks)
        try:
            yield own
        finally:
            own.close()


def load_walks(folder: Path | str) -> tuple[WalksAbout, list[Walk]]:
    """What a folder of finished walks holds.

    Raises:
        TrainingError: it holds none, they are not finished, or they are not those that were made.
        StorageError, FormatError: it cannot be read, or is damaged.
    """
    check_contained(folder)
    place = safe_join(folder, ABOUT)
    if not place.is_file():
        raise TrainingError(
            f"no walks: there is no {ABOUT}",
            where=folder,
            remedy="give a folder that `gn0 policy examine` wrote",
        )
    about = load_json(place, WalksAbout)
    if not about.finished:
        raise TrainingError(
            "the walks there are not finished",
            where=folder,
            remedy="give the same `gn0 policy examine` command again; it goes on where it stopped",
        )
    path = safe_join(folder, WALKS)
    data = read_bytes(path, LIMIT)
    if hashlib.sha256(data).hexdigest() != about.digest:
        raise TrainingError(
            f"{WALKS} is not what the examination wrote",
            where=path,
            remedy="examine again with --fresh",
        )
    lines = enumerate(data.splitlines(), 1)
    return about, [decode_json(line, Walk, file=f"{path}, line {n}") for n, line in lines]


def _read_about(folder: Path) -> WalksAbout | None:
    if (folder / ABOUT).is_file():
        return load_json(folder / ABOUT, WalksAbout)
    if not holds_leftovers_only(folder):
        raise TrainingError(
            f"the folder holds something else: it has no {ABOUT}",
            where=folder,
            remedy="choose another --out",
        )
    return None


def _check_same(folder: Path, before: WalksAbout, about: WalksAbout) -> None:
    then, now = (msgspec.to_builtins(one) for one in (before, about))
    other = [
        f"{name} was {_tell(then[name])}, is {_tell(now[name])}"
        for name in now
        if name not in _FREE and then[name] != now[name]
    ]
    if other:
        raise TrainingError(
            f"the folder holds other walks: {'; '.join(other)}",
            where=folder,
            remedy="choose another --out, or pass --fresh to forget them",
        )


def _tell(value: Any) -> str:
    return str(value) if len(str(value)) <= 24 else f"{value!s:.12}…"


def _read_journal(folder: Path) -> list[Walk]:
    return [
        msgspec.convert(one, Walk) for record in Journal(folder / JOURNAL).read()
        for one in record["walks"]
    ]  # fmt: skip
