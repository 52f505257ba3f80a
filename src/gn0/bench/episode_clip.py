"""Clips of episodes: what the agent saw, and where it was, with captions burned in.

Encoded as VP9 in MP4, which a stock Chromium or Firefox plays without proprietary codecs. Views are
rendered again from the recorded poses, when a report is written and never during a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gn0.bench.follow_metrics import FollowMetrics
from gn0.bench.people_replay import PeopleReplay, PeopleThen
from gn0.bench.report_follow import tell_end
from gn0.bench.results import EpisodeResult, EpisodeTrace
from gn0.errors import RenderError
from gn0.geometry import F64, U8, view_from_pose
from gn0.missions.episode import Episode
from gn0.people.person import RADIUS
from gn0.progress import Progress, no_progress
from gn0.render.bev import BevPicture
from gn0.render.camera import Camera
from gn0.render.instance import Parts
from gn0.render.renderer import SceneRenderer
from gn0.render.video import VP9, encode_video
from gn0.sim.live_bev import draw_people
from gn0.sim.presets import CameraPreset

VIEW_HEIGHT = 252  # px of the view and of the map beside it
CAPTION, LINE = 46, 18  # px: below the view where the instruction is one line; each line more
MOST_LINES = 3  # of an instruction
FRAMES_PER_SECOND = 8
MOST_FRAMES = 64
CLIP_LIMIT = 1_500_000  # bytes
QUALITIES = (34, 42, 50, 58, 63)  # crf, tried in turn until a clip fits
BATCH = 8  # views rendered in one call

INK, PAPER, MUTED = (238, 240, 243), (18, 21, 26), (150, 158, 170)
GOOD, BAD, TRAIL, PLAN = (80, 200, 130), (240, 110, 90), (255, 176, 59), (140, 190, 255)
_Font = ImageFont.FreeTypeFont | ImageFont.ImageFont
ACTION_WORDS = {-1: "teleport", 0: "stop", 1: "forward", 2: "turn left", 3: "turn right"}


@dataclass(frozen=True)
class Clip:
    """A finished clip.

    Attributes:
        mp4: VP9 in MP4.
        poster: one frame of it [H, W, 3], to be shown before it plays.
    """

    mp4: bytes
    poster: U8


@dataclass(frozen=True)
class ClipScene:
    """What clips of one scene share.

    Attributes:
        renderer: renderer of the scene's splats.
        bev: the map picture.
        preset: the agent's eyes.
        camera_height: eye above the floor [m].
        people: plays the people of an episode again; None where they are not shown.
    """

    renderer: SceneRenderer
    bev: BevPicture
    preset: CameraPreset
    camera_height: float
    people: PeopleReplay | None = None


def clip_camera(camera: Camera, height: int = VIEW_HEIGHT) -> Camera:
    """The agent's camera at the height of a clip [px], same field of view."""
    scale = height / camera.height
    width = max(2, round(camera.width * scale / 2) * 2)
    return Camera(
        width=width,
        height=height,
        fx=camera.fx * width / camera.width,
        fy=camera.fy * scale,
        cx=camera.cx * width / camera.width,
        cy=camera.cy * scale,
        near=camera.near,
        far=camera.far,
    )


def choose_frames(count: int, most: int = MOST_FRAMES) -> list[int]:
    """Indices of poses to show: all, or `most` spread evenly, first and last included."""
    if count <= most:
        return list(range(count))
    return sorted({round(i * (count - 1) / (most - 1)) for i in range(most)})


