"""What the eye can tell of two people, and people who differ in one word."""

from __future__ import annotations

import pytest

from gn0.avatars.identity import Identity, draw_people
from gn0.avatars.likeness import CHANGES, Sight, change_record, read_record, seen_words, words_apart
from gn0.errors import DataError

WOMAN = Identity(seed=1, top="shirt", top_pattern="checked", bottom="straight_trousers")


def with_(**words: str) -> dict[str, str]:
    return {**WOMAN.words(), **words}


@pytest.mark.parametrize(
    ("change", "apart"),
    [
        ({"top_colour": "green"}, {"top_colour"}),
        ({"top_colour": "brown"}, set()),  # in a dim room, red is brown
        ({"bottom_colour": "yellow"}, {"bottom_colour"}),
        ({"top_pattern": "plain"}, {"top_pattern"}),
        ({"bottom": "wide_trousers"}, set()),
        ({"bottom": "long_skirt"}, {"bottom"}),
        ({"hair": "long01"}, {"hair"}),
        ({"hair": "short02"}, set()),  # a bob, seen from behind
        ({"hat": "hat", "hair": "short02"}, set()),
        ({"tone": "9", "age": "elderly", "shoes_colour": "red"}, set()),
    ],
)
def test_people_are_told_apart_by_what_shows(change: dict[str, str], apart: set[str]) -> None:
    assert words_apart(WOMAN.words(), with_(**change), Sight()) == apart
    assert words_apart(WOMAN.words(), WOMAN.words(), Sight()) == set()


def test_what_is_hidden_of_the_other_tells_nothing() -> None:
    coat = with_(top="coat", bottom="short_skirt", bottom_colour="yellow")
    apart = words_apart(WOMAN.words(), coat, Sight())
    assert "top" in apart and not {"bottom", "bottom_colour"} & apart
    dress = with_(top="dress", bottom="none")
    assert "bottom" in words_apart(WOMAN.words(), dress, Sight())


def test_shoes_and_prints_show_from_where_one_sees_them() -> None:
    record = with_(top_pattern="printed", extra="apron")
    near, far = Sight(distance=1.5), Sight(side="front", distance=3.0)
    assert not {"shoes", "extra", "top_pattern"} & seen_words(record, near)
    assert {"shoes", "extra"} <= seen_words(record, far)
    assert "top_pattern" not in seen_words(record, far)  # under the apron
    assert "top_pattern" in seen_words(with_(top_pattern="printed"), far)


def test_one_word_is_changed_and_it_shows() -> None:
    changed = 0
    for k, person in enumerate(draw_people(5, 12)):
        assert read_record(person.words(), person.seed) == person
        for key in CHANGES:
            try:
                other = change_record(person.words(), key, k)
            except DataError:
                continue
            changed += 1
            words, his = person.words(), other.words()
            differ = {word for word in words if words[word] != his[word]}
            assert differ == {key} or (key == "top_colour" and person.bottom == "none")
            assert words_apart(words, his, Sight()) == {key}
            assert other == change_record(person.words(), key, k)
            assert other.seed != person.seed  # another face
    assert changed > 40


def test_records_of_nobody_are_refused() -> None:
    with pytest.raises(DataError, match="nobody has 'toga' for top"):
        read_record(with_(top="toga"), 0)
    with pytest.raises(DataError, match="not the record of a person"):
        read_record(with_(tone="dark"), 0)
    with pytest.raises(DataError, match="no other bottom colour would show"):
        change_record(with_(top="dress", bottom="none"), "bottom_colour", 0)
