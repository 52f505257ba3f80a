"""One decision of a checkpoint in one picture: what it saw, was asked and said, and the expert."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gn0.data.codec import waypoint_pixels
from gn0.geometry import F64, U8, Pose2D
from gn0.missions.episode import Episode
from gn0.policies.bae.decision import Decision, ExpertSaid
from gn0.policies.bae.policy_settings import SQUARE_NAMES, PolicySettings, frame_of
from gn0.viewer.action_marks import (
    EXPERT,
    FAINT,
    SAID,
    draw_actions,
    draw_bars,
    fit_line,
    wrap_text,
    write_lines,
)
from gn0.viewer.floor_plan import INK, MUTED, PAPER, font
from gn0.viewer.track_map import TrackMap, draw_dot, draw_way

WIDTH, _GAP = 1800, 24
_SEEN = 400  # px: greatest height of a picture that was shown
_MIDDLE = 560  # px: height of the row with answer and map
PICTURE_NAMES = {
    "rgb": "view",
    "history": "history: the last 16 views, newest first",
    "goal_picture": "goal picture",
}
_BLANK = 236
_BROAD = 760  # px of the answer at most
_RIGHT = 1440  # px: where the map's column begins at the latest


@dataclass(frozen=True, eq=False)
class DecisionShown:
    """All that a picture of a decision tells.

    Attributes:
        episode: in which it was made.
        settings: of the checkpoint.
        decision: the question and the answer.
        expert: what the expert would have said; None where it knows no way.
        track: [N, 2] m, the walk up to it.
        words: what else is told about it, in short.
    """

    episode: Episode
    settings: PolicySettings
    decision: Decision
    expert: ExpertSaid | None
    track: F64
    words: str = ""


def render_decision(shown: DecisionShown, ground: TrackMap) -> Image.Image:
    """The picture.

    Args:
        shown: what is told.
        ground: the scene from above.
    """
    parts = [
        _draw_title(shown),
        _draw_seen(shown),
        _draw_middle(shown, ground),
        _draw_prompt(shown.decision.prompt),
    ]
    height = sum(part.height for part in parts) + _GAP * len(parts)
    sheet = Image.new("RGB", (WIDTH, height), PAPER)
    top = 0
    for part in parts:
        sheet.paste(part, (0, top))
        top += part.height + _GAP
    return sheet


def _draw_title(shown: DecisionShown) -> Image.Image:
    episode, decision = shown.episode, shown.decision
    lines = wrap_text(f"“{' '.join(episode.instruction.split())}”", WIDTH - 2 * _GAP, 28, most=3)
    part = Image.new("RGB", (WIDTH, 56 + 34 * len(lines)), PAPER)
    pen = ImageDraw.Draw(part)
    facts = [episode.id, episode.scene_id, f"step {decision.step}"]
    if shown.expert is not None:
        facts.append(f"{shown.expert.distance:.2f} m to the goal on foot")
    facts += [shown.words] if shown.words else []
    line = fit_line("   ·   ".join(facts), WIDTH - 2 * _GAP, 18)
    pen.text((_GAP, 20), line, MUTED, font(18))
    write_lines(pen, (_GAP, 52), lines, 28, INK)
    return part


def _draw_seen(shown: DecisionShown) -> Image.Image:
    """The pictures of the prompt, in its order, in rows as high as they fit."""
    pictures = shown.decision.pictures
    room = WIDTH - _GAP
    sizes = [(p.shape[1], p.shape[0]) for _, p in pictures]
    tall = min(_SEEN, int((room - _GAP * len(sizes)) / sum(w / h for w, h in sizes)))
    part = Image.new("RGB", (WIDTH, tall + 32), PAPER)
    pen = ImageDraw.Draw(part)
    x = _GAP
    for number, (name, picture) in enumerate(pictures, 1):
        tile = enlarge(picture, tall)
        pen.text((x, 0), fit_line(f"{number}: {_name(shown, name)}", tile.width, 16), INK, font(16))
        part.paste(tile, (x, 30))
        x += tile.width + _GAP
    return part


def _name(shown: DecisionShown, name: str) -> str:
    if name not in SQUARE_NAMES:
        return PICTURE_NAMES.get(name, name)
    square = shown.settings.view.squares[SQUARE_NAMES.index(name)]
    return f"{name} map, {square.size * square.metres_per_pixel:.1f} m wide, heading up"


def enlarge(picture: U8, height: int) -> Image.Image:
    """A picture [H, W, 3] at a height [px]; small ones keep their pixels."""
    image = Image.fromarray(np.ascontiguousarray(picture))
    width = max(round(image.width * height / image.height), 1)
    small = height >= 1.5 * image.height
    way = Image.Resampling.NEAREST if small else Image.Resampling.LANCZOS
    return image.resize((width, height), way)


def draw_answer_map(shown: DecisionShown, side: int) -> Image.Image:
    """The map that the answer's points lie on, with them, and with the expert's."""
    settings, decision = shown.settings, shown.decision
    frame = settings.frame or frame_of(settings.view.squares[settings.square])
    name = SQUARE_NAMES[settings.square]
    plain = np.full((frame.size, frame.size, 3), _BLANK, np.uint8)
    picture = dict(decision.pictures).get(name, plain)
    image = Image.fromarray(np.ascontiguousarray(picture)).resize(
        (2 * side, 2 * side), Image.Resampling.NEAREST
    )
    pen = ImageDraw.Draw(image)
    pixel = 2 * side / frame.size

    def place(points: NDArray[np.floating]) -> list[tuple[float, float]]:
        found = (waypoint_pixels(frame, points[None], np.zeros((1, 3)))[0] + 0.5) * pixel
        return [(float(x), float(y)) for x, y in found]

    unit = max(side / 240, 1.0)
    ways = []
    if shown.expert is not None and settings.form.points:
        ways.append((shown.expert.waypoints[: settings.form.points], EXPERT))
    if decision.waypoints is not None:
        ways.append((decision.waypoints, SAID))
    for way, colour in ways:
        spots = place(way)
        draw_way(pen, spots, colour, unit * 1.6)
        draw_dot(pen, spots[-1], 6.5 * unit, colour)
    return image.resize((side, side), Image.Resampling.LANCZOS)


def _draw_middle(shown: DecisionShown, ground: TrackMap) -> Image.Image:
    """The answer on its map, the answer in words, and the walk."""
    decision, expert = shown.decision, shown.expert
    part = Image.new("RGB", (WIDTH, _MIDDLE), PAPER)
    pen = ImageDraw.Draw(part)
    head, left = 30, _GAP
    if shown.settings.form.points:
        side = _MIDDLE - head - 26
        answer = draw_answer_map(shown, side)
        pen.text((left, 0), "what it said, on its map", INK, font(18))
        part.paste(answer, (left, head))
        legend = ((SAID, "the policy"), (EXPERT, "the expert"))
        x = left
        for colour, word in legend:
            draw_dot(pen, (x + 8, _MIDDLE - 12), 7, colour)
            pen.text((x + 22, _MIDDLE - 21), word, INK, font(16))
            x += 140
        left += side + 2 * _GAP
    picture = ground.draw(
        shown.track,
        decision.pose,
        goals=shown.episode.goals,
        ways=[(_to_world(decision.waypoints, decision.pose), SAID)]
        if decision.waypoints is not None
        else [],
    )
    right = WIDTH - _GAP - picture.width
    words = "the walk so far; green: start, star: goal"
    pen.text((WIDTH - _GAP, 0), words, INK, font(18), anchor="ra")
    part.paste(picture, (right, head))
    _write_answer(pen, decision, expert, left, min(right, _RIGHT) - 2 * _GAP)
    return part


def _write_answer(
    pen: ImageDraw.ImageDraw, decision: Decision, expert: ExpertSaid | None, left: int, right: int
) -> None:
    width = min(right - left, _BROAD)
    side = min(64, round(width / 8.4))
    own = decision.actions or ()
    theirs = expert.actions if expert is not None else ()
    y = 0
    pen.text((left, y), f"said (filled: the {decision.executed} that are carried out)", INK,
             font(18))  # fmt: skip
    y += 30
    if decision.actions is None:
        pen.text((left, y), "unreadable: the agent turns on the spot", INK, font(18))
    else:
        draw_actions(
            pen, (left, y), own, side, SAID, executed=decision.executed, other=theirs[: len(own)]
        )
    y += side + 22
    words = "the expert" if expert is not None else "the expert knows no way from here"
    pen.text((left, y), words, INK, font(18))
    y += 30
    if expert is not None:
        draw_actions(pen, (left, y), theirs[: max(len(own), 1)] or theirs, side, EXPERT, executed=0)
        y += side + 20
    sure = decision.confidence
    if sure is not None:
        pen.text((left, y), "how probable each first action was", INK, font(18))
        y += 30
        marked = theirs[0] if theirs else None
        y += draw_bars(pen, (left, y), sure.first, width, SAID, marked=marked) + 6
        line = f"entropy: first action {sure.first_entropy:.2f} nat, all chosen {sure.entropy:.2f}"
        y += write_lines(pen, (left, y), wrap_text(line, width, 15), 15) + 8
    pen.text((left, y), "in its own words", INK, font(18))
    y += 28
    for size in (16, 14, 12):
        most = max((_MIDDLE - y) // (size + 6), 1)
        lines = wrap_text(decision.answer, width, size)
        if len(lines) <= most:
            break
    write_lines(pen, (left, y), lines[:most], size, INK)


def _draw_prompt(prompt: str) -> Image.Image:
    """What it was asked, as its tokens say it."""
    lines = wrap_text(prompt.rstrip(), WIDTH - 4 * _GAP, 16, most=60)
    part = Image.new("RGB", (WIDTH, 46 + 22 * len(lines) + 16), PAPER)
    pen = ImageDraw.Draw(part)
    pen.text((_GAP, 0), "what it was asked", INK, font(18))
    box = (_GAP, 30, WIDTH - _GAP, part.height - 1)
    pen.rounded_rectangle(box, 8, (245, 243, 238), FAINT)
    write_lines(pen, (2 * _GAP, 42), lines, 16, INK)
    return part


def _to_world(points: NDArray[np.floating], pose: Pose2D) -> F64:
    way = np.asarray(points, np.float64)
    c, s = np.cos(pose.yaw), np.sin(pose.yaw)
    x, y = way[:, 0], way[:, 1]
    return np.column_stack([pose.x + c * x - s * y, pose.y + s * x + c * y])