def render_clip(
    scene: ClipScene,
    episode: Episode,
    result: EpisodeResult,
    trace: EpisodeTrace,
    *,
    title: str,
    size_limit: int = CLIP_LIMIT,
    most_frames: int = MOST_FRAMES,
    progress: Progress = no_progress,
) -> Clip:
    """A clip of an episode.

    Args:
        scene: renderer, map and eyes.
        episode: instruction, goal and reference path.
        result: the outcome, for the last caption.
        trace: recorded poses.
        title: name of the policy.
        size_limit: a larger clip is encoded again at lower quality [bytes].
        most_frames: longer episodes are shown in fewer, evenly spaced frames.
        progress: told of people who are built and of frames; each may take seconds.

    Raises:
        RenderError: no pose was recorded, or the clip does not fit the limit.
    """
    if not trace.poses:
        raise RenderError(f"episode {episode.id!r} has no poses to show")
    indices = choose_frames(len(trace.poses), most_frames)
    poses = [trace.poses[i] for i in indices]
    views, there = [], []
    if scene.people is None or not episode.people:
        views = render_eyes(scene.renderer, scene.preset, scene.camera_height, poses)
    else:
        scene.people.cast(episode, progress)
        focal = clip_camera(scene.preset.rgb).fx
        shown = scene.people.play(episode, trace, indices, focal)
        for number, (pose, people) in enumerate(zip(poses, shown, strict=True)):
            progress("frames of a clip", number, len(poses))
            there.append(people)
            views += render_eyes(
                scene.renderer, scene.preset, scene.camera_height, [pose], parts=people.parts
            )
        progress("frames of a clip", len(poses), len(poses))
    backdrop = _MapPainter(scene.bev, episode, np.array(trace.poses)[:, :2])
    touched = {} if isinstance(trace.touches, msgspec.UnsetType) else dict(trace.touches)
    hits = {k: "a person" if k in touched else "an obstacle" for k in trace.collided}
    frames = []
    for number, (index, view) in enumerate(zip(indices, views, strict=True)):
        over = index == len(trace.poses) - 1
        frames.append(
            _compose(
                view,
                backdrop.paint(index, trace.poses[index][2], there[number] if there else None),
                title,
                episode.instruction,
                _caption(index, trace, hits, result if over else None),
                _colour(result) if over else MUTED,
            )
        )
    poster = frames[len(frames) * 3 // 5]  # the start is often a wall, the end a close-up
    frames += [frames[-1]] * FRAMES_PER_SECOND  # hold the end for a second
    for quality in QUALITIES:
        data = encode_video(frames, quality, FRAMES_PER_SECOND, VP9)
        if len(data) <= size_limit:
            return Clip(data, poster)
    raise RenderError(
        f"the clip of episode {episode.id!r} has {len(data)} bytes at the lowest quality",
        remedy=f"allow more than {size_limit} bytes",
    )


def render_eyes(
    renderer: SceneRenderer,
    preset: CameraPreset,
    camera_height: float,
    poses: Sequence[tuple[float, float, float]],
    height: int = VIEW_HEIGHT,
    *,
    parts: Parts = (),
) -> list[U8]:
    """What the agent's camera sees from each pose x, y [m], yaw [rad]: uint8 [height, W, 3].

    Args:
        renderer: of the scene's splats.
        preset: the agent's eyes.
        camera_height: eye above the floor [m].
        poses: from where.
        height: of the pictures [px]; their width follows.
        parts: people, and whatever else is there in all of them.
    """
    camera = clip_camera(preset.rgb, height)
    pitch = float(np.radians(preset.pitch_degrees))
    views = np.stack([view_from_pose(x, y, camera_height, yaw, pitch) for x, y, yaw in poses])
    pictures: list[U8] = []
    more: dict[str, Any] = {"parts": parts} if parts else {}
    for begin in range(0, len(views), BATCH):
        result = renderer.render(
            camera,
            views[begin : begin + BATCH],
            outputs=("rgb",),
            background=preset.background,
            **more,
        )
        assert result.rgb is not None
        pictures += [np.asarray(picture, np.uint8) for picture in result.rgb]
    return pictures


def _caption(
    index: int, trace: EpisodeTrace, hits: dict[int, str], result: EpisodeResult | None
) -> str:
    """What happened last; `hits` say what cut actions short."""
    text = f"step {index} of {len(trace.actions)}"
    if index > 0:
        text += f" · {ACTION_WORDS.get(trace.actions[index - 1], '?')}"
        if index - 1 in hits:
            text += f" (cut short by {hits[index - 1]})"
    if result is not None and isinstance(result.follow, FollowMetrics):
        follow = result.follow
        verdict = "success" if follow.success else tell_end(follow.end, False)
        text += f" · {verdict}, followed {follow.following_rate:.0%}"
    elif result is not None and result.metrics is not None:
        m = result.metrics
        verdict = "success" if m.success else ("stopped too far" if result.stopped else "no stop")
        text += f" · {verdict}, {m.navigation_error_geodesic:.2f} m from the goal"
    return text


def _colour(result: EpisodeResult) -> tuple[int, int, int]:
    return GOOD if result.success else BAD


class _MapPainter:
    """The BEV with reference and goal, painted once; the trail grows frame by frame."""

    def __init__(self, bev: BevPicture, episode: Episode, positions: F64) -> None:
        picture = Image.fromarray(np.array(bev.rgb))
        scale = VIEW_HEIGHT / picture.height
        width = max(2, round(picture.width * scale / 2) * 2)
        if width > 420:  # a long flat: fit the width instead and centre it
            scale = 420 / picture.width
            width = 420
        small = picture.resize((width, max(1, round(picture.height * scale))), Image.Resampling.BOX)
        self._canvas = Image.new("RGB", (width, VIEW_HEIGHT), PAPER)
        self._top, self._high = (VIEW_HEIGHT - small.height) // 2, small.height
        self._canvas.paste(small, (0, self._top))
        self._scale = np.array([width / picture.width, small.height / picture.height])
        self._bev, self._spots = bev, self._place(bev, positions)
        draw = ImageDraw.Draw(self._canvas)
        reference = self._place(bev, np.array(episode.path, np.float64).reshape(-1, 2))
        draw.line([tuple(p) for p in reference], fill=PLAN, width=1)
        x, y = self._place(bev, np.array([episode.goal]))[0]
        if episode.followed is not None:
            return  # the person itself is shown
        draw.ellipse((x - 5, y - 5, x + 5, y + 5), outline=PAPER, fill=GOOD)

    def _place(self, bev: BevPicture, points: F64) -> F64:
        return bev.pixel_from_world(points) * self._scale + (0, self._top)

    def paint(self, index: int, yaw: float, people: PeopleThen | None = None) -> U8:
        """The map with the trail up to a pose, an arrow at it, and where people are."""
        picture = self._canvas.copy()
        draw = ImageDraw.Draw(picture)
        if index > 0:
            draw.line([tuple(p) for p in self._spots[: index + 1]], fill=TRAIL, width=2)
        if people is not None:
            picture = self._show_people(picture, people)
            draw = ImageDraw.Draw(picture)
        x, y = self._spots[index]
        turn = yaw + np.array([0.0, 2.5, -2.5])
        corners = [
            (x + r * np.cos(a), y - r * np.sin(a)) for a, r in zip(turn, (9, 7, 7), strict=True)
        ]
        draw.polygon(corners, fill=TRAIL, outline=PAPER)
        return np.asarray(picture)

    def _show_people(self, picture: Image.Image, people: PeopleThen) -> Image.Image:
        """The map with people as the sensor `bev_live` draws them, at the size of a clip."""
        drawn, scale = np.array(picture), self._bev.metres_per_pixel / self._scale[0]
        (x0, y0), below = self._bev.origin, VIEW_HEIGHT - self._top - self._high
        corner = x0, y0 - below * scale
        draw_people(drawn, corner, scale, people.places, people.faces, RADIUS, people.target)
        return Image.fromarray(drawn)


def _compose(
    view: U8, plan: U8, title: str, instruction: str, caption: str, colour: tuple[int, int, int]
) -> U8:
    width = view.shape[1] + plan.shape[1]
    large, small = ImageFont.load_default(14), ImageFont.load_default(12)
    lines = _wrap(instruction, large, width - 16)
    below = VIEW_HEIGHT + LINE * (len(lines) - 1)
    picture = Image.new("RGB", (width, below + CAPTION), PAPER)
    picture.paste(Image.fromarray(np.ascontiguousarray(view)), (0, 0))
    picture.paste(Image.fromarray(plan), (view.shape[1], 0))
    draw = ImageDraw.Draw(picture)
    for number, line in enumerate(lines):
        draw.text((8, VIEW_HEIGHT + 5 + LINE * number), line, INK, large)
    draw.text((8, below + 25), _fit(f"{title} · {caption}", small, width - 16), colour, small)
    return np.asarray(picture)


def _wrap(text: str, font: _Font, width: int) -> list[str]:
    """Text on as many lines as it needs, `MOST_LINES` at most, the last cut where it is longer."""
    words, lines = text.split(), [""]
    for number, word in enumerate(words):
        longer = f"{lines[-1]} {word}".strip()
        if font.getlength(longer) <= width or not lines[-1]:
            lines[-1] = longer
        elif len(lines) < MOST_LINES:
            lines.append(word)
        else:
            lines[-1] = " ".join([lines[-1], *words[number:]])
            break
    return [_fit(line, font, width) for line in lines]


def _fit(text: str, font: _Font, width: int) -> str:
    """Text on one line, cut with an ellipsis where it is too long [px]."""
    line = " ".join(text.split())[:400]
    if font.getlength(line) <= width:
        return line
    while line and font.getlength(line + "…") > width:
        line = line[:-1]
    return line + "…"
