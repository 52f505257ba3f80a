"""Clouds built once."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from gn0.gaussians.cloud import GaussianCloud


@pytest.fixture(scope="session")
def shapes() -> ModuleType:
    """The module of test shapes beside this file."""
    path = Path(__file__).with_name("rooms.py")
    spec = importlib.util.spec_from_file_location("capture_test_rooms", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def flat(shapes: ModuleType) -> GaussianCloud:
    """Two furnished rooms."""
    cloud: GaussianCloud = shapes.two_rooms()
    return cloud
