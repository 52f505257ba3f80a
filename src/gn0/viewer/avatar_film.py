"""A short video of an avatar that moves; a strip of pictures where no video can be encoded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from gn0.avatars.avatar import TO_WORLD, Avatar
from gn0.avatars.layer import PARTS
from gn0.avatars.motion.feet import move_joints
from gn0.avatars.motion.motion import Motion
from gn0.errors import RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud, join_clouds
from gn0.gaussians.film import encode_srgb
from gn0.geometry import F64, U8
from gn0.progress import Progress, no_progress
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.renderer import RenderOptions
from gn0.render.video import VP9, encode_video
from gn0.storage import write_atomic, write_bytes
from gn0.viewer.avatar_seat import SITTING, find_height, place_seat
from gn0.viewer.avatar_sheet import PAPER, view_person

SIZE = (320, 360)  # px
STRIP = 8  # pictures
_SECONDS = 20.0  # of a motion that are filmed
_QUALITY = 34  # constant rate factor
_FAR, _EYE, _AIM, _SLOPE, _TURN = 4.4, 1.25, 0.90, 30.0, 1.15
_TILE = 0.5  # m between marks on the floor


def film_motion(
    avatar: Avatar,
    motion: Motion,
    frames: list[int] | None = None,
    *,
    turn: float = _TURN,
    progress: Progress = no_progress,
) -> list[U8]:
    """Pictures [360, 320, 3] of a motion; the camera goes with the person, past marks on the floor.

    Args:
        avatar: who moves.
        motion: for its joints, the way in its shift.
        frames: which; all by default.
        turn: from where it is seen [rad], 0 its front.
        progress: progress sink.
    """
    wanted = list(range(len(motion))) if frames is None else frames
    _, placed = move_joints(motion, avatar.joints)
    at = _follow(placed[:, 0] @ TO_WORLD.T, motion.fps)
    pelvis = placed[:, 0] @ TO_WORLD.T
    seat = []
    if motion.category in SITTING:
        lowest = pelvis[np.argmin(pelvis[:, 2])]
        seat = [place_seat(lowest, find_height(avatar, lowest[2]))]
    camera = Camera.from_vfov(*SIZE, _SLOPE)
    options = RenderOptions(background=tuple(c / 255 for c in PAPER))  # type: ignore[arg-type]
    pictures = []
    for number, k in enumerate(wanted):
        progress("drawing", number, len(wanted))
        cloud = join_clouds([avatar.pose(motion.poses[k], motion.shift[k]), *seat])
        view = view_person(turn, _FAR, _EYE, _AIM)
        view[:3, 3] -= view[:3, :2] @ at[k, :2]
        drawn = RendererCpu(join_clouds([cloud, floor_marks(at[k])]), options).render(
            camera, view[None], outputs=("rgb",)
        )
        assert drawn.rgb is not None
        pictures.append(drawn.rgb[0])
    progress("drawing", len(wanted), len(wanted))
    return pictures


def _follow(pelvis: F64, fps: float) -> F64:
    """Where the camera is [T, 3] m: with the pelvis, without its sway."""
    half = min(max(1, round(0.4 * fps)), max(len(pelvis) - 1, 1))
    # beyond its ends the way goes on as it went
    before = 2 * pelvis[0] - pelvis[half:0:-1]
    after = 2 * pelvis[-1] - pelvis[-2 : -half - 2 : -1]
    padded = np.concatenate([before, pelvis, after])
    window = np.ones(2 * half + 1) / (2 * half + 1)
    return np.stack([np.convolve(padded[:, k], window, "valid") for k in range(3)], axis=1)


def floor_marks(at: F64, reach: int = 4) -> GaussianCloud:
    """Flat grey discs every half metre on the floor about a place [3] m, in GN0's axes."""
    steps = np.arange(-reach, reach + 1) * _TILE
    x, y = np.meshgrid(*(np.round(at[k] / _TILE) * _TILE + steps for k in (0, 1)))
    means = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.001)], axis=1)
    count = len(means)
    grey = np.full((count, 3), 0.25, np.float32)
    return GaussianCloud(
        means=means.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.tile(np.array([0.012, 0.012, 0.0005], np.float32), (count, 1)),
        opacities=np.full(count, 0.9, np.float32),
        sh=((encode_srgb(grey) - np.float32(0.5)) / np.float32(SH_C0))[:, None, :],
        label=np.full(count, PARTS.index("shadow"), np.int32),
        albedo=grey,
        normal=np.tile(np.array([0, 0, 1], np.float32), (count, 1)),
    )


def write_film(
    avatar: Avatar, motion: Motion, folder: Path, stem: str, *, progress: Progress = no_progress
) -> Path:
    """Write STEM.mp4, of at most 20 s, or frames.png where this machine encodes no video.

    Raises:
        StorageError: the file cannot be written.
    """
    last = min(len(motion), max(2, int(_SECONDS * motion.fps)))
    pictures = film_motion(avatar, motion, list(range(last)), progress=progress)
    try:
        data = encode_video(pictures, _QUALITY, round(motion.fps), VP9)
    except (RenderError, ImportError):
        strip = draw_strip(pictures)
        path = folder / "frames.png"
        write_atomic(path, lambda stream: strip.save(stream, "PNG"))
        return path
    path = folder / f"{stem}.mp4"
    write_bytes(path, data)
    return path


def draw_strip(pictures: list[U8], count: int = STRIP) -> Image.Image:
    """Some pictures of a film, evenly spread, side by side."""
    rows = np.unique(np.linspace(0, len(pictures) - 1, count).round().astype(int))
    return Image.fromarray(np.concatenate([pictures[k] for k in rows], axis=1))
