"""Stands in for torchvision where its wheels do not load beside the CPU's torch.

LeRobot 0.4 takes three things of it: `ToTensor`, a video reader, and the names of transforms that
it draws from at random, which nobody asks for here.
"""

from __future__ import annotations

from . import io, transforms

__version__ = "0.0.0+stub"
__all__ = ["io", "set_video_backend", "transforms"]


def set_video_backend(backend: str) -> None:
    """There is only one."""
    assert backend == "pyav", backend
