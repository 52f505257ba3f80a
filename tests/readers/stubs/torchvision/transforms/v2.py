"""Names that LeRobot imports and does not use while it reads."""

from __future__ import annotations


class Transform:
    """A transform."""


class functional:  # noqa: N801 (torchvision's name)
    """Functions of transforms."""
