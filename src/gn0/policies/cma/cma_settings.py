"""`cma.json`: which graph a recurrent baseline has, what it is shown, and its sizes.

The graphs are those of VLN-CE (https://github.com/jacobkrantz/VLN-CE, `vlnce_baselines/models`),
in sizes of our own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec

from gn0.config import Config, load_json
from gn0.errors import CheckpointError, ConfigError, Gn0Error
from gn0.policies.bae.policy_settings import SQUARE_NAMES
from gn0.sim.ego_map import MapView
from gn0.sim.presets import CameraPreset, find_preset

FILE = "cma.json"
LIMIT = 2**20  # bytes of it
DEPTH = "depth"
Graph = Literal["cma", "seq2seq"]
Kind = Literal["cma", "cma_blind", "seq2seq"]
Encoder = Literal["resnet18", "efficientnet_lite0"]
KINDS: tuple[Kind, ...] = get_args(Kind)
Width = Annotated[int, msgspec.Meta(ge=4, le=4096)]


class CmaSizes(Config, frozen=True):
    """Widths of a recurrent baseline.

    Attributes:
        planes: of an encoder's first layer; its last has eight times as many.
        word: of a learned word.
        text: of the instruction encoder, each direction.
        hidden: of each GRU.
        key: of attention.
        colour, depth: of what the GRUs are told of a picture, by kind.
        squeezed: planes of the depth picture's map.
        place: of the learned vector of each of the 16 places of a picture's map.
        action: of the previous action.
    """

    planes: Width = 32
    word: Width = 64
    text: Width = 128
    hidden: Width = 256
    key: Width = 256
    colour: Width = 256
    depth: Width = 128
    squeezed: Width = 128
    place: Width = 64
    action: Width = 32


SIZES: dict[str, CmaSizes] = {
    "nano": CmaSizes(
        planes=8, word=16, text=16, hidden=32, key=16, colour=32, depth=16, squeezed=16, place=8,
        action=8,
    ),
    "tiny": CmaSizes(),
}  # fmt: skip


class CmaSettings(Config, frozen=True):
    """What a recurrent baseline is, and what it is shown.

    Attributes:
        graph: `cma`: two GRUs, attention over words and pictures; `seq2seq`: one GRU.
        pictures: each with an encoder of its own: rgb, depth, or `SQUARE_NAMES` of the ego map.
        words: whether it reads what it is told; without, it is goal-blind.
        encoder: of rgb: a ResNet18 that learns as those of all other pictures do, or
            EfficientNet-Lite0, learned on ImageNet and frozen.
        sizes: widths.
        preset: camera preset by name.
        history_tile: of the preset, when None; nobody looks at mosaics.
        view: squares of the sensor ego_map.
        text_length: tokens of an instruction that are read; longer ones are refused.
        vocabulary: tokens of the tokenizer.
    """

    graph: Graph = "cma"
    pictures: tuple[str, ...] = ("rgb", "depth")
    words: bool = True
    encoder: Encoder = "resnet18"
    sizes: CmaSizes = CmaSizes()
    preset: str = "tiny_128"
    history_tile: tuple[int, int] | None = None
    view: MapView = MapView()
    text_length: Annotated[int, msgspec.Meta(ge=1, le=4096)] = 96
    vocabulary: Annotated[int, msgspec.Meta(ge=1, le=10_000_000)] = 1

    def __post_init__(self) -> None:
        known = ("rgb", DEPTH, *SQUARE_NAMES[: len(self.view.squares)])
        for name in self.pictures:
            if name not in known:
                raise ConfigError(
                    f"no picture {name!r} for a recurrent baseline",
                    where="pictures",
                    remedy=f"known: {', '.join(known)}",
                )
        if len(set(self.pictures)) < len(self.pictures):
            raise ConfigError("a picture is named twice", where="pictures", remedy="name it once")
        if self.encoder != "resnet18" and "rgb" not in self.pictures:
            raise ConfigError(
                f"encoder {self.encoder} is one of rgb, which is not shown",
                where="encoder",
                remedy="show rgb, or leave the encoder away",
            )
        if not self.pictures and not self.words:
            raise ConfigError(
                "neither pictures nor words are left",
                where="pictures",
                remedy="leave something to go by",
            )

    @property
    def camera(self) -> CameraPreset:
        """The cameras."""
        return find_preset(self.preset, history_tile=self.history_tile)

    @property
    def sensors(self) -> frozenset[str]:
        """What an agent must carry."""
        return frozenset("ego_map" if name in SQUARE_NAMES else name for name in self.pictures)

    @property
    def shown(self) -> tuple[str, ...]:
        """Pictures that it is shown."""
        return self.pictures

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the pictures that it is shown; float32 m of `depth`, uint8 of the others."""
        camera = self.camera
        width, height = camera.picture_size
        found: dict[str, tuple[int, ...]] = {
            "rgb": (height, width, 3),
            DEPTH: (camera.depth.height, camera.depth.width),
        }
        for name, square in zip(SQUARE_NAMES, self.view.squares, strict=False):
            found[name] = (square.size, square.size, 3)
        return {name: found[name] for name in self.pictures}

    @property
    def depth_range(self) -> tuple[float, float]:
        """Metres that depth pictures reach from and to."""
        return self.camera.depth_range

    @property
    def kind(self) -> Kind:
        """The graph's name; `cma_blind` where nothing is read."""
        if self.graph == "seq2seq":
            return "seq2seq"
        return "cma" if self.words else "cma_blind"


def load_cma_settings(folder: Path | str) -> CmaSettings:
    """The settings of a checkpoint's folder.

    Raises:
        CheckpointError: there are none, or they are not what settings are; says what.
    """
    file = Path(folder) / FILE
    if not file.is_file():
        raise CheckpointError(
            f"no {FILE}: not the folder of a recurrent baseline",
            where=folder,
            remedy="give the folder `policy` that `gn0 train baseline` wrote",
        )
    try:
        settings = load_json(file, CmaSettings, limit=LIMIT)
        settings.camera  # noqa: B018 (whether there is such a preset)
    except Gn0Error as error:
        where = error.where if str(file) in error.where else f"{file}: {error.where}"
        raise CheckpointError(error.what, where=where, remedy=error.remedy) from None
    return settings
