"""Occupancy pictures painted on a device are those that the simulator paints."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import FormatError
from gn0.render.encoding import Dots, MapPicture
from gn0.render.share import maps
from gn0.render.share.maps import MapPainter, Painted
from gn0.sim.sensors import GREEN, RED, draw_disc

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
FAR = [[-(2**20), 2**20], [2**20, -(2**20)]]


def bare(width: int, height: int, seed: int = 0) -> MapPicture:
    rng = np.random.default_rng(seed)
    return MapPicture.of_pixels(rng.choice(np.uint8([0, 127, 255]), (height, width)))


def dots_on(shape: tuple[int, int], radius: int, seed: int, *, encode: bool = True) -> Dots:
    """Dots within, over each other, at the edges, and far outside."""
    height, width = shape
    rng = np.random.default_rng(seed)
    within = rng.integers(-2, [height + 2, width + 2], (3, 2, 2))
    corners = [[0, 0], [height - 1, width - 1]]
    near = [[height // 2, width // 2], [height // 2 + 1, width // 2 - radius]]
    places = np.concatenate([within, [corners, near, [near[0]] * 2, FAR]]).astype(np.int32)
    return Dots(places.tobytes(), radius, encode)


def painted_here(picture: MapPicture, dots: Dots) -> list[np.ndarray]:
    found = []
    for start, agent in np.frombuffer(dots.places, np.int32).reshape(-1, 2, 2).tolist():
        whole = np.repeat(picture.pixels[:, :, None], 3, axis=2)
        draw_disc(whole, *start, dots.radius, GREEN)
        draw_disc(whole, *agent, dots.radius, RED)
        found.append(whole)
    return found


def expect_painted(wishes: list[tuple[MapPicture, Dots]], found: list[Painted]) -> None:
    seen = []
    for group in found:
        pictures = group.pictures.numpy()
        for number, rows in group.rows.items():
            picture, dots = wishes[number]
            assert dots.encode == group.encode
            np.testing.assert_array_equal(pictures[rows], np.stack(painted_here(picture, dots)))
            seen.append(number)
    assert sorted(seen) == list(range(len(wishes)))


@pytest.mark.parametrize("size", [(1, 1), (7, 3), (64, 64), (100, 83)])
@pytest.mark.parametrize("radius", [0, 3, 100])
def test_dots_are_where_the_simulator_paints_them(size: tuple[int, int], radius: int) -> None:
    painter = MapPainter(DeviceHost(seed=radius))
    picture = bare(*size)
    wishes = [(picture, dots_on(picture.shape, radius, radius))]
    expect_painted(wishes, painter.paint(wishes))


def test_maps_of_many_scenes_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of one size side by side, files apart from digests; few maps stay."""
    monkeypatch.setattr(maps, "KEPT", 30 * 20 * 2)
    painter = MapPainter(DeviceHost(seed=1))
    shown = [bare(30, 20, 1), bare(20, 30, 2), bare(30, 20, 3), bare(30, 20, 4)]
    for _ in range(2):
        wishes = [(p, dots_on(p.shape, 2 + n, n)) for n, p in enumerate([*shown, shown[0]])]
        wishes.append((shown[2], dots_on(shown[2].shape, 1, 9, encode=False)))
        found = painter.paint(wishes)
        assert [len(group.pictures) for group in found] == [28, 7, 7]
        expect_painted(wishes, found)
        assert len(painter._maps) == 2
    assert [len(p.pictures) for p in painter.paint([(shown[0], Dots(b"", 3, True))])] == [0]
    assert painter.paint([]) == []


@pytest.mark.parametrize("shape", [(2, 2), (0, 0), (-1, -1), (1, 2)])
def test_a_map_of_another_size_than_said_is_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(FormatError, match="size differs"):
        _ = MapPicture("a", b"" if shape == (0, 0) else b"1", shape).pixels
