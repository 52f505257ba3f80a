"""`ToTensor`, with torchvision's own table of types (torchvision/transforms/functional.py)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from . import v2

__all__ = ["ToTensor", "v2"]
_TYPES = {"I": np.int32, "I;16": np.int16, "F": np.float32}


class ToTensor:
    """A PIL picture as [C, H, W]: bytes in 0..1, other types as they are."""

    def __call__(self, picture: Any) -> torch.Tensor:
        array = np.array(picture, _TYPES.get(picture.mode, np.uint8), copy=True)
        array = array.reshape(picture.height, picture.width, -1)
        found = torch.from_numpy(array).permute(2, 0, 1).contiguous()
        return found.float() / 255 if found.dtype == torch.uint8 else found
