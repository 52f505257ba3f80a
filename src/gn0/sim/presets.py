"""Camera presets by name: the cameras of well-known benchmarks' robots.

A preset says which pictures a policy gets, how far an action goes and how long it takes. It never
changes physics: motion is always clipped by the paper's Eq. collision, also where the original
harness slides. The body of VLN-CE's tasks, sliding included, is profile `vlnce` of a suite.
Sources of the numbers: GN-Bench and VLN-CE configurations; what a source leaves open is noted in
`CameraPreset.note` and chosen by us.
"""

from __future__ import annotations

import math

import msgspec

from gn0.config import Config
from gn0.errors import ConfigError
from gn0.missions.episode import AgentSpec
from gn0.paper import CAMERA_SIZE, CAMERA_VFOV, DEPTH_RANGE
from gn0.render.camera import Camera
from gn0.sim.history import TILE

WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
TILE_LIMIT = 1024  # px


class CameraPreset(Config, frozen=True):
    """The cameras and the body of an agent.

    Attributes:
        name: name in results and on the command line.
        rgb: camera of the colour picture.
        depth: camera of the depth picture; its own size.
        agent: radius, camera height, step, turn and the time they take.
        rgb_size: (width, height) [px] the colour picture is reduced to by area averaging after
            rendering; None leaves it as rendered.
        pitch_degrees: how far the cameras look up (negative: down).
        depth_range: (min, max) [m] of the depth sensor; empty pixels read max.
        background: colour behind the scene, 0..1.
        history_tile: (width, height) [px] of an earlier view in the mosaic of sensor `history`.
        note: what the source leaves open and we chose.
    """

    name: str
    rgb: Camera
    depth: Camera
    agent: AgentSpec = AgentSpec()
    rgb_size: tuple[int, int] | None = None
    pitch_degrees: float = 0.0
    depth_range: tuple[float, float] = DEPTH_RANGE
    background: tuple[float, float, float] = WHITE
    history_tile: tuple[int, int] = TILE
    note: str = ""

    def __post_init__(self) -> None:
        low, high = self.depth_range
        if not (math.isfinite(low) and math.isfinite(high) and 0 <= low < high):
            raise ConfigError(
                f"depth range is {self.depth_range} m", where=f"preset {self.name!r}",
                remedy="give 0 <= min < max",
            )  # fmt: skip
        if not -90 < self.pitch_degrees < 90:
            raise ConfigError(
                f"pitch is {self.pitch_degrees} degrees", where=f"preset {self.name!r}",
                remedy="give a value between -90 and 90",
            )  # fmt: skip
        if self.rgb_size is not None and not (
            0 < self.rgb_size[0] <= self.rgb.width and 0 < self.rgb_size[1] <= self.rgb.height
        ):
            raise ConfigError(
                f"rgb_size {self.rgb_size} is not within the rendered {self.rgb.width}x"
                f"{self.rgb.height}", where=f"preset {self.name!r}", remedy="reduce, never enlarge",
            )  # fmt: skip
        if not all(1 <= side <= TILE_LIMIT for side in self.history_tile):
            raise ConfigError(
                f"history_tile is {self.history_tile} px", where=f"preset {self.name!r}",
                remedy=f"give a width and a height from 1 to {TILE_LIMIT}",
            )  # fmt: skip

    @property
    def picture_size(self) -> tuple[int, int]:
        """(width, height) [px] of the colour picture that a policy receives."""
        return self.rgb_size or (self.rgb.width, self.rgb.height)


def _with_hfov(name: str, size: tuple[int, int], hfov: float, **more: object) -> CameraPreset:
    camera = Camera.from_hfov(*size, hfov, near=0.01)
    return CameraPreset(name=name, rgb=camera, depth=camera, **more)  # type: ignore[arg-type]


def _with_vfov(name: str, size: tuple[int, int], vfov: float, **more: object) -> CameraPreset:
    camera = Camera.from_vfov(*size, vfov, near=0.01)
    return CameraPreset(name=name, rgb=camera, depth=camera, **more)  # type: ignore[arg-type]


_BODY_15 = AgentSpec()  # the body of gn0.paper
_VLNCE_EYE = AgentSpec(camera_height=1.25)
_RXR = AgentSpec(radius=0.18, camera_height=0.88, turn_degrees=30.0)
# 1.25 m/s and 75 °/s: behind somebody who walks at 1 m/s, bends included
_FOLLOWER = AgentSpec(radius=0.25, step_seconds=0.2)
_N1_NOTE = "picture size and field of view as streamvln; the source names height and pitch only"


def _n1(centimetres: int, degrees: int) -> CameraPreset:
    return _with_hfov(
        f"n1_{centimetres}cm_{degrees}deg",
        (640, 480),
        79.0,
        agent=AgentSpec(camera_height=centimetres / 100),
        pitch_degrees=-float(degrees),
        note=_N1_NOTE,
    )


