"""Settings of a dataset: everything that decides its bytes besides the episodes and scenes."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

from gn0.config import Config
from gn0.data.codec import AnswerOrder, AnyFrame, EgoFrame
from gn0.data.expert_labels import LabelSettings
from gn0.errors import ConfigError
from gn0.maps.grid import OccupancyGrid
from gn0.paper import SUCCESS_RADIUS
from gn0.sim.sensors import MapFrame

CacheLayout = Literal["webdataset", "lerobot", "none"]
PictureFormat = Literal["jpg", "png"]
DepthFiles = Literal["png", "npy", "both"]
Halting = Literal["paper", "gn0-release", "none"]
Schedule = Literal["constant", "power", "first"]
Backend = Literal["cpu", "cuda"]


class PictureSettings(Config, frozen=True):
    """How pictures are drawn, and how the cache keeps them.

    Attributes:
        layout: of the cache: tar shards (webdataset), Parquet and MP4 (lerobot), or none, which
            leaves poses and labels without the hashes of pictures.
        format: format of single pictures: jpg, or png, which is lossless.
        quality: quality of jpg, 1 to 100.
        maps: the BEV and the occupancy picture in every sample ("every"), or once a scene and
            light beside the shards or videos, the two dots drawn on reading ("once").
        crf: constant rate factor of AV1 videos, 0 (best) to 63.
        visible_sets: draw from the splats that show near each place: quicker, and nearly the same
            pictures (at least 60 dB). Off, the pictures are exactly the simulator's.
        depth: store depth pictures as well, and hash them; unset in files where it is off.
        depth_as: how a shard keeps depth: png (a quarter of the size; read it as 16 bits), npy
            (right in every reader), or both; unset means png. LeRobot has a way of its own.
        backend: the renderer that draws, where it is not the CPU's: its pictures differ by
            rounding, so their hashes do, and they can only be made again by the same.
    """

    layout: CacheLayout = "webdataset"
    format: PictureFormat = "jpg"
    quality: Annotated[int, msgspec.Meta(ge=1, le=100)] = 90
    maps: Literal["once", "every"] = "every"
    crf: Annotated[int, msgspec.Meta(ge=0, le=63)] = 30
    visible_sets: bool = False
    depth: bool | msgspec.UnsetType = msgspec.UNSET
    depth_as: DepthFiles | msgspec.UnsetType = msgspec.UNSET
    backend: Literal["cuda"] | msgspec.UnsetType = msgspec.UNSET

    @property
    def drawn_by(self) -> Backend:
        """Name of the renderer that draws."""
        return "cpu" if self.backend is msgspec.UNSET else self.backend

    @property
    def depth_files(self) -> tuple[str, ...]:
        """Endings of the depth files of a sample; none where depth is not stored."""
        if not self.depth:
            return ()
        kind = "png" if self.depth_as is msgspec.UNSET else self.depth_as
        return ("npy", "png") if kind == "both" else (kind,)

    def __post_init__(self) -> None:
        if self.depth is False:  # one way to say it: files say nothing, as before there was depth
            msgspec.structs.force_setattr(self, "depth", msgspec.UNSET)
        if self.depth is msgspec.UNSET:  # without depth there is no way to keep it
            msgspec.structs.force_setattr(self, "depth_as", msgspec.UNSET)


class TokenSettings(Config, frozen=True):
    """What map tokens refer to, and how answers of them are written.

    Attributes:
        frame: the whole map picture (global), or a square around the agent (ego).
        size: width and height of that square [px].
        metres_per_pixel: its scale [m].
        ahead: the share of it that lies before the agent.
        order: what comes first in an answer, where it is not the actions; samples hold numbers
            alone, so this says how their texts are to be written.
    """

    frame: Literal["global", "ego"] = "global"
    size: Annotated[int, msgspec.Meta(ge=1, le=4096)] = 224
    metres_per_pixel: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.05
    ahead: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.5
    order: AnswerOrder | msgspec.UnsetType = msgspec.UNSET

    def __post_init__(self) -> None:
        if self.order == "actions_first":  # one way to say it: as files from before say nothing
            msgspec.structs.force_setattr(self, "order", msgspec.UNSET)

    @property
    def answer_order(self) -> AnswerOrder:
        """What comes first in an answer."""
        return "actions_first" if self.order is msgspec.UNSET else self.order

    def of_grid(self, grid: OccupancyGrid) -> AnyFrame:
        """The frame in a scene."""
        if self.frame == "global":
            return MapFrame.of_grid(grid)
        return EgoFrame(self.size, self.metres_per_pixel, self.ahead)


class DaggerSettings(Config, frozen=True):
    """How states are visited.

    Attributes:
        policy: name of the policy that drives.
        options: its keyword arguments.
        beta: probability that the expert acts, of each step.
        schedule: how β changes from iteration to iteration: constant; power, β to the power of
            iteration − 1; first, the expert alone in iteration 1 and the policy alone after it.
        iteration: which one this is, from 1.
        halting: what ends an episode near the goal, see `gn0.data.dagger`.
        success_radius: walking distance to the goal that the halting rule of the paper means [m].
        map_mode: what the maps shown to the policy hold.
        max_steps: actions until an episode is cut off.
        seed: seed of the draws that decide who acts.
        plugins: modules to import first, for policies of others.
        demonstrate: what the policy did is the label, not what the expert would have done; unset
            in files where it is off.
    """

    policy: str
    options: dict[str, Any] = {}  # noqa: RUF012 (msgspec copies it)
    beta: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.5
    schedule: Schedule = "constant"
    iteration: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 1
    halting: Halting = "paper"
    success_radius: Annotated[float, msgspec.Meta(gt=0, le=100)] = SUCCESS_RADIUS
    map_mode: Literal["prior", "explored", "none"] = "prior"
    max_steps: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 500
    seed: int = 0
    plugins: tuple[str, ...] = ()
    demonstrate: bool | msgspec.UnsetType = msgspec.UNSET

    def __post_init__(self) -> None:
        if self.demonstrate is False:  # one way to say it
            msgspec.structs.force_setattr(self, "demonstrate", msgspec.UNSET)
        if self.demonstrate and (self.expert_share > 0 or self.halting != "none"):
            raise ConfigError(
                "a demonstration is walked by the policy alone",
                where="--labels own",
                remedy="give --beta 0 and --halting none",
            )

    @property
    def expert_share(self) -> float:
        """β of this iteration."""
        if self.schedule == "power":
            return float(self.beta ** (self.iteration - 1))
        if self.schedule == "first":
            return 1.0 if self.iteration == 1 else 0.0
        return self.beta


class BuildSettings(Config, frozen=True):
    """What `gn0 data build` was asked for.

    Attributes:
        tokens: what map tokens refer to.
        labels: how the next actions and the way ahead are found.
        chunk: episodes per part: what one worker takes at a time, and what one shard holds.
        pictures: see `PictureSettings`.
        dagger: how a policy drives; None for the expert's own walks.
    """

    tokens: TokenSettings = TokenSettings()
    labels: LabelSettings = LabelSettings()
    chunk: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 8
    pictures: PictureSettings = PictureSettings()
    dagger: DaggerSettings | None = None

    def __post_init__(self) -> None:
        if self.dagger is not None and self.dagger.demonstrate and self.labels.depth:
            raise ConfigError(
                "a demonstration ends where the policy stopped, not further in",
                where="--labels own",
                remedy="leave out --inside",
            )
