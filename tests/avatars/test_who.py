"""Who is who: person numbers of a picture, how much of each is seen, and where."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.avatars.poses import stride_pose
from gn0.errors import RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0.render.open import open_renderer
from gn0.render.renderer import Renderer
from gn0_trials.people_small import small_person

CAMERA = Camera.from_hfov(160, 160, 90.0)
VIEW = view_from_pose(0.0, 0.0, 1.2, 0.0)  # looks along +x


def panel(x: float, low: float, high: float, width: float = 4.0) -> GaussianCloud:
    """An opaque board across the view at distance x, from height `low` to `high`."""
    y, z = np.meshgrid(np.arange(-width / 2, width / 2, 0.04), np.arange(low, high, 0.04))
    n = y.size
    means = np.column_stack([np.full(n, x), y.ravel(), z.ravel()])
    return GaussianCloud(
        means=means.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        scales=np.tile(np.array([0.002, 0.04, 0.04], np.float32), (n, 1)),
        opacities=np.full(n, 0.99, np.float32),
        sh=np.full((n, 1, 3), -0.2 / SH_C0, np.float32),
    )


def stand(x: float, y: float, cloud: str = "person") -> Instance:
    pose = np.eye(4)
    pose[:2, :2], pose[:2, 3] = ((-1, 0), (0, -1)), (x, y)  # faces the camera
    return Instance(cloud, pose)


def scene(cloud: GaussianCloud) -> RendererCpu:
    renderer = RendererCpu(cloud)
    renderer.name_cloud("person", small_person().pose(stride_pose()))
    return renderer


def test_who_is_hidden_behind_a_wall_has_no_pixel() -> None:
    found = scene(panel(2.0, -1.0, 4.0, 12.0)).render_who(CAMERA, VIEW, parts=[stand(3.0, 0.0)])
    (seen,) = found.seen[0]
    assert not found.numbers.any()
    assert (seen.pixels, seen.share, seen.box) == (0, 0.0, None) and seen.whole > 300


def test_who_stands_behind_a_table_shows_above_it() -> None:
    found = scene(panel(2.0, 0.0, 0.8)).render_who(CAMERA, VIEW, parts=[stand(3.0, 0.0)])
    (seen,) = found.seen[0]
    assert 0.3 < seen.share < 0.8 and seen.box is not None
    left, top, right, bottom = seen.box
    inside = found.numbers[0, top:bottom, left:right]
    assert (inside == 1).sum() == seen.pixels == (found.numbers == 1).sum()
    # the edge of the table, 0.4 m below the eye at 2 m
    assert abs(bottom - (80 + 80 * 0.4 / 2.0)) <= 3


def test_who_is_nearer_hides_who_is_behind() -> None:
    people = [stand(4.0, 0.0), stand(2.0, 0.1), stand(3.0, -1.2)]
    found = scene(panel(6.0, 0.0, 3.0, 12.0)).render_who(CAMERA, VIEW, parts=people)
    far, near, aside = found.seen[0]
    assert [s.number for s in found.seen[0]] == [1, 2, 3]
    assert near.share > 0.97 and aside.share > 0.97 and far.share < 0.5
    assert far.whole < near.whole
    assert set(np.unique(found.numbers)) == {0, 1, 2, 3}


def test_who_is_out_of_view_has_no_pixels_and_neither_has_nobody() -> None:
    renderer = scene(panel(6.0, 0.0, 3.0))
    two = np.stack([VIEW, VIEW])
    found = renderer.render_who(CAMERA, two, parts=[[stand(-3.0, 0.0)], []])
    (seen,) = found.seen[0]
    assert (seen.pixels, seen.whole, seen.share, seen.box) == (0, 0, 0.0, None)
    assert found.seen[1] == [] and not found.numbers.any()


def test_numbers_are_the_same_through_a_renderer_of_many_scenes() -> None:
    cloud, parts = panel(2.0, 0.0, 0.8), [stand(3.0, 0.0)]
    alone = scene(cloud).render_who(CAMERA, VIEW, parts=parts)
    host: Renderer = open_renderer("cpu")
    for key in ("a", "b"):
        host.keep(key, cloud)
    host.name_cloud("person", small_person().pose(stride_pose()))
    found = host.render_who(CAMERA, np.stack([VIEW] * 3), ["a", "b", "a"], parts=parts)  # type: ignore[attr-defined]
    for v in range(3):
        np.testing.assert_array_equal(found.numbers[v], alone.numbers[0])
        assert found.seen[v] == alone.seen[0]
    with pytest.raises(RenderError, match="no cloud is named"):
        host.render_who(CAMERA, VIEW, "a", parts=[stand(3.0, 0.0, "nobody")])  # type: ignore[attr-defined]
