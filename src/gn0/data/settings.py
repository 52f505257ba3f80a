"""Settings of a dataset: all that decides its bytes beside the episodes and the scenes."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from gn0.config import Config

CacheLayout = Literal["webdataset", "lerobot", "none"]
MapChoice = Literal["global", "ego"]
LabelVariant = Literal["exact", "mpc"]
PictureFormat = Literal["jpg", "png"]


class PictureSettings(Config, frozen=True):
    """How pictures are drawn, and how the cache keeps them.

    Attributes:
        layout: of the cache: tar shards (webdataset), Parquet and MP4 (lerobot), or none, which
            leaves poses and labels without the hashes of pictures.
        format: of single pictures: jpg, or png for the very pixels.
        quality: of jpg, 1 to 100.
        maps: the BEV and the occupancy picture once a scene and light, the two dots drawn on
            reading ("once"), or in every sample ("every").
        crf: constant rate factor of AV1 videos, 0 (best) to 63.
        visible_sets: draw from the splats that show near each place: quicker, and nearly the same
            pictures (at least 60 dB). Off, the pictures are exactly the simulator's.
    """

    layout: CacheLayout = "webdataset"
    format: PictureFormat = "jpg"
    quality: Annotated[int, msgspec.Meta(ge=1, le=100)] = 90
    maps: Literal["once", "every"] = "once"
    crf: Annotated[int, msgspec.Meta(ge=0, le=63)] = 30
    visible_sets: bool = False


class CollectSettings(Config, frozen=True):
    """How the steps of an episode come about.

    Attributes:
        source: "expert" walks the exact planner's own plan; "dagger" lets a policy drive and
            labels what it visits.
        policy: name of the policy that drives.
        options: of the policy.
        settings: of the collector.
    """

    source: Literal["expert", "dagger"] = "expert"
    policy: str = ""
    options: dict[str, str | int | float | bool | None] = {}  # noqa: RUF012 (msgspec copies it)
    settings: dict[str, str | int | float | bool | None] = {}  # noqa: RUF012


class BuildSettings(Config, frozen=True):
    """What `gn0 data build` was asked for.

    Attributes:
        map_frame: what map tokens count over: the whole map picture (global), or a square around
            the agent (ego).
        labels: next actions by the exact discrete planner (exact), or by the paper's discounted
            tracking objective (mpc).
        chunk: episodes a part: what one worker does at a time, and what one shard holds.
        pictures: see `PictureSettings`.
        collect: see `CollectSettings`.
    """

    map_frame: MapChoice = "global"
    labels: LabelVariant = "exact"
    chunk: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 8
    pictures: PictureSettings = PictureSettings()
    collect: CollectSettings = CollectSettings()
