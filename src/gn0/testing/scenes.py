"""Scenes for the tests of users: small, in code, always the same."""

from __future__ import annotations

from gn0.scenes.example import build_example_scene as build_room_scene

__all__ = ["build_room_scene"]
