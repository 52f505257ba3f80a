"""Who draws what a policy sees, and how a process that only draws finds the splats."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from gn0.gaussians.cloud import GaussianCloud
from gn0.plugins import get_plugin, is_builtin
from gn0.render.light import LightCondition, relight_cloud
from gn0.render.open import choose_backend, name_drawing
from gn0.render.share.server_process import DrawServer
from gn0.sim.sensor.table import carry_sensors
from gn0.suites.suite import load_suite_scene

LOADER = f"{__name__}:load_look"  # for `gn0.render.share.server_process.DrawServer`
POSER = "gn0.people.poser:open_poser"  # likewise; bodies are loaded in that process alone
SHARED: frozenset[str] = frozenset({"cuda"})  # backends that one process draws with for all


class Look(msgspec.Struct, frozen=True):
    """Where the splats of a scene are, and how they are lit.

    Attributes:
        folder: folder of the scene.
        scene: its id.
        hash: its content hash.
        light: as the scene was made when None.
    """

    folder: str
    scene: str
    hash: str
    light: LightCondition | None = None

    @property
    def key(self) -> str:
        """Equal for equal splats."""
        light = None if self.light is None or self.light.is_neutral else self.light
        return f"{self.hash} {msgspec.json.encode(light).decode()}"

    @property
    def source(self) -> dict[str, Any]:
        """What `load_look` takes."""
        plain: dict[str, Any] = msgspec.to_builtins(self)
        return plain


def load_look(source: dict[str, Any]) -> GaussianCloud:
    """The splats of a `Look`.

    Raises:
        BenchError: it is another scene, or it changed.
        StorageError, FormatError: it cannot be read.
    """
    look = msgspec.convert(source, Look)
    cloud = load_suite_scene(Path(look.folder), look.scene, look.hash).gaussians
    return cloud if look.light is None else relight_cloud(cloud, look.light)


def needs_renderer(sensors: Iterable[str], map_mode: str) -> bool:
    """Whether anything must be drawn for these sensors."""
    carried = carry_sensors(sensors)
    return carried.needs_renderer(map_mode == "explored" and bool(carried.maps))


def sees_pictures(policy: str, map_mode: str, *, isolated: bool = False) -> bool | None:
    """Whether anything is drawn for a policy of that name; None where only itself can tell.

    Raises:
        ConfigError: no such policy.
    """
    known = is_builtin("policy", policy) or not isolated
    sensors = getattr(get_plugin("policy", policy), "sensors", None) if known else None
    return needs_renderer(sensors, map_mode) if isinstance(sensors, frozenset) else None


def choose_run_backend(
    backend: str, policy: str, map_mode: str, *, isolated: bool = False, judged: bool = False
) -> str:
    """The renderer of a run, for its record and its identity.

    A policy that sees no pictures has the same results with any: its runs are "auto", as they are
    on a machine without a GPU. So are those that "auto" lets the CPU draw. An isolated plug-in is
    not imported to find out what it sees. `judged`: pictures are drawn in any case, as scores are
    made of them.

    Raises:
        ConfigError: no such policy, or no such backend.
    """
    if sees_pictures(policy, map_mode, isolated=isolated) is False and not judged:
        return "auto" if name_drawing(backend) == "cuda" else backend
    if backend == "auto" and choose_backend("auto")[0] == "cuda":
        return "cuda"
    return backend


def find_agents_card(
    asked: str, backend: str, *, agents: int, workers: int, executor: str
) -> str | None:
    """The card that a worker's agents are on, by name; None where they are on the CPU.

    On the card that draws what they see. Agents that see no pictures are as quick on the CPU: they
    are on a card only where `asked` or `GN0_DEVICE` names one. Several workers of one machine
    leave the card to the process that draws for all of them.

    Args:
        asked: the backend that the user asked for.
        backend: the one that draws, see `choose_run_backend`.
        agents: side by side in a worker.
        workers: how many there are.
        executor: where they run.

    Raises:
        DeviceError: pictures are drawn on a card that cannot be used.
    """
    if agents == 1 or (workers > 1 and executor == "process"):
        return None
    from gn0.device.open import find_device, open_device  # who draws on the CPU needs neither

    if name_drawing(backend) == "cuda":
        return open_device().name
    named = os.environ.get("GN0_DEVICE", "") if asked == "auto" else ""
    if name_drawing(asked) != "cuda" and not named:
        return None
    device, _ = find_device()
    return None if device is None else device.name


@contextlib.contextmanager
def open_run_drawing(backend: str, executor: str) -> Iterator[DrawServer | None]:
    """The drawing process for all workers of a run on this machine's GPU; else None.

    Raises:
        DeviceError: the GPU cannot be used; says why.
    """
    drawn_by = name_drawing(backend)
    if drawn_by not in SHARED or executor != "process":
        yield None
        return
    with DrawServer(drawn_by, LOADER, pose=POSER) as server:
        yield server
