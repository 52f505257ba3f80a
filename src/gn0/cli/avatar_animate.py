"""Let an avatar move: a clip of the library or a file of motion, as poses, splats and a video."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 avatar animate out/bank --name p0003 --motion walk --out out/walk
  gn0 avatar animate out/bank --name p0003 --motion sit_down --out out/sits
  gn0 avatar animate out/bank/p0003.npz --motion dance.bvh --seconds 8 --ply --out out/dance"""

DEFAULT_SPEED, DEFAULT_SEAT = 1.0, 0.45  # m/s, m
SEATED = ("sit", "sit_down", "stand_up")


class Args(Config, frozen=True):
    """Who moves, how, and where to write it.

    Attributes:
        source: a bank, or the file of one avatar.
        motion: a clip of the library (walk, run, idle_1, wave, sit, …), or a file of motion.
        out: folder to write smplx.json, the video and splats into.
        name: the avatar of the bank; the first without it.
        speed: of walk, carry, start and stop, in metres a second; the nearest of six classes is
            taken.
        seconds: how long; a loop goes on for as long, other clips end before; 0 takes all of it.
        fps: frames a second of what is written.
        seed: how the person moves: style of steps, arms and gestures.
        seat: height of the seat of sit, sit_down and stand_up, in metres.
        ply: write the posed splats of each frame too.
    """

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="BANK")]
    motion: str
    out: str
    name: str = ""
    speed: Annotated[float, msgspec.Meta(ge=0.2, le=2.0)] = DEFAULT_SPEED
    seconds: Annotated[float, msgspec.Meta(ge=0.0, le=600.0)] = 0.0
    fps: Annotated[int, msgspec.Meta(ge=5, le=120)] = 30
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    seat: Annotated[float, msgspec.Meta(ge=0.3, le=0.65)] = DEFAULT_SEAT
    ply: bool = False


def find_stale_frames(out: Path, count: int) -> list[str]:
    """Names of the frames in a folder that so many new ones would leave there."""
    found = [path.stem[5:] for path in out.glob("frame[0-9]*.ply")]
    return [
        f"frame{digits}.ply"
        for digits in sorted(found)
        if re.fullmatch("[0-9]{5,9}", digits) and int(digits) > count
    ]


def run(args: Args) -> int:
    """Pose, draw and write; say what was made."""
    from gn0.avatars.bank import open_avatars
    from gn0.avatars.held import hold_thing
    from gn0.avatars.motion.legs import measure_build
    from gn0.avatars.motion.lhm import save_lhm_document
    from gn0.avatars.motion.library import CLIPS, ClipLibrary
    from gn0.avatars.motion.open_motion import load_motion
    from gn0.avatars.motion.play import play_motion
    from gn0.avatars.motion.retarget import put_on_floor
    from gn0.cli.console import draw_progress
    from gn0.errors import ConfigError, StorageError
    from gn0.gaussians.ply import save_ply
    from gn0.storage import check_replaceable, check_writable
    from gn0.viewer.avatar_film import write_film

    if args.motion not in CLIPS and not (args.motion and Path(args.motion).exists()):
        raise ConfigError(
            f"{args.motion!r} is neither a clip of the library nor a file",
            where="--motion",
            remedy=f"clips are {', '.join(CLIPS)}",
        )
    _check_together(args)
    (avatar,) = open_avatars(args.source, args.name, first=True)
    if args.motion in CLIPS:
        build = measure_build(avatar.joints, avatar.points, avatar.weights)
        motion = ClipLibrary(build, args.seed, args.seat).motion(args.motion, args.speed)
        avatar = hold_thing(avatar, args.motion)
    else:
        motion = put_on_floor(load_motion(args.motion, avatar.joints), avatar.joints)
    played = play_motion(motion, args.fps, args.seconds)
    out = Path(args.out)
    check_replaceable(out, overwrite=True, marker="smplx.json")  # what no animation left is kept
    check_writable(out / "smplx.json")
    stale = find_stale_frames(out, len(played) if args.ply else 0)
    if stale:
        raise StorageError(
            f"holds frames of another animation ({stale[0]} to {stale[-1]}), which would stay "
            "beside this one's",
            where=out,
            remedy="choose another --out, or remove them",
        )
    save_lhm_document(out / "smplx.json", played, avatar.betas, avatar.shape_space, avatar.joints)
    with draw_progress() as progress:
        if args.ply:
            for k in range(len(played)):
                progress("writing splats", k, len(played))
                cloud = avatar.pose(played.poses[k], played.shift[k])
                save_ply(cloud, out / f"frame{k + 1:05d}.ply")
            progress("writing splats", len(played), len(played))
        stem = args.motion if args.motion in CLIPS else Path(args.motion).stem
        film = write_film(avatar, played, out, stem, progress=progress)
    way = played.shift[-1] - played.shift[0]
    print(f"{avatar.name}: {motion.name or stem}, {len(played)} frames at {played.fps:g} a second")
    if motion.loop and motion.displacement is not None:
        print(f"stride  {motion.displacement[-1]:.2f} m")
    print(f"goes    {float((way[0] ** 2 + way[2] ** 2) ** 0.5):.2f} m")
    for note in motion.notes:
        print(f"note    {note}")
    print(f"written to {out}: smplx.json, {film.name}" + (", frame00001.ply …" if args.ply else ""))
    return 0


def _check_together(args: Args) -> None:
    """Refuse what the motion has no use for.

    Raises:
        ConfigError: it is given all the same.
    """
    from gn0.avatars.motion.library import BY_SPEED
    from gn0.errors import ConfigError

    for flag, given, clips in (
        ("--speed", args.speed != DEFAULT_SPEED, sorted(BY_SPEED)),
        ("--seat", args.seat != DEFAULT_SEAT, sorted(SEATED)),
    ):
        if given and args.motion not in clips:
            raise ConfigError(
                f"{flag} is of {', '.join(clips)}",
                where=f"--motion {args.motion}",
                remedy="leave it out",
            )
