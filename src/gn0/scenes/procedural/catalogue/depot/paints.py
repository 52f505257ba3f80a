"""Paints of racks, machines and signals."""

from __future__ import annotations

from gn0.scenes.procedural.palette import plain

ORANGE = plain("beam orange", "metal", "#e06a1c", contrast=0.15)


BLUE = plain("upright blue", "metal", "#1f4a8c", contrast=0.15)


YELLOW = plain("machine yellow", "metal", "#e9b01c", contrast=0.12)


RUBBER = plain("rubber", "plastic", "#1d1d1f", contrast=0.15)


RED = plain("signal red", "plastic", "#c0181e", contrast=0.06)
