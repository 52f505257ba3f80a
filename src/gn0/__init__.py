"""GN0: navigation data, simulator, benchmark and policies in 3D Gaussian Splatting scenes.

The package root stays light: names below are imported on first use, so `import gn0` costs
almost nothing and never touches Numba, PyArrow or a renderer.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# public name -> module that defines it; one canonical import path per symbol
_EXPORTS = {
    "Pose2D": "gn0.geometry",
    "Gn0Error": "gn0.errors",
    "FormatError": "gn0.errors",
    "GaussianCloud": "gn0.gaussians.cloud",
    "OccupancyGrid": "gn0.maps.grid",
    "Scene": "gn0.scenes.scene",
    "SceneObject": "gn0.scenes.scene",
    "load_scene": "gn0.scenes.folder",
    "Camera": "gn0.render.camera",
    "build_renderer": "gn0.render.open",
    "Episode": "gn0.missions.episode",
    "Observation": "gn0.sim.state",
    "Simulator": "gn0.sim.simulator",
    "open_simulator": "gn0.sim.open",
    "run_episode": "gn0.sim.rollout",
    "register_envs": "gn0.sim.env",
}

__all__ = ["__version__", *_EXPORTS]


def __getattr__(name: str) -> Any:
    if name in _EXPORTS:
        value = getattr(import_module(_EXPORTS[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'gn0' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
