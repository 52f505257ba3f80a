"""A few small dressed people for tests, each made once a process."""

from __future__ import annotations

from functools import cache

from gn0.avatars.avatar import Avatar
from gn0.avatars.identity import draw_people
from gn0.avatars.person import build_person


@cache
def small_person(number: int = 0, density: float = 0.25) -> Avatar:
    """One of four people, of about 35,000 · density splats."""
    return build_person(draw_people(3, 4)[number], name=f"small-{number}", density=density)
