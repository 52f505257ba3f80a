"""What a tile leaves out never shows: to the bit as if every splat were blended everywhere."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.avatars.poses import stride_pose
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import F32, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cpu_bin import sort_tile
from gn0.render.cpu_project import CR, DEPTH
from gn0.render.cpu_raster import BATCH, GATHERED, TILE, blend, gather_batch, raster_tiles
from gn0.render.renderer import RenderOptions
from gn0.testing.renderer_check import random_cloud
from gn0_trials.people_small import small_person

CAMERA = Camera.from_hfov(72, 56, 90)  # the last tiles are cut
VIEW = view_from_pose(-1.6, 0.1, 1.1, 0.05)
BEHIND = (0.1, 0.4, 0.7)
EVERYWHERE = np.uint64(0xFFFFFFFFFFFFFFFF)
SIDE = TILE * 5  # floats of a row of a tile


@pytest.fixture(scope="module")
def clouds() -> dict[str, GaussianCloud]:
    """A body of tiny discs, large splats round about, and both."""
    body, large = small_person().pose(stride_pose()), random_cloud(2000, seed=3, sh_degree=0)
    return {"body": body, "large": large, "both": join_clouds([body, large])}


@pytest.mark.parametrize("kind", ["body", "large", "both"])
@pytest.mark.parametrize("antialiased", [False, True])
def test_pictures_are_as_if_every_splat_were_blended_everywhere(
    clouds: dict[str, GaussianCloud], kind: str, antialiased: bool
) -> None:
    options = RenderOptions(rgb_float=True, antialiased=antialiased, background=BEHIND)
    renderer = RendererCpu(clouds[kind], options)
    seen = renderer.render(CAMERA, VIEW)
    rgb, alpha, entries = _blend_everywhere(renderer)
    assert seen.rgb is not None and seen.alpha is not None
    assert entries > 2000 and (seen.alpha > 0.9).mean() > 0.05
    assert (seen.alpha[0] == alpha).all()
    assert (seen.rgb[0] == rgb).all()


def _blend_everywhere(renderer: RendererCpu) -> tuple[F32, F32, int]:
    """Colour [H, W, 3] and opacity [H, W] of `VIEW`, and how many entries its tiles have."""
    lists = renderer.arrange(CAMERA, VIEW, [(renderer.cloud, 0)])
    records, indices, ordered, starts, rows, keys, spare_rows, spare_keys, _ = lists.unboxed
    tiles_x, tiles_y = -(-CAMERA.width // TILE), -(-CAMERA.height // TILE)
    rgb = np.empty((tiles_y * TILE, tiles_x * TILE, 3), np.float32)
    alpha = np.empty(rgb.shape[:2], np.float32)
    gathered, reach = np.empty(GATHERED, np.float32), np.empty(2 * BATCH, np.int32)
    for t in range(tiles_x * tiles_y):
        here = slice(starts[t], starts[t + 1])
        mine = rows[here]
        sort_tile(keys[here], mine, spare_keys[here], spare_rows[here], indices, records, ordered)
        acc = np.zeros(TILE * SIDE, np.float32)
        acc.reshape(TILE, 5, TILE)[:, 0] = 1.0
        x, y = t % tiles_x * TILE, t // tiles_x * TILE
        for first in range(0, len(mine), BATCH):
            batch = mine[first : first + BATCH]
            gather_batch(records, batch, x, y, gathered, reach)
            for b, each in enumerate(gathered[: 10 * BATCH].reshape(10, BATCH).T[: len(batch)]):
                dx0, dy0, qx, qy, qk, log_o, red, green, blue, z = each
                blend(
                    acc, reach[b], reach[BATCH + b], EVERYWHERE, qx * dx0, qx, qy, dy0, qk, log_o,
                    red, green, blue, z, 0, TILE,
                )  # fmt: skip
        left = np.abs(acc.reshape(TILE, 5, TILE)[:, 0])
        alpha[y : y + TILE, x : x + TILE] = np.float32(1.0) - left
        for channel in range(3):
            shown = acc.reshape(TILE, 5, TILE)[:, 1 + channel]
            rgb[y : y + TILE, x : x + TILE, channel] = shown + left * np.float32(BEHIND[channel])
    size = slice(0, CAMERA.height), slice(0, CAMERA.width)
    return rgb[size], alpha[size], int(starts[tiles_x * tiles_y])


def test_what_lies_behind_a_closed_front_is_not_blended() -> None:
    """Though the rest of its tile is still open."""
    front, back = BATCH, 300
    stream = np.random.default_rng(0)
    x = np.concatenate([np.full(front, -0.75), stream.uniform(-1.54, -1.46, back)])
    y = np.concatenate([np.zeros(front), stream.uniform(-0.5, 0.5, back)])
    z = np.concatenate([np.linspace(1.0, 1.1, front), np.full(back, 2.0)])
    wide = np.repeat([(0.25, 2.0, 0.01), (0.005, 0.005, 0.005)], (front, back), axis=0)
    cloud = GaussianCloud(
        np.column_stack([x, y, z]).astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (front + back, 1)),
        wide.astype(np.float32),
        np.full(front + back, 0.99, np.float32),
        np.zeros((front + back, 1, 3), np.float32),
    )
    renderer = RendererCpu(cloud)
    camera = Camera(width=TILE, height=TILE, fx=8.0, fy=8.0, cx=8.0, cy=8.0)
    lists = renderer.arrange(camera, np.eye(4), [(renderer.cloud, 0)])
    records, starts, rows = lists.records, lists.starts, lists.tile_rows
    listed = rows[: starts[1]].copy()
    hidden = listed[records[listed, DEPTH] > 1.5]
    assert len(listed) - len(hidden) == front and len(hidden) > 200
    pictures = []
    for _ in range(2):
        rgb = np.empty((TILE, TILE, 3), np.float32)
        depth, alpha = np.empty((TILE, TILE), np.float32), np.empty((TILE, TILE), np.float32)
        raster_tiles(
            *lists, 1, TILE, TILE, np.zeros(3, np.float32),
            np.array([False, True, True, True]), np.empty((1, 1, 3), np.uint8), rgb, depth, alpha,
        )  # fmt: skip
        pictures.append((rgb, depth, alpha))
        records[hidden, CR] = np.nan  # would show in each pixel whose sums it enters
    assert (pictures[0][2][:, :4] > 0.99).all() and (pictures[0][2][:, 12:] < 0.5).all()
    for one, two in zip(*pictures, strict=True):
        np.testing.assert_array_equal(one, two)


def test_what_is_arranged_is_all_that_kernels_take_and_no_more() -> None:
    renderer = RendererCpu(random_cloud(300, seed=4))
    view = renderer.arrange(CAMERA, VIEW, [(renderer.cloud, 0)])
    assert view.unboxed == tuple(view)[1:] and len(view.rects) == len(view.records)
    entries = view.tile_rows[: view.starts[-1]]
    x0, x1, y0, y1 = view.rects[entries].T
    assert len(entries) and (x0 < x1).all() and (y0 < y1).all()
    assert x1.max() <= CAMERA.width and y1.max() <= CAMERA.height
