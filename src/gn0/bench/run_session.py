"""One command's part in a run: what it found in the folder, and who the policy says it is."""

from __future__ import annotations

import time
from datetime import UTC, datetime

from gn0.bench.executors import EpisodePool
from gn0.bench.results import PolicyCard
from gn0.bench.worker_messages import Ready, Refused
from gn0.counted import counted
from gn0.errors import ConfigError

NAME_LIMIT = 80  # characters
_STAMP = "%Y-%m-%dT%H:%M:%SZ"


def stamp_now() -> str:
    """The time as a journal keeps it: UTC, to the second."""
    return time.strftime(_STAMP, time.gmtime())


def tell_clock(stamp: str) -> str:
    """A time of a journal as the wall clock here says it, with the date unless it is today's."""
    try:
        then = datetime.strptime(stamp, _STAMP).replace(tzinfo=UTC).astimezone()
    except ValueError:
        return stamp[:40]
    today = then.date() == datetime.now().astimezone().date()
    return then.strftime("%H:%M" if today else "%Y-%m-%d %H:%M")


def check_name(name: str) -> str:
    """A name for a run, if it can be shown; "" for none.

    Raises:
        ConfigError: too long, or more than one line of plain text.
    """
    if name and (not name.strip() or len(name) > NAME_LIMIT or not name.isprintable()):
        raise ConfigError(
            f"name {name[:NAME_LIMIT]!r} cannot be shown",
            where="--name",
            remedy=f"give one line of at most {NAME_LIMIT} characters",
        )
    return name


def tell_earlier(
    kept: int, kept_failed: int, invalid: int, expected: int, failed: int, begun: str, ended: str
) -> list[str]:
    """What an earlier run left, and what is made of it, in sentences.

    Args:
        kept: episodes whose results are kept.
        kept_failed: how many of those failed.
        invalid: how many of those could not be scored.
        expected: episodes asked for.
        failed: episodes that failed in it and are tried again.
        begun: when it began; "" when not known.
        ended: when it was finished; "" when it was not.
    """
    there = f"{kept} of {expected} episodes were there already"
    if kept == expected:
        bad = f"; {kept_failed} of them failed and are kept so" if kept_failed else ""
        if invalid:
            many = "is" if invalid == 1 else "are"
            bad += (
                f"; {invalid} of them {many} invalid: if the cause is gone, --fresh runs all again"
            )
        return [
            f"{there}{f', finished {tell_clock(ended)}' if ended else ''}; nothing was run{bad}"
        ]
    of = f" in the run of {tell_clock(begun)}" if begun else " before"
    lines = [f"{there}, done{of}"] if kept else []
    if failed:
        lines.append(
            f"{counted(failed, 'episode')} failed{of} and will be tried "
            "again; --keep-failed leaves them as they are"
        )
    return lines


def ask_card(pool: EpisodePool, seconds: float) -> PolicyCard | str:
    """Have one worker build the policy and say who it is; or why it did not, in words."""
    worker = pool.start()
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        heard = pool.hear(min(left, 60.0))
        if heard is None:
            continue
        if isinstance(heard.message, Ready):
            return heard.message.card
        if isinstance(heard.message, Refused):
            return heard.message.what
        return f"its worker {pool.end(worker).how}"
    return f"it did not say so within {seconds:g} s"
