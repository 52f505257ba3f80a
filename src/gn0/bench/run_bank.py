"""Whether a run has the people whom its episodes name, found out before anything is played."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gn0.missions.episode import Episode


def check_bank(episodes: Sequence[Episode], bank: Path | str | None) -> str:
    """Whether a bank has the people of episodes.

    Returns:
        Its content hash; "" without one.

    Raises:
        EpisodeError: it is another one than they say, or has nobody of a name, or none was given.
        StorageError, FormatError: it cannot be read.
    """
    from gn0.people.cast import Cast  # bodies are needed only where there are people

    cast = Cast(bank)
    for episode in episodes:
        cast.check(episode.people, f"episode {episode.id!r}")
    return "" if cast.bank is None else cast.bank.content_hash
