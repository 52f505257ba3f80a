"""Which view gets whose moving splats and whose visible set: found on the host, without a card."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.render.cuda import parts
from gn0.render.cuda.instances import pack_normals


def cloud(count: int) -> GaussianCloud:
    return GaussianCloud(
        means=np.zeros((count, 3), np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.ones((count, 3), np.float32),
        opacities=np.ones(count, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )


def test_each_view_has_its_own_moving_splats(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two agents among three share theirs; one has none, and nothing is brought twice."""
    monkeypatch.setattr(parts, "upload_clouds", lambda device, clouds, sort: list(clouds))
    one, two, none = cloud(3), cloud(5), cloud(0)
    device: Any = None
    brought, whose = parts.bring_tails(device, [one, two, one, None, none, two], 6)
    assert [len(b) for b in brought] == [3, 5]
    assert whose is not None and whose.tolist() == [0, 1, 0, -1, -1, 1]
    brought, whose = parts.bring_tails(device, two, 3)
    assert [len(b) for b in brought] == [5] and whose is not None and whose.tolist() == [0, 0, 0]
    assert parts.bring_tails(device, [None, none], 2) == ([], None)


class Sets:
    """Visible sets whose cell of a view is the number in its corner."""

    def locate(self, camera: object, matrices: np.ndarray) -> list[int | None]:
        return [None if m[0, 3] < 0 else int(m[0, 3]) for m in matrices]


def test_each_view_is_located_in_the_sets_of_its_own_scene() -> None:
    matrices = np.zeros((4, 4, 4))
    matrices[:, 0, 3] = (10, 20, 11, -1)
    sets: Any = {"home": Sets(), "office": Sets()}
    names = ["home", "office", "home", "office"]
    camera: Any = SimpleNamespace()
    found = parts.find_parts(camera, matrices, names, True, sets)
    assert found == [(sets["home"], 10), (sets["office"], 20), (sets["home"], 11), None]
    assert parts.find_parts(camera, matrices, names, False, sets) == [None] * 4
    chosen: Any = [None, 7, 8, None]
    found = parts.find_parts(camera, matrices, names, chosen, sets)
    assert found == [None, (sets["office"], 7), (sets["home"], 8), None]
    with pytest.raises(RenderError, match="'office' has no visible sets"):
        parts.find_parts(camera, matrices, names, chosen, {"home": sets["home"]})


def test_normals_unfold_to_where_they_pointed() -> None:
    """As a card unpacks them: |x| + |y| + |z| = 1, and the lower half folded over its corners."""
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    words = pack_normals(normals.astype(np.float32))
    x, y = (half.astype(np.uint16).view(np.int16) / 32767.0 for half in (words, words >> 16))
    z = 1.0 - abs(x) - abs(y)
    fold = np.maximum(-z, 0.0)
    x, y = x - np.where(x < 0, -fold, fold), y - np.where(y < 0, -fold, fold)
    back = np.column_stack([x, y, z])
    back /= np.linalg.norm(back, axis=1, keepdims=True)
    assert (back * normals).sum(axis=1).min() > 1 - 1e-7
