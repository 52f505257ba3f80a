"""Whether people can be told apart, wear what they are said to wear, and how long one takes."""

from __future__ import annotations

import time
from collections import Counter
from itertools import combinations

import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.body_file import BODY_FILE
from gn0.avatars.cloth_file import WARDROBE_FILE
from gn0.avatars.identity import draw_people
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.motion.library import ClipLibrary
from gn0.avatars.person import build_person
from gn0.geometry import F64
from gn0.viewer.avatar_check import (
    BOTTOM,
    TOP,
    measure_gaps,
    measure_skin,
    read_colour,
    score_colour,
)
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.people_colours import ColourRoom, open_rooms, read_garments

SEED, BUILT, BANK = 7, 40, 200  # people who are built; of whom records are compared
_SKIRTS = ("skirt", "short_skirt", "long_skirt")
_DRESSES = ("dress", "long_dress", "coat", "long_coat")


def measure_dress(ctx: FigureContext) -> list[FigureRow]:
    """Names of colours, skin through clothes, differences, time, bytes."""
    bank = draw_people(SEED, BANK)
    least = min(a.differences(b) for a, b in combinations(bank, 2))
    most = max(Counter(person.silhouette() for person in bank).values())
    scores: list[float] = []
    shown: dict[str, list[float]] = {"trousers": [], "skirts": []}
    seconds, splats = [], []
    ctx.progress("lighting rooms", 0, 1)
    rooms = open_rooms()
    gaps: Counter[str] = Counter()
    sight: Counter[str] = Counter()
    for number, person in enumerate(bank[:BUILT]):
        ctx.progress("dressing people", number, BUILT)
        start = time.perf_counter()
        avatar = build_person(person)
        seconds.append(time.perf_counter() - start)
        splats.append(len(avatar))
        for part, name in ((TOP, "top"), (BOTTOM, "bottom")):
            read = read_colour(avatar, part) if (avatar.part == part).any() else ""
            if read:
                scores.append(score_colour(getattr(person, f"{name}_colour"), read))
        read_garments(rooms, avatar, number)
        moving = moving_poses(avatar)
        for where, (open_, lines) in measure_gaps(avatar, moving).items():
            gaps[where] += open_
            sight[where] += lines
        skin, cloth = measure_skin(avatar, moving)
        hangs = person.bottom in _SKIRTS or person.top in _DRESSES
        shown["skirts" if hangs else "trousers"].append(100.0 * skin / max(cloth, 1))
    poses = "12 poses of a walk, 6 of a run, 6 of sitting down; from four sides at 2 m"
    who = f"people of seed {SEED}"
    rows = [
        row_at_least("least difference of two people", least, 2, "attributes", f"{BANK} {who}"),
        row_at_most("most alike in cut of top, bottom and hair", most, 8, "people", f"of {BANK}"),
        row_at_least(
            "names of colours read from pictures", 100.0 * float(np.mean(scores)), 95, "%",
            f"{len(scores)} garments in view of {BUILT} {who}; 480 x 360 at 3 m, even light; half "
            "points for grey or black, beige or white",
        ),
    ]  # fmt: skip
    rows.append(_room_row(rooms))
    for name, shares in shown.items():
        about = f"{len(shares)} people, {poses}"
        rows.append(
            row_at_most(f"skin through {name}, mean", float(np.mean(shares)), 0.1, "%", about)
        )
        worst = f"skin through {name}, the worst of them"
        rows.append(row_at_most(worst, float(np.max(shares)), 0.1, "%", about))
    for where, lines in sight.items():
        about = f"of {lines:,} sight lines into {BUILT} bodies, {poses}"
        rows.append(row_at_most(f"gaps at the {where}", gaps[where], 0, "lines", about))
    size = (BODY_FILE.stat().st_size + WARDROBE_FILE.stat().st_size) / 2**20
    rows += [
        row_at_most("body and wardrobe in the wheel", size, 6, "MiB"),
        FigureRow(name="splats a person, median", value=float(np.median(splats)), unit="splats"),
        FigureRow(name="time to build one, median", value=float(np.median(seconds)), unit="s"),
    ]
    return rows


def _room_row(rooms: list[ColourRoom]) -> FigureRow:
    """Names of colours read in the light of rooms."""
    scores = [score for room in rooms for score in room.scores]
    each = ", ".join(f"{room.name} {100.0 * np.mean(room.scores):.1f}" for room in rooms)
    dark = sum(room.dark for room in rooms)
    wrong = Counter(f"{said} as {read}" for room in rooms for _, said, read in room.misses)
    often = ", ".join(f"{what} {count} x" for what, count in wrong.most_common(3))
    return row_at_least(
        "names of colours read in rooms", 100.0 * float(np.mean(scores)), 95, "%",
        f"{len(scores)} garments of the same people in four generated scenes at 3 m, light by the "
        f"gain of the place, divided by a grey card's; {each}; {dark} left out as too dark; "
        f"taken for another most often: {often or 'none'}",
    )  # fmt: skip


def moving_poses(avatar: Avatar) -> list[F64]:
    """24 poses [55, 3] rad of a walk, a run and sitting down."""
    library = ClipLibrary(measure_build(avatar.joints, avatar.points, avatar.weights))
    poses: list[F64] = []
    for clip, count in (("walk", 12), ("run", 6), ("sit_down", 6)):
        motion = library.motion(clip)
        poses += [motion.poses[k] for k in np.linspace(0, len(motion) - 1, count).astype(int)]
    return poses


FIGURES = [Figure("avatars.dress", "People: told apart, dressed as said", measure_dress, 11.0)]