def _tiny(side: int) -> CameraPreset:
    return _with_hfov(
        f"tiny_{side}",
        (side, side),
        90.0,
        agent=_BODY_15,
        history_tile=(side // 4, side // 4),
        note="no benchmark's: for small models; view and mosaic of one size",
    )


_PRESETS = (
    _with_vfov("gn_bench", CAMERA_SIZE, CAMERA_VFOV, agent=_BODY_15),
    _with_vfov(
        "gn_bench_tools", (960, 720), 70.0, agent=AgentSpec(turn_degrees=10.0),
        note="default class of the GN-Bench tools: larger pictures, turns of 10 degrees",
    ),
    _with_vfov(
        "datagen", (960, 720), 70.0, agent=_BODY_15,
        pitch_degrees=-math.degrees(math.atan2(0.1, 2.0)),
        note="camera 1.30 m above the floor (the source: 0.30 m above the occupancy's upper z); "
        "looks 2.0 m ahead and 0.1 m down",
    ),
    _with_hfov(
        "gn0_ce", (640, 480), 79.0, agent=_VLNCE_EYE, rgb_size=(480, 360), background=BLACK,
        note="eye at 1.25 m; the original lets the agent slide along walls",
    ),
    CameraPreset(
        name="vlnce_r2r",
        rgb=Camera.from_hfov(224, 224, 90.0, near=0.01),
        depth=Camera.from_hfov(256, 256, 90.0, near=0.01),
        agent=_VLNCE_EYE,
        background=BLACK,
        note="eye at 1.25 m; the original has radius 0.10 m and slides along walls: profile vlnce",
    ),
    _with_hfov("vlnce_rxr", (640, 480), 79.0, agent=_RXR, background=BLACK),
    _with_hfov(
        "streamvln", (640, 480), 79.0, agent=_VLNCE_EYE, background=BLACK, note="eye at 1.25 m"
    ),
    _with_hfov(
        "navid", (640, 480), 90.0, agent=AgentSpec(camera_height=1.25, turn_degrees=30.0),
        background=BLACK, note="eye at 1.25 m; the original lets the agent slide along walls",
    ),
    _with_hfov(
        "uninavid", (640, 480), 120.0, agent=AgentSpec(camera_height=1.25, turn_degrees=30.0),
        background=BLACK, note="picture 640x480 and eye at 1.25 m chosen by us",
    ),
    _with_hfov(
        "rgbd_224", (224, 224), 90.0, agent=_VLNCE_EYE, background=BLACK,
        note="no benchmark's: for training, colour and depth of one small size in one drawing",
    ),
    _with_vfov(
        "follower", CAMERA_SIZE, CAMERA_VFOV, agent=_FOLLOWER,
        note="no benchmark's: cameras of gn_bench, and a body quick enough to follow a person",
    ),
    _with_vfov(
        "follower_small", (160, 120), CAMERA_VFOV, agent=_FOLLOWER,
        note="no benchmark's: what follower sees in a ninth of its pixels, for quick runs",
    ),
    _with_hfov(
        "evt", (640, 480), 90.0, agent=_FOLLOWER,
        note="of profile evt: EVT-Bench counts pixels of this picture; the body is the follower's",
    ),
    _tiny(128),
    _tiny(160),
    _with_hfov(
        "sage", (640, 480), 90.0, agent=AgentSpec(camera_height=1.20), background=BLACK,
        note="hfov 90 chosen by us: the source gives size and height only",
    ),
    _n1(125, 0),
    _n1(125, 30),
    _n1(125, 45),
    _n1(60, 15),
    _n1(60, 30),
)  # fmt: skip
_ALIASES = {"vlnce": "vlnce_r2r", "n1": "n1_125cm_0deg"}
_BY_NAME = {preset.name: preset for preset in _PRESETS}


def preset_names() -> list[str]:
    """Names that `find_preset` knows, aliases included, sorted."""
    return sorted([*_BY_NAME, *_ALIASES])


def find_preset(name: str, *, history_tile: tuple[int, int] | None = None) -> CameraPreset:
    """The preset of that name ("vlnce" means vlnce_r2r, "n1" means n1_125cm_0deg).

    `history_tile` (width, height) [px] takes the place of its own.

    Raises:
        ConfigError: no such preset; lists those that exist. Or no such tile.
    """
    try:
        found = _BY_NAME[_ALIASES.get(name, name)]
    except (KeyError, TypeError):
        raise ConfigError(
            f"no camera preset named {name!r}", remedy="known: " + ", ".join(preset_names())
        ) from None
    if history_tile is None:
        return found
    return msgspec.structs.replace(found, history_tile=tuple(history_tile))
