"""Labels of pictures: which object and which category each pixel shows.

A splat carries one code: the number of its object and of that object's category. A renderer sums
the blending weights of each code at a pixel; the code with the greatest sum is what the pixel
shows, the one met first where sums are equal. Splats without a label are code 0 and count like any
other, so a wall hides what is behind it.

Pictures hold numbers from 1: object n of "instance" is `scene.objects[n - 1]`, category n of
"semantic" is `scene.categories[n]`. 0 is what belongs to no object, and where nothing is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError
from gn0.render.renderer import LABELS

U32 = NDArray[np.uint32]
OBJECT_BITS = 20  # of a code; the category is above
OBJECTS_MAX = 2**OBJECT_BITS - 2  # number of an object, from 0
CATEGORIES_MAX = 2 ** (32 - OBJECT_BITS) - 1
_REMEDY = (
    'draw "rgb" and "depth", or use a scene whose splats carry labels, as those of '
    "`gn0 scene generate` do"
)


def encode_labels(
    label: NDArray[np.int32] | None, categories: NDArray[np.int32] | None, count: int = 0
) -> U32:
    """The code of each splat [N]: object number plus one, category number above; 0 without label.

    Labels beyond the objects that `categories` tells of are none.

    Args:
        label: of each splat, as in `GaussianCloud`; None: `count` splats have none.
        categories: category of each object, likewise.
        count: count of splats without labels.

    Raises:
        RenderError: numbers that a code cannot hold.
    """
    if label is None:
        return np.zeros(count, np.uint32)
    table = categories
    if len(label) and int(label.max()) > OBJECTS_MAX:
        raise RenderError(
            f"a splat belongs to object {int(label.max()):,}",
            where="cloud.label",
            remedy=f"number objects from 0 to {OBJECTS_MAX:,}",
        )
    if table is None:
        return np.maximum(label + 1, 0).astype(np.uint32)
    if len(table) and not 0 <= int(table.min()) <= int(table.max()) <= CATEGORIES_MAX:
        raise RenderError(
            "an object has a category number out of range",
            where="cloud.categories",
            remedy=f"number categories from 1 to {CATEGORIES_MAX:,}",
        )
    codes = np.zeros(len(table) + 1, np.uint32)  # of labels, and 0 for all others
    codes[:-1] = np.arange(1, len(table) + 1) | table.astype(np.int64) << OBJECT_BITS
    return codes[np.where((label < 0) | (label >= len(table)), len(table), label)]


def check_labelled(cloud_label: object, categories: object, outputs: Sequence[str]) -> None:
    """Refuse labels of a scene whose splats have none.

    Args:
        cloud_label: `GaussianCloud.label` of the scene, or anything else that is not None.
        categories: `GaussianCloud.categories`, likewise.
        outputs: what is to be drawn.

    Raises:
        RenderError: the splats carry no label, or nobody knows the categories of the objects.
    """
    wanted = [name for name in outputs if name in LABELS]
    if wanted and cloud_label is None:
        raise RenderError(
            f"the scene's splats carry no labels: {wanted[0]!r} cannot be drawn",
            where="cloud.label",
            remedy=_REMEDY,
        )
    if "semantic" in wanted and categories is None:
        raise RenderError(
            "the categories of the scene's objects are unknown: 'semantic' cannot be drawn",
            where="cloud.categories",
            remedy='draw "instance", or give the cloud `categories`',
        )


def refuse_labels(outputs: Sequence[str], name: str) -> None:
    """Refuse labels where a renderer draws none; see `Traits.labels`.

    Raises:
        RenderError: a label is among the outputs.
    """
    wanted = [output for output in outputs if output in LABELS]
    if wanted:
        raise RenderError(
            f"renderer {name!r} does not draw {wanted[0]!r}",
            where="outputs",
            remedy="use backend 'cpu' or 'cuda', or one of their visible sets",
        )


def split_codes(codes: U32, outputs: Sequence[str]) -> dict[str, Any]:
    """Pictures "semantic" and "instance" uint32, where wanted, of one of codes."""
    found: dict[str, Any] = {}
    if "semantic" in outputs:
        found["semantic"] = codes >> np.uint32(OBJECT_BITS)
    if "instance" in outputs:
        found["instance"] = codes & np.uint32((1 << OBJECT_BITS) - 1)
    return found


def colour_labels(numbers: NDArray[np.integer]) -> NDArray[np.uint8]:
    """False colours [..., 3] of numbers [...]: the same number, the same colour; 0 is black.

    Hues turn by the golden angle, so that numbers near each other are told apart.
    """
    number = np.asarray(numbers).astype(np.int64)
    hue = (number * 0.61803398875) % 1.0
    light = 0.55 + 0.15 * ((number // 5) % 4)
    wheel = np.abs((hue[..., None] * 6 + np.array([0, 4, 2])) % 6 - 3) - 1
    colour = light[..., None] * (1 - 0.75 * (1 - np.clip(wheel, 0, 1)))
    return np.asarray(np.where(number[..., None] == 0, 0, colour * 255)).astype(np.uint8)
