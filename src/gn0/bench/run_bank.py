"""Whether a run has the people whom its episodes name, found out before anything is played."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gn0.errors import EpisodeError
from gn0.people.person import drawn_identity

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


def check_clips(episodes: Sequence[Episode], bank: Path | str | None) -> None:
    """Whether the clips of a report can show the people whom episodes name.

    Which episodes are shown is known when all are played, so the people of each have to be there.

    Raises:
        EpisodeError: the bank is another one than they say, or has nobody of a name, or none was
            given.
        StorageError, FormatError: it cannot be read.
    """
    people = (person for episode in episodes for person in episode.people)
    if all(drawn_identity(person.identity) is not None for person in people):
        return
    try:
        check_bank(episodes, bank)
    except EpisodeError as error:
        if bank is not None:
            raise
        raise EpisodeError(
            error.what,
            where=error.where,
            remedy=f"{error.remedy}; clips of the report show them: without a bank, give "
            "--no-report or --videos 0, and `gn0 bench report RUN --bank FOLDER` can draw them "
            "later",
        ) from None
