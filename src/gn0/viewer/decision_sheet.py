"""Contact sheets of a checkpoint's decisions: over an episode, or of successes and failures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from gn0.errors import ConfigError
from gn0.geometry import F64, Pose2D
from gn0.missions.episode import Episode
from gn0.policies.bae.decision import ExpertSaid, StepAsked, ask_expert, walk_asked
from gn0.policies.bae.policy_settings import PolicySettings
from gn0.progress import Progress, no_progress
from gn0.sim.state import Action
from gn0.viewer.action_marks import (
    EXPERT,
    FAINT,
    SAID,
    draw_actions,
    fit_line,
    wrap_text,
    write_lines,
)
from gn0.viewer.decision_picture import DecisionShown, draw_answer_map, enlarge
from gn0.viewer.episode_stage import EpisodeStage
from gn0.viewer.floor_plan import INK, MUTED, PAPER, font
from gn0.viewer.track_map import TrackMap

WIDTH, _GAP, _TILE = 1800, 20, 204
_TEXT = 88  # px below a tile
_COLUMNS = 8
MOST = 96  # decisions on a sheet of one episode
GOOD, BAD = (22, 130, 70), (190, 30, 45)


@dataclass(frozen=True, eq=False)
class WalkShown:
    """A whole walk.

    Attributes:
        episode: the task.
        steps: of the walk.
        experts: what the expert would have said at each decision's pose, by the decision's step.
        distances: walking distance to the goal [m] before each step and after the last; infinite
            where no way leads there.
        success: STOP within the radius.
    """

    episode: Episode
    steps: tuple[StepAsked, ...]
    experts: dict[int, ExpertSaid | None]
    distances: tuple[float, ...]
    success: bool

    @property
    def decisions(self) -> list[StepAsked]:
        """The steps at which something was asked."""
        return [step for step in self.steps if step.asked]

    @property
    def track(self) -> F64:
        """Where it went [T+1, 2] m."""
        poses = [step.pose for step in self.steps] + [self.steps[-1].after]
        return np.array([(pose.x, pose.y) for pose in poses])

    @property
    def end(self) -> Pose2D:
        """Where it ended."""
        return self.steps[-1].after

    @property
    def words(self) -> str:
        """How it went, in a line."""
        left, least = self.distances[-1], min(self.distances)
        stopped = self.steps[-1].action == Action.STOP
        hits = sum(step.collided for step in self.steps)
        metres = float(np.hypot(*np.diff(self.track, axis=0).T).sum())
        verdict = "success" if self.success else ("stopped too far" if stopped else "no STOP")
        near = "" if self.success else f", {least:.2f} m at best"
        return (
            f"{verdict}, {left:.2f} m from the goal{near}   ·   {len(self.steps)} steps, "
            f"{metres:.1f} m of {self.distances[0]:.1f} m   ·   {hits} cut short"
        )


def walk_episode(
    stage: EpisodeStage,
    episode: Episode,
    *,
    weighed: bool = False,
    progress: Progress = no_progress,
) -> WalkShown:
    """Walk an episode to its end, and ask the expert beside it.

    Raises:
        PolicyError, EpisodeError, ConfigError: see `walk_asked`.
    """
    simulator, _ = stage.open(episode)
    navigation = simulator.navigation
    field = navigation.geodesic(episode.destination)
    steps: list[StepAsked] = []
    experts: dict[int, ExpertSaid | None] = {}
    distances: list[float] = []
    for step in walk_asked(stage.policy, simulator, episode, weighed=weighed):
        progress("walking", len(steps), simulator.max_steps)
        if step.asked:
            experts[step.decision.step] = ask_expert(navigation, episode, step.pose)
        distances.append(float(field.distance_at(step.pose.x, step.pose.y)))
        steps.append(step)
    progress("walking", simulator.max_steps, simulator.max_steps)
    end = steps[-1]
    distances.append(float(field.distance_at(end.after.x, end.after.y)))
    within = episode.success_within(stage.suite.about.success_radius)
    success = end.action == Action.STOP and distances[-1] < within
    return WalkShown(episode, tuple(steps), experts, tuple(distances), success)


def render_walk(walk: WalkShown, stage: EpisodeStage) -> Image.Image:
    """All decisions of a walk, at most `MOST` of them, below the walk from above."""
    settings = stage.policy.questions.settings
    _, ground = stage.open(walk.episode)
    chosen = _spread(walk.decisions, MOST)
    left_out = len(walk.decisions) - len(chosen)
    head = _draw_head(walk, ground, f"{left_out} decisions are not shown" if left_out else "")
    return _stack([head, _draw_tiles(walk, settings, chosen)])


def render_walks(
    walks: Sequence[WalkShown], stage: EpisodeStage, title: str, notes: Sequence[str] = ()
) -> Image.Image:
    """Several walks one below the other, each from above with some of its decisions.

    Raises:
        ConfigError: there are none.
    """
    if not walks:
        raise ConfigError("no walks to draw", where="--from", remedy="choose another run")
    settings = stage.policy.questions.settings
    lines = [part for note in notes for part in wrap_text(note, WIDTH - 2 * _GAP, 16)]
    top = Image.new("RGB", (WIDTH, 70 + 22 * len(lines)), PAPER)
    pen = ImageDraw.Draw(top)
    pen.text((_GAP, 16), fit_line(title, WIDTH - 2 * _GAP, 28), INK, font(28))
    write_lines(pen, (_GAP, 58), lines, 16)
    parts = [top]
    for walk in walks:
        _, ground = stage.open(walk.episode)
        parts += [
            _draw_head(walk, ground),
            _draw_tiles(walk, settings, _spread(walk.decisions, _COLUMNS)),
        ]
    return _stack(parts)


def _spread(steps: Sequence[StepAsked], most: int) -> list[StepAsked]:
    """At most so many of them, spread evenly, the first and the last included."""
    if len(steps) <= most:
        return list(steps)
    return [steps[round(k)] for k in np.linspace(0, len(steps) - 1, most)]


def _stack(parts: Sequence[Image.Image]) -> Image.Image:
    sheet = Image.new("RGB", (WIDTH, sum(part.height for part in parts)), PAPER)
    top = 0
    for part in parts:
        sheet.paste(part, (0, top))
        top += part.height
    return sheet


def _draw_head(walk: WalkShown, ground: TrackMap, note: str = "") -> Image.Image:
    """The instruction, how it went, and the walk from above."""
    track = walk.track
    picture = ground.draw(
        track,
        walk.end,
        goals=walk.episode.goals,
        reference=np.array(walk.episode.path, np.float64).reshape(-1, 2),
    )
    part = Image.new("RGB", (WIDTH, picture.height + 2 * _GAP), PAPER)
    pen = ImageDraw.Draw(part)
    pen.line((_GAP, 2, WIDTH - _GAP, 2), FAINT, 2)
    part.paste(picture, (WIDTH - _GAP - picture.width, _GAP))
    room = WIDTH - picture.width - 3 * _GAP
    episode = walk.episode
    y = _GAP
    pen.text(
        (_GAP, y), fit_line(f"{episode.id}   ·   {episode.scene_id}", room, 18), MUTED, font(18)
    )
    y += 34
    text = f"“{' '.join(episode.instruction.split())}”"
    lines = wrap_text(text, room, 24, most=8)
    y += write_lines(pen, (_GAP, y), lines, 24, INK) + 14
    colour = GOOD if walk.success else BAD
    y += write_lines(pen, (_GAP, y), wrap_text(walk.words, room, 20), 20, colour) + 14
    agreed = _agreement(walk)
    y += write_lines(pen, (_GAP, y), wrap_text(agreed, room, 17), 17) + 8
    keys = "dark: the walk   ·   blue: the reference path   ·   green: start   ·   star: goal"
    write_lines(pen, (_GAP, y), [keys, *([note] if note else [])], 17)
    return part


def _agreement(walk: WalkShown) -> str:
    """On how many decisions policy and expert began alike, and where they first did not."""
    asked = [(step, walk.experts[step.decision.step]) for step in walk.decisions]
    known = [(step.decision, expert) for step, expert in asked if expert is not None]
    alike = [
        decision.actions is not None and decision.actions[0] == expert.actions[0]
        for decision, expert in known
    ]
    words = f"first action as the expert's in {sum(alike)} of {len(alike)} decisions"
    if False in alike:
        words += f", first not at step {known[alike.index(False)][0].step}"
    return words


def _draw_tiles(
    walk: WalkShown, settings: PolicySettings, chosen: Sequence[StepAsked]
) -> Image.Image:
    rows = -(-len(chosen) // _COLUMNS)
    part = Image.new("RGB", (WIDTH, rows * (_TILE + _TEXT + _GAP) + _GAP), PAPER)
    for number, step in enumerate(chosen):
        row, column = divmod(number, _COLUMNS)
        corner = (_GAP + column * (_TILE + _GAP), 4 + row * (_TILE + _TEXT + _GAP))
        _draw_tile(part, corner, walk, settings, step)
    return part


def _draw_tile(
    sheet: Image.Image,
    corner: tuple[int, int],
    walk: WalkShown,
    settings: PolicySettings,
    step: StepAsked,
) -> None:
    """A decision: its map with both ways, or what it saw, and both rows of actions."""
    decision = step.decision
    expert = walk.experts[decision.step]
    x, y = corner
    if settings.form.points:
        shown = DecisionShown(walk.episode, settings, decision, expert, np.zeros((0, 2)))
        picture = draw_answer_map(shown, _TILE)
    else:
        picture = enlarge(decision.pictures[0][1], _TILE)
        picture = picture.crop(_middle(picture.width))
    sheet.paste(picture, corner)
    pen = ImageDraw.Draw(sheet)
    own = decision.actions or ()
    theirs = expert.actions[: len(own) or 6] if expert is not None else ()
    alike = bool(own) and bool(theirs) and own[0] == theirs[0]
    if theirs:
        edge = GOOD if alike else BAD
        pen.rectangle((x - 3, y - 3, x + _TILE + 2, y + _TILE + 2), outline=edge, width=3)
    left = walk.distances[decision.step] if decision.step < len(walk.distances) else float("nan")
    line = f"step {decision.step}, {left:.2f} m to go"
    pen.text((x, y + _TILE + 5), line, INK, font(14))
    if decision.actions is None:
        pen.text((x, y + _TILE + 28), "unreadable", BAD, font(14))
    draw_actions(pen, (x, y + _TILE + 26), own, 24, SAID, executed=decision.executed)
    draw_actions(pen, (x, y + _TILE + 56), theirs, 24, EXPERT, executed=0)


def _middle(width: int) -> tuple[int, int, int, int]:
    left = max((width - _TILE) // 2, 0)
    return left, 0, left + _TILE, _TILE
