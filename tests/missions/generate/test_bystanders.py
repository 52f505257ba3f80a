"""Who else is there: people who look different, people who are the same but for one word."""

from __future__ import annotations

import pytest

from gn0.avatars.identity import Identity, draw_people
from gn0.avatars.likeness import Sight, words_apart
from gn0.errors import ConfigError
from gn0.missions.generate.bystanders import (
    LEVELS,
    all_apart,
    change_people,
    choose_different,
    draw_count,
)

BANK = {f"p{k:04}": person.words() for k, person in enumerate(draw_people(0, 40))}


def test_distractors_look_different_from_the_person_and_from_each_other() -> None:
    for k, (name, person) in enumerate(BANK.items()):
        chosen = choose_different(person, BANK, 7, k)
        assert len(set(chosen)) == 7 and name not in chosen
        assert chosen == choose_different(person, dict(reversed(BANK.items())), 7, k)
        for other in chosen:
            apart = words_apart(person, BANK[other], Sight())
            assert len(apart) >= 3 and apart & {"top_colour", "bottom_colour"}
        assert all_apart([person, *(BANK[other] for other in chosen)], 0, Sight())


def test_ambiguous_people_differ_in_one_word_each() -> None:
    counted = 0
    for k, person in enumerate(BANK.values()):
        try:
            found = change_people(person, 3, k)
        except ConfigError:
            continue
        counted += 1
        for key, other in found:
            assert words_apart(person, other.words(), Sight()) == {key}
        assert len({key for key, _ in found}) >= 2
        assert found == change_people(person, 3, k)
    assert counted >= 36


def test_levels_have_as_many_others_as_they_should() -> None:
    counts = {level: {draw_count(level, seed) for seed in range(80)} for level in LEVELS}
    assert counts == {"single": {0}, "distractors": set(range(1, 8)), "ambiguous": {1, 2, 3}}


def test_what_cannot_be_had_is_said() -> None:
    person = next(iter(BANK.values()))
    with pytest.raises(ConfigError, match="ask for 1 to 7"):
        choose_different(person, BANK, 8, 0)
    with pytest.raises(ConfigError, match="only 0 of 2 others"):
        choose_different(person, {"twin": person}, 2, 0)
    bound = Identity(
        seed=0, sex="man", top="suit", bottom="suit_trousers", hat="hat", hair="short01"
    )
    with pytest.raises(ConfigError, match="differ from this one in a single word"):
        change_people(bound.words(), 7, 0)
