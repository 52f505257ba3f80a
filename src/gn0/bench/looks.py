"""How a process that only draws finds the splats of a scene in its light."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from gn0.bench.suite import load_suite_scene
from gn0.gaussians.cloud import GaussianCloud
from gn0.render.light import LightCondition, relight_cloud

LOADER = f"{__name__}:load_look"  # for `gn0.render.share.client.DrawServer`


class Look(msgspec.Struct, frozen=True):
    """Where the splats of a scene are, and how they are lit.

    Attributes:
        folder: of the scene.
        scene: its id.
        hash: its content hash.
        light: as the scene was made when None.
    """

    folder: str
    scene: str
    hash: str
    light: LightCondition | None = None

    @property
    def key(self) -> str:
        """Equal for equal splats."""
        light = None if self.light is None or self.light.is_neutral else self.light
        return f"{self.hash} {msgspec.json.encode(light).decode()}"

    @property
    def source(self) -> dict[str, Any]:
        """What `load_look` takes."""
        plain: dict[str, Any] = msgspec.to_builtins(self)
        return plain


def load_look(source: dict[str, Any]) -> GaussianCloud:
    """The splats of a `Look`.

    Raises:
        BenchError: it is another scene, or it changed.
        StorageError, FormatError: it cannot be read.
    """
    look = msgspec.convert(source, Look)
    cloud = load_suite_scene(Path(look.folder), look.scene, look.hash).gaussians
    return cloud if look.light is None else relight_cloud(cloud, look.light)
