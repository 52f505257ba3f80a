"""Scenes join a stream at their numbers of samples, wherever it was stopped."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

pytest.importorskip("torch")

from gn0.errors import CheckpointError, ConfigError, FormatError
from gn0.training.streams.stream_growing import StreamGrowing


class Numbers:
    """Gives (part, how many were drawn before)."""

    def __init__(self, part: int) -> None:
        self.part, self.drawn = part, 0
        self.texts = (f"part {part}",)

    def draw(self, count: int) -> Any:
        self.drawn += count
        return self.part, self.drawn - count

    def state(self) -> dict[str, Any]:
        return {"drawn": self.drawn}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.drawn = state["drawn"]


def _open(part: int, begun: int) -> tuple[Numbers, str]:
    return Numbers(part), f"hash {part}"


def _draw_all(stream: StreamGrowing, times: int) -> list[Any]:
    return [stream.draw(4) for _ in range(times)]


def test_each_lot_joins_at_its_number() -> None:
    stream = StreamGrowing(_open, [0, 8, 13])
    assert _draw_all(stream, 6) == [(0, 0), (0, 4), (1, 0), (1, 4), (2, 0), (2, 4)]
    assert stream.texts == ("part 2",)


@pytest.mark.parametrize("joins, parts", [((0, 8, 8), "002222"), ((0, 0, 8), "112222")])
def test_lots_of_one_number_join_together(joins: tuple[int, ...], parts: str) -> None:
    opened = []

    def open_part(part: int, begun: int) -> tuple[Numbers, str]:
        opened.append(part)
        return _open(part, begun)

    drawn = _draw_all(StreamGrowing(open_part, joins), 6)
    assert "".join(str(part) for part, _ in drawn) == parts
    assert len(opened) == 2  # scenes are opened once a number


@pytest.mark.parametrize("stop", range(6))
def test_it_goes_on_where_it_was_left(stop: int) -> None:
    whole = _draw_all(StreamGrowing(_open, [0, 8, 13]), 6)
    first = StreamGrowing(_open, [0, 8, 13])
    begun = _draw_all(first, stop)
    second = StreamGrowing(_open, [0, 8, 13])
    second.restore(first.state())
    assert begun + _draw_all(second, 6 - stop) == whole


def test_a_late_lot_joins_with_the_first_samples_that_find_it() -> None:
    there, begun = set[int](), []

    def open_part(part: int, drawn: int) -> tuple[Numbers, str]:
        begun.append(drawn)
        return _open(part, drawn)

    def open_stream() -> StreamGrowing:
        return StreamGrowing(open_part, [0, 4, 8, 12], there.__contains__)

    stream = open_stream()
    assert [part for part, _ in _draw_all(stream, 3)] == [0, 0, 0]
    there.add(2)  # not before the one that is due before it
    assert stream.draw(4)[0] == 0
    there.add(1)
    assert stream.draw(4) == (2, 0) and begun == [0, 16]
    there.add(3)
    state = stream.state()
    whole = _draw_all(stream, 3)
    assert [part for part, _ in whole] == [3, 3, 3]
    other = open_stream()
    other.restore(state)
    assert begun[-2:] == [0, 16]  # as it was, however late
    assert _draw_all(other, 3) == whole


def test_a_lot_that_is_there_early_waits_for_its_number() -> None:
    drawn = _draw_all(StreamGrowing(_open, [0, 8, 13], lambda part: True), 6)
    assert drawn == _draw_all(StreamGrowing(_open, [0, 8, 13]), 6)


def test_states_of_old_do_not_tell_when_scenes_joined() -> None:
    first = StreamGrowing(_open, [0, 8])
    _draw_all(first, 3)
    state = first.state()
    del state["begun"]
    other = StreamGrowing(_open, [0, 8])
    other.restore(state)
    assert other.draw(4) == (1, 4)
    with pytest.raises(FormatError, match="joined after 40 samples"):
        other.restore(state | {"begun": 40})


def test_joins_that_make_no_sense_and_foreign_states_are_refused() -> None:
    for joins in ((), (4,), (0, 8, 4), (0, -1)):
        with pytest.raises(ConfigError, match="join at"):
            StreamGrowing(_open, joins)
    with pytest.raises(FormatError, match="lots of scenes"):
        StreamGrowing(_open, [0]).restore({"part": 1, "drawn": 0, "stream": {}})


def test_scenes_that_changed_meanwhile_are_refused() -> None:
    first = StreamGrowing(_open, [0, 8])
    _draw_all(first, 3)
    other = StreamGrowing(lambda part, _: (Numbers(part), "another"), [0, 8])
    with pytest.raises(CheckpointError, match="learned from scenes hash 1, these are another"):
        other.restore(first.state())
