"""What every worker of a run is told, and which part of that is kept beside the results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import metadata
from typing import Any

import msgspec

from gn0.bench.worker_messages import Open
from gn0.plugins import SECRETS
from gn0.suites.suite import Suite

HIDDEN = "(not kept)"


def build_settings(
    suite: Suite,
    policy_name: str,
    options: Mapping[str, Any],
    plugin_modules: Sequence[str] = (),
    backend: str = "auto",
) -> Open:
    """What every worker of a run must know: the policy, and the suite's own rules."""
    return Open(
        policy=policy_name,
        options=dict(options),
        plugin_modules=tuple(plugin_modules),
        camera=suite.about.camera,
        backend=backend,
        agent=suite.about.agent,
        max_steps=suite.about.max_steps,
        success_radius=suite.about.success_radius,
        map_mode=suite.map_mode,
        profile=suite.about.profile,
    )


def describe_settings(settings: Open) -> dict[str, Any]:
    """Settings as they are kept beside results; what looks like a secret is not."""
    known: dict[str, Any] = msgspec.to_builtins(settings)
    for name in ("drawing", "on_device", "bank"):  # where work is done, and where people are
        known.pop(name)
    known["isolated"] = bool(known["isolated"])
    for name, usual in (("agents", 1), ("control", "none")):
        if known[name] == usual:
            del known[name]
    known["options"] = mask_secrets(known["options"])
    return known


def mask_secrets(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a policy without the values of those that look like a secret."""
    return {
        name: HIDDEN if any(word in name.lower() for word in SECRETS) else value
        for name, value in options.items()
    }


def list_versions() -> dict[str, str]:
    """Versions of what a run is made with, by package."""
    names = ("gn0", "numpy", "scipy", "numba", "pyarrow", "msgspec")
    return {name: metadata.version(name) for name in names}
