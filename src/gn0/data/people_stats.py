"""Who is in a dataset and what they do: identities, words of their records, clips, levels."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from gn0.avatars.bank import AvatarBank
from gn0.config import Config
from gn0.counted import counted
from gn0.data.dataset import Dataset
from gn0.data.sample_table import EpisodeRows
from gn0.missions.episode import Episode, MissionFollow
from gn0.people.identities import find_identity
from gn0.people.person import EpisodePerson, drawn_identity

WORDS_SHOWN = 12  # of each attribute of the records, most first


class PeopleStats(Config, frozen=True):
    """People of a dataset (paper, "Avatar and motion statistics", and static and dynamic share).

    Attributes:
        episodes: with people, by how many: {"3": 12}.
        identities: different people; followed: of them, those that somebody follows.
        behaviours: people of episodes by what they do: script, stand, sit.
        speeds: of those who walk, in steps of 0.1 m/s, by the speed: {"0.8": 5}.
        categories: follow missions by the person's walk: cruise, turn, stop-and-go.
        levels: follow missions by who else is there: single, distractors, ambiguous.
        clips: moments of people by clip: walk, idle, sit, or a gesture by its name.
        records: words of the records of all identities, by attribute: {"top": {"coat": 9}}.
        keywords: different pairs of attribute and word.
        tasks: samples by task: PLANNING, TRACKING.
        dynamic: share of samples whose goal moves [%]; static is the rest.
        peopled: share of samples in whose scene somebody is [%].
        in_view: share of TRACKING samples that show the person who is followed [%]; 0 where no
            pictures are drawn.
        share_seen: of these, how much of the person nothing hides, on average [%].
    """

    episodes: dict[str, int]
    identities: int
    followed: int
    behaviours: dict[str, int]
    speeds: dict[str, int]
    categories: dict[str, int]
    levels: dict[str, int]
    clips: dict[str, int]
    records: dict[str, dict[str, int]]
    keywords: int
    tasks: dict[str, int]
    dynamic: float
    peopled: float
    in_view: float
    share_seen: float


@dataclass
class PeopleTally:
    """What is counted over the samples, block by block."""

    samples: int = 0
    peopled: int = 0
    tasks: Counter[str] = field(default_factory=Counter)
    clips: Counter[str] = field(default_factory=Counter)
    shares: list[float] = field(default_factory=list)
    looked: int = 0

    def add(self, rows: EpisodeRows, episode: Episode) -> None:
        """Count the rows of an episode."""
        self.samples += len(rows)
        self.tasks[rows.task] += len(rows)
        if rows.people is None:
            return
        self.peopled += len(rows)
        for k, person in enumerate(episode.people):
            walks = int(rows.people.whole[:, k, 0].sum())
            self.clips["walk"] += walks
            self.clips[_still_clip(person)] += len(rows) - walks
        if rows.seen is not None and rows.person:
            row = next(k for k, own in enumerate(episode.people) if own.number == rows.person)
            table = rows.seen[:, row]
            self.looked += len(rows)
            self.shares += table[table[:, 1] > 0, 0].tolist()


def _still_clip(person: EpisodePerson) -> str:
    """What a person does while it does not walk."""
    return person.clip or ("sit" if person.behaviour == "sit" else "idle")


def count_people(dataset: Dataset, tally: PeopleTally) -> PeopleStats | None:
    """What a dataset holds of people; None where nobody is about.

    Raises:
        StorageError, FormatError: its bank cannot be read.
    """
    episodes = [episode for episode in dataset.episodes if episode.people]
    if not episodes:
        return None
    people = [person for episode in episodes for person in episode.people]
    names = sorted({person.identity for person in people})
    bank = None if dataset.bank is None else AvatarBank(dataset.bank)
    records: dict[str, Counter[str]] = {}
    for name in names:
        for key, word in read_record(name, bank).items():
            records.setdefault(key, Counter())[word] += 1
    follow = [e.mission for e in episodes if isinstance(e.mission, MissionFollow)]
    samples, tracking = max(tally.samples, 1), tally.tasks["TRACKING"]
    return PeopleStats(
        episodes=_by_number(Counter(len(episode.people) for episode in episodes)),
        identities=len(names),
        followed=len({e.followed.identity for e in episodes if e.followed is not None}),
        behaviours=_ordered(Counter(person.behaviour for person in people)),
        speeds={
            f"{tenth / 10:.1f}": count
            for tenth, count in sorted(
                Counter(round(10 * p.speed) for p in people if p.behaviour == "script").items()
            )
        },
        categories=_ordered(Counter(mission.category or "not told" for mission in follow)),
        levels=_ordered(Counter(mission.level or "not told" for mission in follow)),
        clips=_ordered(tally.clips),
        records={key: _ordered(words, WORDS_SHOWN) for key, words in sorted(records.items())},
        keywords=sum(len(words) for words in records.values()),
        tasks=_ordered(tally.tasks),
        dynamic=100.0 * tracking / samples,
        peopled=100.0 * tally.peopled / samples,
        in_view=100.0 * len(tally.shares) / max(tally.looked, 1),
        share_seen=100.0 * float(np.mean(tally.shares)) if tally.shares else 0.0,
    )


def read_record(identity: str, bank: AvatarBank | None) -> dict[str, str]:
    """The words of a person's record: of the bank, or of who is drawn; {} where nobody knows."""
    if drawn_identity(identity) is not None:
        return find_identity(identity).words()
    if bank is None or identity not in bank.names:
        return {}
    return dict(bank.entry(identity).record)


def describe_people(stats: PeopleStats) -> str:
    """The numbers in a few lines of plain words."""
    count, told = sum(stats.episodes.values()), ", ".join
    lines = [
        f"people: {counted(stats.identities, 'identity', 'identities')} in "
        f"{counted(count, 'episode')}, {counted(stats.keywords, 'word')} of their records; "
        f"{stats.peopled:.1f} % of the samples have somebody about",
        f"tasks: {told(f'{k} {v:,}' for k, v in stats.tasks.items())}; static "
        f"{100 - stats.dynamic:.1f} %, dynamic {stats.dynamic:.1f} %",
        f"clips: {told(f'{k} {v:,}' for k, v in stats.clips.items())}",
    ]
    if stats.levels:
        lines.append(
            f"follow missions: {told(f'{k} {v}' for k, v in stats.categories.items())}; "
            f"{told(f'{k} {v}' for k, v in stats.levels.items())}; "
            f"{counted(stats.followed, 'person', 'people')} followed"
        )
    if stats.in_view:
        lines.append(
            f"the person is in {stats.in_view:.1f} % of the TRACKING pictures, on average "
            f"{stats.share_seen:.0f} % of it"
        )
    return "\n".join(lines)


def _by_number(counts: Counter[int]) -> dict[str, int]:
    return {str(number): counts[number] for number in sorted(counts)}


def _ordered(counts: Counter[str], most: int | None = None) -> dict[str, int]:
    """Most first, then by name."""
    found = sorted(((k, v) for k, v in counts.items() if v), key=lambda item: (-item[1], item[0]))
    return dict(found[:most])
