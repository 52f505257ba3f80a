"""An errand as a video and as a page: what the agent saw, where it went, and what it said."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup
from PIL import Image, ImageDraw

from gn0.bench.episode_clip import BATCH, render_eyes
from gn0.bench.report_maps import data_uri
from gn0.geometry import U8
from gn0.missions.episode import Episode
from gn0.policies.bae.decision import StepAsked
from gn0.policies.bae.errand import ErrandEnd
from gn0.policies.bae.policy_settings import PolicySettings
from gn0.progress import Progress, no_progress
from gn0.render.renderer import Renderer
from gn0.render.video import VP9, VideoWriter
from gn0.sim.simulator import Simulator
from gn0.viewer.action_marks import SAID, WORDS, draw_actions, fit_line, wrap_text, write_lines
from gn0.viewer.decision_picture import DecisionShown, draw_answer_map
from gn0.viewer.floor_plan import INK, MUTED, PAPER, font
from gn0.viewer.track_map import TrackMap, fit_map

HEIGHT = 380  # px of view and maps
FRAMES_PER_SECOND = 6
_CAPTION, _GAP, _QUALITY, _HELD = 150, 10, 34, 2
_BROAD = 520  # px: width of the map at most
TEMPLATES = Path(__file__).parent / "templates"


def encode_film(
    simulator: Simulator,
    renderer: Renderer,
    settings: PolicySettings,
    episode: Episode,
    steps: Sequence[StepAsked],
    end: ErrandEnd,
    *,
    progress: Progress = no_progress,
) -> tuple[bytes, Image.Image]:
    """A walk as VP9 in MP4, a frame a step, and its last frame.

    Args:
        simulator: that was walked in.
        renderer: of its scene.
        settings: of the checkpoint.
        episode: the errand.
        steps: of the walk.
        end: how it ended.
        progress: progress sink.

    Raises:
        RenderError: this PyAV has no VP9.
    """
    width, _ = fit_map(simulator.scene, _BROAD, HEIGHT)
    ground = TrackMap(simulator.scene, renderer, width, HEIGHT)
    poses = [step.pose for step in steps] + [steps[-1].after]
    track = np.array([(pose.x, pose.y) for pose in poses])
    maps: dict[int, Image.Image] = {}
    writer: VideoWriter | None = None
    frame = Image.new("RGB", (2, 2))
    for number, view in enumerate(_look(simulator, renderer, poses)):
        progress("filming", number, len(poses))
        step = steps[min(number, len(steps) - 1)]
        decision = step.decision
        if settings.form.points and decision.step not in maps:
            shown = DecisionShown(episode, settings, decision, None, track[:0])
            maps = {decision.step: draw_answer_map(shown, HEIGHT)}
        tiles = [Image.fromarray(view), *maps.values()]
        tiles.append(ground.draw(track[: number + 1], poses[number]))
        last = number == len(steps)
        frame = _compose(tiles, episode.instruction, step, number, end if last else None)
        if writer is None:
            writer = VideoWriter(frame.size, _QUALITY, FRAMES_PER_SECOND, VP9)
        for _ in range(1 + (FRAMES_PER_SECOND * _HELD if last else 0)):
            writer.add(np.asarray(frame))
    progress("filming", len(poses), len(poses))
    assert writer is not None
    return writer.finish(), frame


def _look(simulator: Simulator, renderer: Renderer, poses: Sequence[tuple]) -> Iterator[U8]:
    height = simulator.agent.camera_height
    for begin in range(0, len(poses), BATCH):
        some = poses[begin : begin + BATCH]
        yield from render_eyes(renderer, simulator.config.preset, height, some, HEIGHT)


def _compose(
    tiles: Sequence[Image.Image], words: str, step: StepAsked, number: int, end: ErrandEnd | None
) -> Image.Image:
    width = sum(tile.width for tile in tiles) + _GAP * (len(tiles) - 1)
    width += width % 2
    frame = Image.new("RGB", (width, HEIGHT + _CAPTION), PAPER)
    x = 0
    for tile in tiles:
        frame.paste(tile, (x, 0))
        x += tile.width + _GAP
    pen = ImageDraw.Draw(frame)
    y = HEIGHT + 8
    pen.text((12, y), fit_line(f"“{words}”", width - 24, 22), INK, font(22))
    y += 32
    if end is not None:
        write_lines(pen, (12, y), [fit_line(line, width - 24, 18) for line in end.lines], 18, INK)
        return frame
    decision = step.decision
    hit = ", cut short by an obstacle" if step.collided else ""
    line = f"step {number}: {WORDS[step.action]}{hit}"
    pen.text((12, y), line, INK, font(18))
    y += 27
    own = decision.actions or ()
    draw_actions(pen, (12, y), own, 30, SAID, executed=decision.executed)
    done = number - decision.step
    if own:  # which of them this step is
        left = 12 + done * 35
        pen.rectangle((left, y + 33, left + 30, y + 36), INK)
    x = 12 + 35 * max(len(own), 1) + 16
    told = []
    if decision.actions is None:
        told.append("an unreadable answer")
    if decision.confidence is not None:
        shares = decision.confidence.first
        order = sorted(range(4), key=lambda code: -shares[code])
        told.append(", ".join(f"{WORDS[code]} {shares[code]:.0%}" for code in order))
    write_lines(pen, (x, y + 4), told, 16, INK)
    lines = wrap_text(decision.answer, width - 24, 12, most=2)
    write_lines(pen, (12, y + 44), lines, 12, MUTED)
    return frame


def render_page(
    episode: Episode,
    steps: Sequence[StepAsked],
    end: ErrandEnd,
    mp4: bytes,
    facts: Sequence[tuple[str, str]],
) -> str:
    """The page of an errand: one HTML file with its video, which opens from disk."""
    style = (TEMPLATES / "errand.css").read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("errand.html").render(
        style=Markup(style),  # noqa: S704 (our own file, byte for byte what the hash covers)
        content_policy=f"default-src 'none'; media-src data:; style-src 'sha256-{digest}'; "
        "base-uri 'none'; form-action 'none'",
        words=episode.instruction,
        lines=end.lines,
        facts=facts,
        video=data_uri(mp4, "video/mp4"),
        prompt=steps[0].decision.prompt,
        rows=[
            {
                "step": step.decision.step,
                "place": f"{step.pose.x:.2f}, {step.pose.y:.2f}",
                "said": " ".join(WORDS[code] for code in step.decision.actions)
                if step.decision.actions is not None
                else "unreadable",
                "sure": f"{max(step.decision.confidence.first):.0%}"
                if step.decision.confidence is not None
                else "",
                "answer": step.decision.answer,
            }
            for step in steps
            if step.asked
        ],
    )
