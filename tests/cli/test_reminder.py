"""What a command says that has said nothing for long."""

from __future__ import annotations

import time

from gn0.cli.reminder import break_silence


def test_long_silence_is_broken_ever_more_seldom_and_a_line_begins_anew() -> None:
    said: list[str] = []
    with break_silence(said.append, silence=0.05) as say:
        say("first")
        until = time.monotonic() + 30.0
        while len(said) < 3 and time.monotonic() < until:
            time.sleep(0.01)
        say("second")
        while len(said) < 5 and time.monotonic() < until:
            time.sleep(0.01)
    assert said[0] == "first" and said[1].startswith("goes on, 0 s since the last line")
    assert "second" in said[2:] and said[-1].startswith("goes on")


def test_who_speaks_often_is_left_alone_and_ends_at_once() -> None:
    said: list[str] = []
    began = time.monotonic()
    with break_silence(said.append, silence=60.0) as say:
        say("all")
    assert said == ["all"]
    assert time.monotonic() - began < 30.0
