"""Make a bank of people from a seed, in parallel, going on where an earlier run stopped."""

from __future__ import annotations

import re
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from gn0.avatars.avatar import Avatar
from gn0.avatars.bank import (
    BANK_FILE,
    LAYOUT,
    AvatarBank,
    BankEntry,
    BankList,
    digest_avatar,
    load_avatar,
    save_avatar,
)
from gn0.avatars.identity import Identity, draw_people
from gn0.avatars.person import build_person
from gn0.errors import ConfigError, FormatError, StorageError
from gn0.jobs import ExecutorName, run_jobs
from gn0.locked_folder import lock_folder, read_begun, sweep_folder
from gn0.progress import Progress, no_progress
from gn0.storage import (
    Journal,
    check_contained,
    content_hash,
    plain_path,
    storage_error,
    write_json,
)
from gn0.version import source_version

JOURNAL_FILE = "bank.journal"
# what decides the bytes: half a bank is not gone on with by other code
_DECIDING = ("avatars", "seeds.py", "scenes/rays.py", "scenes/procedural/noise.py")
_NAME = re.compile(r"[\w-]{1,60}")
_BUILD = "gn0.avatars.bank_build:build_bank_avatar"


def generate_bank(
    out: Path | str,
    *,
    count: int = 20,
    seed: int = 0,
    density: float = 1.0,
    workers: int = 1,
    executor: ExecutorName = "process",
    progress: Progress = no_progress,
) -> BankList:
    """Make `count` people who can be told apart; the same seed gives the same bytes.

    Args:
        out: folder of the bank; what an earlier run of the same settings left is kept.
        count: number of people.
        seed: who they are.
        density: splats a person, relative to about 35,000.
        workers: people made at a time.
        executor: "process" or "ray".
        progress: progress sink.

    Raises:
        ConfigError: settings out of range, or the folder holds another bank.
        StorageError: the folder holds something else, or cannot be written.
    """
    out = plain_path(out)
    if not 1 <= count <= 100_000 or not 0.02 <= density <= 4.0:
        raise ConfigError(
            f"{count} people at density {density:g}", where="generate_bank",
            remedy="1 to 100,000 people, density 0.02 to 4",
        )  # fmt: skip
    made: dict[str, int | float | str] = {"seed": seed, "count": count, "density": density}
    people = draw_people(seed, count)
    digest = content_hash(msgspec.json.encode([made, people]), source_version(_DECIDING))
    check_contained(out)
    _read_journal(out, digest)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(error, out, "make the folder") from error
    names = [f"p{k:04}" for k in range(count)]
    with lock_folder(out, writer="bank"):
        sweep_folder(out)
        done = _read_journal(out, digest)
        todo = [(name, who) for name, who in zip(names, people, strict=True) if name not in done]
        with Journal(out / JOURNAL_FILE) as journal:
            if not journal.read():
                journal.append({"bank": digest})

            def note(index: int, answer: dict[str, Any]) -> None:
                done[todo[index][0]] = answer
                journal.append({"avatar": todo[index][0], **answer})

            run_jobs(
                _BUILD,
                [
                    {"name": name, "who": msgspec.to_builtins(who), "density": density,
                     "path": str((out / f"{name}.npz").resolve())}
                    for name, who in todo
                ],
                workers=workers,
                executor=executor,
                names=[f"person {name}" for name, _ in todo],
                done=note,
                what="people",
                progress=progress,
            )  # fmt: skip
        entries = [
            BankEntry(
                name=name, splats=done[name]["splats"], digest=done[name]["digest"],
                record=who.words(),
            )
            for name, who in zip(names, people, strict=True)
        ]  # fmt: skip
        listed = BankList(
            layout=LAYOUT, made=made, avatars=entries,
            hash=content_hash(*(entry.digest for entry in entries)),
        )  # fmt: skip
        write_json(out / BANK_FILE, msgspec.to_builtins(listed))
    return listed


def join_bank(path: Path | str, avatar: Avatar) -> BankList:
    """Write an avatar to NAME.npz, and list it by that name in the bank of that folder.

    A folder that holds no list becomes a bank; the list is in the order of names, however it grew.

    Args:
        path: the avatar's file, `BANK/NAME.npz`.
        avatar: who it is.

    Raises:
        ConfigError: a name that none has, a bank of generated people, or one that has another
            person of that name.
        StorageError, FormatError, DataError: see `save_avatar` and `AvatarBank`.
    """
    path = plain_path(path)
    folder, name = path.parent, path.stem
    if path.suffix != ".npz" or not _NAME.fullmatch(name):
        raise ConfigError(
            f"{path.name[:80]!r} names no person of a bank", where=folder,
            remedy="call the file NAME.npz, of letters, digits, - and _",
        )  # fmt: skip
    avatar = replace(avatar, name=name)
    check_contained(folder)
    if (folder / JOURNAL_FILE).exists():
        raise ConfigError(
            "is a bank of generated people, which is made whole from its seed", where=folder,
            remedy="put people of your own into another folder",
        )  # fmt: skip
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(error, folder, "make the folder") from error
    with lock_folder(folder, writer="bank"):
        known = AvatarBank(folder).list.avatars if (folder / BANK_FILE).exists() else []
        before = next((entry for entry in known if entry.name == name), None)
        if before is not None and before.digest != digest_avatar(_as_read(avatar)):
            raise ConfigError(
                f"has another person called {name!r}", where=folder, remedy="choose another name"
            )
        kept = save_avatar(path, avatar)
        entry = BankEntry(
            name=name, splats=len(kept), digest=digest_avatar(kept), record=kept.record,
            source=kept.source, licence=kept.licence,
        )  # fmt: skip
        entries = sorted(
            [*(one for one in known if one.name != name), entry], key=lambda one: one.name
        )
        listed = BankList(
            layout=LAYOUT, made={"by": "import"}, avatars=entries,
            hash=content_hash(*(one.digest for one in entries)),
        )  # fmt: skip
        write_json(folder / BANK_FILE, msgspec.to_builtins(listed))
    return listed


def _as_read(avatar: Avatar) -> Avatar:
    """The avatar as its file would give it back."""
    with tempfile.TemporaryDirectory() as folder:
        return save_avatar(Path(folder) / "one.npz", avatar)


def build_bank_avatar(payload: dict[str, Any]) -> dict[str, Any]:
    """One person of a bank, written to its file: what the journal notes of it."""
    who = msgspec.convert(payload["who"], Identity)
    avatar = build_person(who, name=payload["name"], density=payload["density"])
    kept = save_avatar(payload["path"], avatar)
    return {"splats": len(kept), "digest": digest_avatar(kept)}


def _read_journal(out: Path, digest: str) -> dict[str, dict[str, Any]]:
    """What earlier runs of the same settings have made, by name."""
    records = read_begun(out, JOURNAL_FILE, "bank", digest, "settings")
    found = {record.pop("avatar"): record for record in records}
    kept = {}
    for name, record in found.items():
        try:
            if digest_avatar(load_avatar(out / f"{name}.npz")) == record["digest"]:
                kept[name] = record
        except (FormatError, StorageError):
            continue  # made again
    return kept
