"""Actions as marks to look at, and texts that fit into a box."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from PIL import ImageDraw

from gn0.sim.state import Action
from gn0.viewer.floor_plan import INK, MUTED, PAPER, font

Colour = tuple[int, int, int]
SAID, EXPERT = (213, 94, 0), (0, 114, 178)  # what the policy said, what the expert would say
WORDS = ("stop", "forward", "left", "right")  # by action codes
FAINT, WRONG = (226, 224, 218), (190, 30, 45)


def draw_actions(
    pen: ImageDraw.ImageDraw,
    corner: tuple[float, float],
    actions: Sequence[int],
    side: int,
    colour: Colour,
    *,
    executed: int,
    other: Sequence[int] = (),
) -> None:
    """A row of boxes, an action each; those that are carried out are filled.

    Args:
        pen: draws.
        corner: left and top of the first box [px].
        actions: codes.
        side: of a box [px].
        colour: of the row.
        executed: how many are carried out.
        other: actions to compare with: where they differ, a red line is under the box.
    """
    x, y = corner
    over = False
    for k, code in enumerate(actions):
        own = k < executed and not over
        over = over or code == Action.STOP
        box = (x, y, x + side, y + side)
        pen.rounded_rectangle(box, side // 7, colour if own else PAPER, colour, max(side // 24, 2))
        draw_action(pen, (x + side / 2, y + side / 2), code, side * 0.3, PAPER if own else colour)
        if k < len(other) and other[k] != code:
            pen.rectangle((x, y + side + 4, x + side, y + side + 4 + max(side // 14, 2)), WRONG)
        x += side + side // 6


def draw_action(
    pen: ImageDraw.ImageDraw, middle: tuple[float, float], code: int, size: float, colour: Colour
) -> None:
    """An arrow ahead, to the left or to the right, or a square for STOP."""
    x, y = middle
    if code == Action.STOP:
        pen.rectangle((x - size * 0.7, y - size * 0.7, x + size * 0.7, y + size * 0.7), colour)
        return
    turn = {Action.FORWARD: 0.0, Action.LEFT: -math.pi / 2, Action.RIGHT: math.pi / 2}[Action(code)]
    shape = ((0, -1), (0.85, -0.05), (0.32, -0.05), (0.32, 1), (-0.32, 1), (-0.32, -0.05),
             (-0.85, -0.05))  # fmt: skip
    c, s = math.cos(turn), math.sin(turn)
    pen.polygon(
        [(x + size * (a * c - b * s), y + size * (a * s + b * c)) for a, b in shape], colour
    )


def draw_bars(
    pen: ImageDraw.ImageDraw,
    corner: tuple[float, float],
    shares: Sequence[float],
    width: int,
    colour: Colour,
    *,
    size: int = 15,
    marked: int | None = None,
) -> int:
    """A bar an action with its share; returns how high all of it is [px].

    Args:
        pen: draws.
        corner: left and top [px].
        shares: by action codes, 0 to 1.
        width: of everything [px].
        colour: of the bars.
        size: of letters [px].
        marked: an action whose name is in the expert's colour.
    """
    x, y = corner
    names, tall = round(size * 5.2), size + 7
    room = width - names - round(size * 3.6)
    for code, share in enumerate(shares):
        top = y + code * tall
        ink = EXPERT if code == marked else INK
        pen.text((x, top), WORDS[code], ink, font(size))
        pen.rectangle((x + names, top + 2, x + names + room, top + size), FAINT)
        if share * room >= 1:
            pen.rectangle((x + names, top + 2, x + names + room * share, top + size), colour)
        pen.text((x + names + room + 8, top), f"{share:.1%}", INK, font(size))
    return len(shares) * tall


def wrap_text(text: str, width: float, size: int, *, most: int = 1000) -> list[str]:
    """A text in lines of at most so many pixels, cut at spaces, and behind tokens where need be.

    Args:
        text: what to write; its own line feeds are kept.
        width: [px].
        size: of letters [px].
        most: lines; the last one says so where there is more.
    """
    letters: Any = font(size)
    lines: list[str] = []
    for paragraph in text.split("\n"):
        line = ""
        for piece in re.findall(r"<[^<> ]*>,?|\s+|[^<>\s]+|[<>]", paragraph):
            while letters.getlength(piece) > width and len(piece) > 1:  # a word without end
                cut = max(int(len(piece) * width / letters.getlength(piece)), 1)
                lines += [line, piece[:cut]] if line else [piece[:cut]]
                line, piece = "", piece[cut:]
            if line and letters.getlength(line + piece) > width:
                lines.append(line.rstrip())
                line = "" if piece.isspace() else piece
            else:
                line += piece
        lines.append(line.rstrip())
    if len(lines) > most:
        lines = [*lines[: most - 1], f"… and {len(lines) - most + 1} lines more"]
    return lines


def fit_line(text: str, width: float, size: int) -> str:
    """A text on one line of at most so many pixels, cut with an ellipsis."""
    letters: Any = font(size)
    line = " ".join(text.split())[:600]
    if letters.getlength(line) <= width:
        return line
    while line and letters.getlength(line + "…") > width:
        line = line[:-1]
    return line + "…"


def write_lines(
    pen: ImageDraw.ImageDraw,
    corner: tuple[float, float],
    lines: Sequence[str],
    size: int,
    colour: Colour = MUTED,
) -> int:
    """Lines one below the other; returns how high they are [px]."""
    for k, line in enumerate(lines):
        pen.text((corner[0], corner[1] + k * (size + 6)), line, colour, font(size))
    return len(lines) * (size + 6)
