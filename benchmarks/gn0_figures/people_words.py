"""Whether words fit exactly one person: told by pictures of people in generated rooms."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.identity import Identity, draw_people
from gn0.avatars.likeness import Sight
from gn0.avatars.person import build_person
from gn0.errors import ConfigError, LanguageError
from gn0.missions.generate.bystanders import Level, change_people, choose_different, draw_count
from gn0.missions.language.follow_grammar import count_follow_phrases, held_out_follow_phrases
from gn0.missions.language.follow_words import FollowText, write_follow
from gn0.missions.language.words_judge import WordsVerdict, judge_words
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least
from gn0_figures.people_colours import SCENES
from gn0_figures.people_placed import (
    CAMERA,
    Meeting,
    PeopleScene,
    open_people_scene,
    place_meeting,
    show_meeting,
)

SEED, BANK, EACH = 11, 40, 6  # people; meetings a scene and level
_MOMENTS = (0.0, 0.5, 1.0)  # s: the first second in which the agent sees the person
_LEVELS: tuple[Level, ...] = ("single", "distractors", "ambiguous")


class _Wardrobe:
    """People who have been built."""

    def __init__(self) -> None:
        self.kept: dict[Identity, Avatar] = {}

    def fetch(self, who: Identity) -> Avatar:
        if who not in self.kept:
            if len(self.kept) > 60:
                self.kept.pop(next(iter(self.kept)))
            self.kept[who] = build_person(who, density=0.5)
        return self.kept[who]


def measure_words(ctx: FigureContext) -> list[FigureRow]:
    """Share of sentences that pictures prove to fit one person, by level; time of a text."""
    people, wardrobe = draw_people(SEED, BANK), _Wardrobe()
    verdicts: dict[str, Counter[str]] = {level: Counter() for level in _LEVELS}
    groups: list[list[dict[str, str]]] = []
    number = 0
    for turn, (kind, seed) in enumerate(SCENES):
        ctx.progress("meeting people", turn, len(SCENES))
        place = open_people_scene(kind, seed, ctx.work)
        for level in _LEVELS:
            for _ in range(EACH):
                number += 1
                found = meet(place, people, level, number, wardrobe.fetch)
                verdicts[level][found[2].verdict if found else "no such people"] += 1
                if found:
                    groups.append(found[0])
    rows = []
    for kind_of, counts in verdicts.items():
        told = counts.total() - counts["no such people"]
        detail = f"{told} meetings in four scenes, 480 x 360; " + ", ".join(
            f"{verdict} {count}" for verdict, count in sorted(counts.items())
        )
        share = 100.0 * counts["fits"] / max(told, 1)
        rows.append(
            FigureRow(
                name=f"words proven to fit one, {kind_of}", value=share, unit="%", detail=detail
            )
        )
    start = time.perf_counter()
    for seed, group in enumerate(groups):
        write_follow(group, 0, seed=seed) if len(group) == 1 else None
    alone = max(sum(len(group) == 1 for group in groups), 1)
    each = (time.perf_counter() - start) / alone
    total, apart = count_follow_phrases(), len(held_out_follow_phrases())
    rows += [
        row_at_least("skeletons of follow missions", total, 100, "phrases", f"{apart} held out"),
        FigureRow(name="time of a text", value=1e3 * each, unit="ms"),
    ]
    return rows


def meet(
    place: PeopleScene,
    people: Sequence[Identity],
    level: Level,
    number: int,
    fetch: Callable[[Identity], Avatar],
) -> tuple[list[dict[str, str]], FollowText, WordsVerdict, Meeting, list[Avatar]] | None:
    """A meeting of a level with its words and what pictures say; None without such people."""
    count = draw_count(level, number)
    tried = (place_meeting(place, k, number) for k in range(count, min(count, 1) - 1, -1))
    meeting = next((found for found in tried if found is not None), None)
    if meeting is None:
        return None
    who = people[(7 * number) % len(people)]
    away = float(np.hypot(*(meeting.places[0, :2] - np.array(meeting.eye[:2]))))
    sight, others = Sight(distance=away), len(meeting.places) - 1
    try:
        if level == "ambiguous":
            group = [who, *(i for _, i in change_people(who.words(), others, number, sight=sight))]
        else:
            bank = {str(k): person.words() for k, person in enumerate(people)}
            chosen = choose_different(who.words(), bank, others, number) if others else []
            group = [who, *(people[int(k)] for k in chosen)]
        records = [person.words() for person in group]
        text = write_follow(
            records, 0, meeting.scene, sight=sight, seed=number, held_out=number % 5 == 0
        )
    except (ConfigError, LanguageError):
        return None
    avatars = [fetch(person) for person in group]
    moments = [show_meeting(place, meeting, avatars, seconds) for seconds in _MOMENTS]
    verdict = judge_words(
        place.renderer, CAMERA, moments, text.said, 0, sight, ahead=text.doing == "ahead"
    )
    return records, text, verdict, meeting, avatars


FIGURES = [Figure("people.words", "Words of follow missions fit one person", measure_words, 10.0)]
