"""What a drawing call asks for: which scene each view shows, and what is to be drawn, checked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray
from gn0.errors import RenderError
from gn0.geometry import F32
from gn0.render.renderer import check_outputs


def check_chosen(
    views: DeviceArray, keys: Sequence[str | None] | str, chosen: DeviceArray | None
) -> tuple[list[str | None], NDArray[np.int32] | DeviceArray | None]:
    """Keys, and which of them each view on the device shows; None: all show the first.

    Raises:
        RenderError: arrays of another shape or type, or keys that are not one a view.
    """
    count = len(views)
    if views.shape != (count, 4, 4) or views.dtype != np.float64:
        raise RenderError(
            f"views on the device are {views.dtype} {views.shape}",
            remedy="give float64 [V, 4, 4], world-to-camera",
        )
    if chosen is not None:
        if isinstance(keys, str) or chosen.shape != (count,) or chosen.dtype != np.int32:
            raise RenderError(
                f"`chosen` is {chosen.dtype} {chosen.shape} for {count} views",
                where="chosen",
                remedy="give int32 [V], numbers into a list of keys",
            )
        return list(keys), chosen
    return number_keys(keys, count)


def number_keys(
    keys: Sequence[str | None] | str, count: int
) -> tuple[list[str | None], NDArray[np.int32] | None]:
    """Different keys, and which of them each view shows; None: all show the first."""
    if isinstance(keys, str):
        return [keys], None
    if len(keys) != count:
        raise RenderError(f"{len(keys)} keys for {count} views", where="keys")
    number = {key: n for n, key in enumerate(dict.fromkeys(keys))}
    if len(number) <= 1:
        return list(number), None
    return list(number), np.array([number[key] for key in keys], np.int32)


def choose_keys(keys: list[str | None], numbers: list[int]) -> list[str | None]:
    """The key of each view.

    Raises:
        RenderError: a number without a key.
    """
    for v, number in enumerate(numbers):
        if not 0 <= number < len(keys):
            raise RenderError(f"there is no key number {number}", where=f"view {v}")
    return [keys[number] for number in numbers]


def name_all(keys: Sequence[str | None] | str) -> Sequence[str] | str:
    """The keys, none of which is None.

    Raises:
        RenderError: one is.
    """
    if isinstance(keys, str):
        return keys
    for v, key in enumerate(keys):
        if key is None:
            raise RenderError("a view shows a scene that is not here", where=f"view {v}")
    return [key for key in keys if key is not None]


def check_picture(outputs: tuple[str, ...], background: Sequence[float]) -> F32:
    """The background as float32 [3].

    Raises:
        RenderError: an output is unknown, or a colour is not finite.
    """
    check_outputs(outputs)
    colour = np.array(background, np.float32)
    if colour.shape != (3,) or not np.isfinite(colour).all():
        raise RenderError("background is not three finite numbers", where="background")
    return colour
