"""A camera that no renderer can draw is refused when it is made."""

from __future__ import annotations

import pytest

from gn0.errors import RenderError
from gn0.render.camera import Camera


@pytest.mark.parametrize("size", [(0, 8), (8, 0), (16385, 8), (8, 16385), (-1, 8)])
def test_a_picture_without_pixels_or_with_too_many_is_refused(size: tuple[int, int]) -> None:
    with pytest.raises(RenderError, match="16384"):
        Camera(width=size[0], height=size[1], fx=4, fy=4, cx=4, cy=4)


def test_the_largest_picture_is_allowed() -> None:
    assert Camera(width=16384, height=16384, fx=4, fy=4, cx=4, cy=4).width == 16384
