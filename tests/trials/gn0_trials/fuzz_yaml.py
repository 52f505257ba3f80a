"""Fuzz target of the readers of YAML: maps of ROS, specs of corpora, settings of missions.

`python -m gn0_trials.fuzz yaml --count 1000000` runs it.
"""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gn0.maps.grid import OccupancyGrid
from gn0.maps.ros import load_ros_map
from gn0.missions.generate.settings import MissionSettings, load_settings
from gn0.scenes.corpus import CorpusSpec, load_spec
from gn0_trials.fuzz import FuzzTarget

_TOKENS = (
    b"&a", b"*a", b"<<: *a", b"[", b"]", b"{", b"}", b"- ", b"? ", b"|", b">", b"!!binary",
    b"!!set", b"!!python/object/apply:os.system", b"!!int", b"!!float", b"~", b".inf", b".nan",
    b"0x1F", b"1:1:1", b"2001-01-01", b"---", b"...", b"%YAML 1.1", b"[" * 40, b"\t", b"yes", b"=",
    b"'", b'"', b"\\u0000", b"&a [*a, *a]", b"1" * 5000, b"null",
)  # fmt: skip
_MAP = b"""image: map.png
resolution: 0.05
origin: [-1.0, -2.5, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
mode: trinary
"""
_SPEC = b"""name: homes
seed: 3
parts:
  - {kind: apartment, count: 2}
  - kind: office
    count: 1
    split: test
splits: {train: 0.5, val_unseen: 0.25, test: 0.25}
val_seen: 0.2
"""
_SETTINGS = b"""per_scene: 5
minimum_length: 4.0
maximum_length: 30
"""


def _read(path: Path) -> Any:
    data = path.read_bytes()
    if b"image" in data:
        return load_ros_map(path)
    return load_spec(path) if b"parts" in data else load_settings(path)


def _check(value: Any) -> None:
    if isinstance(value, OccupancyGrid):
        assert math.isfinite(value.resolution) and value.resolution > 0
        assert value.cells.shape == (4, 6)
    else:
        assert isinstance(value, CorpusSpec | MissionSettings)


def yaml_target() -> FuzzTarget:
    """Maps, specs and settings, with a sound picture beside."""
    stream = io.BytesIO()
    Image.fromarray(np.arange(24, dtype=np.uint8).reshape(4, 6) * 10).save(stream, "PNG")
    corpus = {
        "map": _MAP, "map-scale": _MAP.replace(b"trinary", b"scale"), "corpus": _SPEC,
        "missions": _SETTINGS, "json": b'{"per_scene": 5, "minimum_length": 4.0}\n',
    }  # fmt: skip
    beside = {"map.png": stream.getvalue()}
    return FuzzTarget("yaml", _read, corpus, _check, _TOKENS, ".yaml", beside)
