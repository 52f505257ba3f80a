"""What is inside of people, so that nothing behind them shows through or between their clothes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from gn0.avatars import surfels
from gn0.avatars.avatar import Avatar
from gn0.avatars.identity import Identity, draw_people
from gn0.avatars.layer import PARTS
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.motion.library import ClipLibrary
from gn0.avatars.person import build_person
from gn0.avatars.poses import standing_pose
from gn0.avatars.skeleton import INDEX
from gn0.geometry import F64, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.renderer import RenderOptions
from gn0.viewer.avatar_check import measure_gaps

CAMERA = Camera.from_vfov(480, 360, 70.0)
PALE = Identity(seed=21, tone=1, hair="long01", hair_colour="black", top="turtleneck")
DRAWN = draw_people(7, 200)


def see_through(avatar: Avatar, distance: float) -> F64:
    """Share of what is behind that each pixel of a face shows, eye to eye at a distance [m].

    The half of a head that is away from the eye is taken off, so that a wall is all there is
    behind a face; a white wall and a black one tell how much of it comes through.
    """
    cloud = avatar.pose(standing_pose(), shadow=False)
    head = np.isin(avatar.weights.joint[:, 0], [INDEX["head"], INDEX["jaw"]])
    head &= avatar.part == PARTS.index("skin")
    middle = (cloud.means[head].min(axis=0) + cloud.means[head].max(axis=0)) / 2
    near = cloud.means[:, 0] > middle[0]
    face = replace(cloud, label=head.astype(np.int32)).select(near)
    view = view_from_pose(middle[0] + distance, middle[1], middle[2], np.pi)[None]
    drawn = [
        RendererCpu(face, RenderOptions(background=wall, rgb_float=True)).render(
            CAMERA, view, outputs=("rgb", "depth", "instance")
        )
        for wall in ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    ]
    white, black = (result.rgb for result in drawn)
    assert white is not None and black is not None and drawn[0].instance is not None
    assert drawn[0].depth is not None
    # not where it was cut
    here = (drawn[0].instance[0] == 2) & (drawn[0].depth[0] < distance - 0.03)
    here = ndimage.binary_erosion(here, iterations=2)
    shown: F64 = (white[0] - black[0])[here].mean(axis=1)
    return shown


def test_walls_and_hair_do_not_show_through_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    lined = build_person(PALE)
    far, near = see_through(lined, 1.5), see_through(lined, 0.5)
    assert len(far) > 200 and len(near) > 3000
    assert far.mean() < 0.0005 and near.mean() < 0.002
    assert np.quantile(near, 0.99) < 0.03
    monkeypatch.setattr(surfels, "line_layers", lambda *_: [])
    bare = build_person(PALE)
    assert len(lined) < 1.06 * len(bare)
    # about 0.001 and 0.03
    assert see_through(bare, 1.5).mean() > 2 * far.mean()
    assert see_through(bare, 0.5).mean() > 10 * near.mean()


@pytest.mark.parametrize(
    ("number", "clip", "shares", "where"),
    [
        (18, "run", (0.0, 0.4), "neck"),  # behind a collar, as the head bends
        (35, "run", (0.0,), "wrist"),  # into a sleeve
        (24, "sit_down", (0.8, 1.0), "wrist"),  # into a wide one
        (1, "sit_down", (0.6, 0.8), "waist"),  # between a sweater's hem and a skirt
    ],
)
def test_no_gap_opens_where_clothes_end(
    number: int, clip: str, shares: tuple[float, ...], where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    person = build_person(DRAWN[number])
    poses = _poses(person, clip, shares)
    gaps, lines = measure_gaps(person, poses)[where]
    assert gaps == 0 and lines > 20
    monkeypatch.setattr(surfels, "line_layers", lambda *_: [])
    assert measure_gaps(build_person(DRAWN[number]), poses)[where][0] > 0


def _poses(person: Avatar, clip: str, shares: tuple[float, ...]) -> list[F64]:
    library = ClipLibrary(measure_build(person.joints, person.points, person.weights))
    motion = library.motion(clip)
    return [motion.poses[int(share * (len(motion) - 1))] for share in shares]


def test_what_fills_a_sleeve_is_of_its_cloth() -> None:
    coat = Identity(seed=22, top="long_coat", top_colour="red", bottom="slim", tone=1)
    person = build_person(coat)
    wrist = person.joints[INDEX["left_wrist"]]
    elbow = person.joints[INDEX["left_elbow"]]
    away = np.linalg.norm((person.points - wrist)[:, 1:], axis=1)
    along = (person.points[:, 0] - elbow[0]) / (wrist[0] - elbow[0])
    inside = (along > 0.55) & (along < 0.85) & (away < 0.02)
    assert inside.sum() > 20
    assert (person.part[inside] == PARTS.index("top")).all()
