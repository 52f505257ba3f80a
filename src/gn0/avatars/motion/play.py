"""A motion as it is played: at one rate, for so long, its way gone put into the shift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.avatars.motion.cycles import walk_cycle
from gn0.avatars.motion.motion import FPS_RANGE, Motion, resample, sample
from gn0.errors import DataError

_CYCLES = 2  # of a loop, where no time is asked for


def play_motion(motion: Motion, fps: float, seconds: float = 0.0) -> Motion:
    """The frames of a motion at a rate; a loop goes on for as long as is asked.

    Args:
        motion: a loop with a way goes along +z at its own speed.
        fps: frames a second, 1 to 1000.
        seconds: how long; 0 takes all, of a loop two rounds.

    Raises:
        DataError: a rate out of range, or fewer than two frames left.
    """
    if not FPS_RANGE[0] <= fps <= FPS_RANGE[1]:
        raise DataError(f"{fps} frames a second are out of 1 to 1000", where="play")
    whole = motion.seconds * (_CYCLES if motion.loop else 1)
    lasts = seconds if seconds and (motion.loop or seconds < whole) else whole
    count = int(lasts * fps + 1e-6) + 1
    if count < 2:
        raise DataError(
            f"{lasts:g} s at {fps:g} frames a second is one frame, which does not move",
            where="play",
            remedy="take longer, or more frames a second",
        )
    t = np.arange(count) / fps
    way = motion.displacement
    if motion.loop and way is not None and way[-1] > 0:
        return replace(walk_cycle(motion, t * (way[-1] / motion.seconds), fps), contacts=None)
    if motion.loop:
        rounds = np.floor(t / motion.seconds + 1e-9)
        return replace(sample(motion, t - rounds * motion.seconds), fps=fps, loop=False)
    played = replace(resample(motion, fps), fps=fps)
    played = replace(
        played,
        poses=played.poses[:count],
        shift=played.shift[:count],
        displacement=None,
        contacts=None if played.contacts is None else played.contacts[:count],
    )
    if way is None:
        return played
    gone = np.interp(t[: len(played)], np.arange(len(way)) / motion.fps, way)
    return replace(played, shift=played.shift + gone[:, None] * [0.0, 0.0, 1.0])
