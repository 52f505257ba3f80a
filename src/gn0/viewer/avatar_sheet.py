"""A page of a bank of avatars: each from the front and from behind, with what is said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gn0.avatars.avatar import Avatar
from gn0.avatars.poses import standing_pose, trial_poses
from gn0.avatars.skeleton import INDEX
from gn0.avatars.wardrobe import BOTTOMS, HAIR, SHOES, TOPS
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64, U8
from gn0.missions.language.person_nouns import garment_word, pattern_word, say_garment, say_hair
from gn0.progress import Progress, no_progress
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.renderer import RenderOptions
from gn0.viewer.avatar_seat import seat_person

WIDTH, HEIGHT, FOOT, COLUMNS = 110, 230, 40, 8  # px of a picture, of its words; people a row
INK, SOFT, PAPER = (24, 26, 30), (110, 114, 122), (222, 222, 220)
_EYE, _AIM, _FAR = 1.35, 0.93, 4.4  # height of the eye and what it looks at, distance [m]
_TURNS = (0.35, 3.5)  # from where a person is seen [rad]
_SLOPE = 28.0  # field of view [degrees]

_CUTS = {"top": frozenset(TOPS), "bottom": frozenset(BOTTOMS), "shoes": frozenset(SHOES)}


def draw_avatars(
    avatars: Sequence[Avatar],
    poses: Sequence[F64 | None] | None = None,
    *,
    columns: int = COLUMNS,
    progress: Progress = no_progress,
) -> Image.Image:
    """A tile a person: front and back side by side, its clothes in words below.

    Args:
        avatars: who is drawn.
        poses: of each [55, 3] rad; standing with arms lowered without them.
        columns: people a row.
        progress: progress sink.
    """
    columns = min(columns, max(len(avatars), 1))
    rows = -(-len(avatars) // columns)
    wide = WIDTH * len(_TURNS)
    sheet = Image.new("RGB", (columns * wide, max(rows, 1) * (HEIGHT + FOOT)), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(10)
    for number, avatar in enumerate(avatars):
        progress("drawing", number, len(avatars))
        pose = standing_pose() if poses is None else poses[number]
        left, top = number % columns * wide, number // columns * (HEIGHT + FOOT)
        for k, picture in enumerate(draw_avatar(avatar, pose, _TURNS)):
            sheet.paste(Image.fromarray(picture), (left + k * WIDTH, top))
        for line, text in enumerate(describe_avatar(avatar)):
            draw.text((left + 5, top + HEIGHT + 1 + 12 * line), text, SOFT if line else INK, font)
    progress("drawing", len(avatars), len(avatars))
    return sheet


def describe_avatar(avatar: Avatar) -> tuple[str, str, str]:
    """Name and three short lines of what can be seen."""
    r = avatar.record
    if "sex" not in r:  # not drawn from a seed: a mesh's record says how it was read
        return (avatar.name, f"{len(avatar):,} splats", avatar.source[:36])

    def worn(what: str) -> str:
        pattern = r.get(f"{what}_pattern", "plain")
        told = "" if pattern == "plain" else pattern_word(pattern)
        return say_garment(name_word(r, what), r.get(f"{what}_colour", ""), told)

    extra = "" if r.get("extra", "none") == "none" else f" + {r['extra_colour']} {r['extra']}"
    return (
        f"{avatar.name} {r.get('age', '')} {r.get('sex', '')}, {r.get('build', '')} build",
        worn("top") + extra,
        "" if r.get("bottom") == "none" else worn("bottom"),
    )


def list_record(record: Mapping[str, str]) -> list[tuple[str, str]]:
    """A record as lines of key and value, with English words behind cuts that are called else."""
    lines = []
    for key, value in record.items():
        word = name_word(record, key) if value != "none" else value
        lines.append((key, value if word == value else f"{value} ({word})"))
    return lines


def name_word(record: Mapping[str, str], key: str) -> str:
    """What a cut of a record is called, as missions call it; a value that is no cut, itself."""
    value = record.get(key, "")
    if key == "hair" and value in HAIR:
        return say_hair(value)
    if value in _CUTS.get(key, frozenset()):
        return garment_word(key, value)
    return pattern_word(value) if key.endswith("_pattern") else value.replace("_", " ")


def draw_avatar(avatar: Avatar, pose: F64 | None, turns: Sequence[float]) -> list[U8]:
    """Pictures [HEIGHT, WIDTH, 3] of a person seen from angles `turns` [rad], 0 its front."""
    return draw_cloud(avatar.pose(pose), turns)


def draw_cloud(cloud: GaussianCloud, turns: Sequence[float]) -> list[U8]:
    """The same of a person who is posed already, with whatever stands beside it."""
    renderer = RendererCpu(cloud, _options())
    views = np.array([view_person(turn, _FAR) for turn in turns])
    result = renderer.render(Camera.from_vfov(WIDTH, HEIGHT, _SLOPE), views, outputs=("rgb",))
    assert result.rgb is not None
    return list(result.rgb)


def view_person(turn: float, distance: float, height: float = _EYE, aim: float = _AIM) -> F64:
    """View [4, 4] of a person at the origin, from an angle [rad], a distance and a height [m]."""
    eye = np.array([distance * np.cos(turn), distance * np.sin(turn), height])
    forward = np.array([0.0, 0.0, aim]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    view[:3, 3] = -view[:3, :3] @ eye
    return view


def draw_portrait(avatar: Avatar) -> Image.Image:
    """One person from four sides, in a stride and on a seat, and the face."""
    stand, stride, _ = trial_poses()
    cells = draw_avatar(avatar, stand, (0.0, 0.8, 1.6, 3.14))
    cells += draw_avatar(avatar, stride, (0.4,)) + draw_cloud(seat_person(avatar), (0.7,))
    sheet = Image.new("RGB", (len(cells) * WIDTH + 2 * HEIGHT, 2 * HEIGHT), PAPER)
    for number, cell in enumerate(cells):
        sheet.paste(Image.fromarray(cell), (number * WIDTH, HEIGHT // 2))
    head = float(avatar.joints[INDEX["head"], 1])
    near = view_person(0.35, 0.95, head + 0.12, head + 0.03)
    renderer = RendererCpu(avatar.pose(stand), _options())
    face = renderer.render(
        Camera.from_vfov(2 * HEIGHT, 2 * HEIGHT, 34.0), near[None], outputs=("rgb",)
    )
    assert face.rgb is not None
    sheet.paste(Image.fromarray(face.rgb[0]), (len(cells) * WIDTH, 0))
    return sheet


def _options() -> RenderOptions:
    return RenderOptions(background=tuple(c / 255 for c in PAPER))  # type: ignore[arg-type]
