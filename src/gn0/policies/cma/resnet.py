"""ResNet18 with group normalisation: https://arxiv.org/abs/1512.03385, 1803.08494.

Without batch statistics a picture's features hang on that picture alone, whoever stands beside it.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor, nn
from torch.nn import functional

STAGES = (1, 2, 4, 8)  # planes of the stages, in those of the first; each has two blocks
STRIDE = 32  # pixels of the picture a side of the map's pixel
GROUPS = 16  # of channels at most


def count_groups(channels: int) -> int:
    """Groups that so many channels are normalised in: 16, or half of them where they are few."""
    groups = min(GROUPS, max(channels // 2, 1))
    while channels % groups:
        groups -= 1
    return groups


class Block(nn.Module):
    """Two 3 × 3 convolutions beside a way past them."""

    def __init__(self, before: int, planes: int, stride: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(before, planes, 3, stride, 1, bias=False)
        self.first_norm = nn.GroupNorm(count_groups(planes), planes)
        self.second = nn.Conv2d(planes, planes, 3, 1, 1, bias=False)
        self.second_norm = nn.GroupNorm(count_groups(planes), planes)
        self.past: nn.Module = nn.Identity()
        if stride != 1 or before != planes:
            self.past = nn.Sequential(
                nn.Conv2d(before, planes, 1, stride, bias=False),
                nn.GroupNorm(count_groups(planes), planes),
            )

    def forward(self, x: Tensor) -> Tensor:
        """Features [B, planes, H / stride, W / stride] of [B, before, H, W]."""
        y = functional.relu(self.first_norm(self.first(x)))
        y = self.second_norm(self.second(y))
        return functional.relu(y + self.past(x))


class ResNet18(nn.Module):
    """Pictures [B, C, H, W] to maps [B, 8 · planes, H / 32, W / 32].

    Args:
        channels: of pictures.
        planes: of the first stage; 64 is the usual one.
    """

    def __init__(self, channels: int, planes: int) -> None:
        super().__init__()
        self.stem = nn.Conv2d(channels, planes, 7, 2, 3, bias=False)
        self.stem_norm = nn.GroupNorm(count_groups(planes), planes)
        self.blocks = nn.Sequential(*_list_blocks(planes))
        self.planes = STAGES[-1] * planes
        for part in self.modules():
            if isinstance(part, nn.Conv2d):
                nn.init.kaiming_normal_(part.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Tensor) -> Tensor:
        """Maps of pictures."""
        x = functional.relu(self.stem_norm(self.stem(x)))
        found: Tensor = self.blocks(functional.max_pool2d(x, 3, 2, 1))
        return found


def _list_blocks(planes: int) -> Iterator[Block]:
    before = planes
    for stage, times in enumerate(STAGES):
        for number in range(2):
            yield Block(before, times * planes, 2 if stage and not number else 1)
            before = times * planes


def scale_colours(pictures: Tensor) -> Tensor:
    """uint8 [B, H, W, 3] as float32 [B, 3, H, W] from 0 to 1: all that VLN-CE does to them."""
    return pictures.permute(0, 3, 1, 2).float() / 255


def scale_depth(pictures: Tensor, reach: tuple[float, float]) -> Tensor:
    """Metres [B, H, W] as float32 [B, 1, H, W] from 0 to 1 over the sensor's reach."""
    low, high = reach
    return ((pictures.float() - low) / (high - low)).clamp(0, 1)[:, None]


def pool_map(x: Tensor, side: int) -> Tensor:
    """Maps [B, C, H, W] as [B, C, side · side]; left as they are where they have that side."""
    if x.shape[-2:] != (side, side):
        x = functional.adaptive_avg_pool2d(x, side)
    return torch.flatten(x, 2)
