"""Map pictures of many scenes, drawn by several processes before anybody waits for them.

A scene seen from above takes a card a moment and its host a quarter of a second: splats are read,
lit and packed. Where hundreds are opened, several processes do that; the cache keeps the pictures.
"""

from __future__ import annotations

import os
import zlib
from collections import defaultdict
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from gn0.device.device import Device
from gn0.device.open import open_device
from gn0.jobs import run_jobs
from gn0.jobs.process import count_cores
from gn0.progress import Progress, no_progress
from gn0.render.open import open_renderer
from gn0.render.renderer import Renderer
from gn0.scenes.folder import load_scene
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.look_map import draw_map
from gn0.sim.open import name_look, split_look
from gn0.sim.scene_looks import SceneLooks

CARDS = Path("/proc/driver/nvidia/gpus")  # a folder for each, named by its bus
FEW = 64  # pictures that are drawn as soon by one process, which need not start
PROCESSES = 12  # at most
ROOM = 2**30  # bytes of a card for each: its context and a scene


def draw_maps_ahead(
    env: VectorEnvDevice, *, processes: int = 0, few: int = FEW, progress: Progress = no_progress
) -> int:
    """Draw the map pictures of an environment's scenes that the cache lacks.

    The bytes are those that the environment would draw itself, one after another.

    Args:
        env: before its first reset.
        processes: at most; when 0 a third of the cores, up to a dozen, and as many as the card has
            room for.
        few: so many pictures are left to the environment.
        progress: is told of scenes.

    Returns:
        how many pictures were drawn.

    Raises:
        JobError: a process died twice. Gn0Error: a scene is damaged, or the card is too small.
    """
    eyes = env._eyes
    if eyes is None or not eyes.shows_map:
        return 0
    lacking: dict[str, list[str]] = defaultdict(list)
    for look in sorted(set(map(name_look, env.tasks.episodes))):
        scene_id, _ = split_look(look)
        path = env.tasks.scenes[scene_id]().path
        if path and eyes.lacks_map(look):
            lacking[str(Path(path).resolve())].append(look)
    count = sum(map(len, lacking.values()))
    if count <= few:
        return 0
    if not processes:
        processes = min(count_cores() // 3, PROCESSES, int(env.device.memory()[0] // ROOM))
    if processes < 2:  # no quicker than the environment itself
        return 0
    cut, background = eyes.map_settings
    scenes = list(lacking)
    begin = int(place_evenly(number_card(getattr(env.device, "ordinal", 0))) * len(scenes))
    scenes = scenes[begin:] + scenes[:begin]  # each of several cards begins with others
    payloads = [
        {
            "scene": scene,
            "looks": lacking[scene],
            "device": _name_device(env.device),
            "cut_height": cut,
            "background": list(background),
        }
        for scene in scenes
    ]
    run_jobs(
        "gn0.sim.maps_ahead:draw_maps",
        payloads,
        workers=processes,
        names=scenes,
        what="map pictures of scenes",
        progress=progress,
    )
    return count


def draw_maps(payload: dict[str, Any]) -> dict[str, Any]:
    """One unit of work: a scene's map pictures in all of its lights, into the cache."""
    renderer = _open(payload["device"])
    background = tuple(payload["background"])
    scene = load_scene(Path(payload["scene"]))
    looks = SceneLooks(renderer, {split_look(payload["looks"][0])[0]: lambda: scene})
    for look in payload["looks"]:
        looks.add(look)
        draw_map(renderer, look, scene, payload["cut_height"], background)
        renderer.remove(look)
    return {}


@cache
def _open(device: str) -> Renderer:
    """The renderer of this process."""
    return open_renderer("cuda", device=open_device(device))


def number_card(ordinal: int, cards: Path = CARDS) -> int:
    """The card's number on the machine: processes that were given one each all call it 0.

    A card that goes by its UUID has its place among `cards`, where the driver lists them. One that
    is not there, as a slice of a card, has a large number of its own.
    """
    shown = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")
    named = shown[ordinal].strip() if ordinal < len(shown) else ""
    if not named.startswith(("GPU-", "MIG-")):
        return int(named) if named.isascii() and named.isdecimal() else ordinal
    places = [n for n, uuid in enumerate(_list_cards(cards)) if uuid.startswith(named)]
    return places[0] if len(places) == 1 else zlib.crc32(named.encode())


def _list_cards(cards: Path) -> list[str]:
    """UUIDs of the machine's cards in the order of their buses; none where no driver is."""
    found = []
    with suppress(OSError, ValueError):
        for file in sorted(cards.glob("*/information")):
            lines = dict(
                line.split(":", 1) for line in file.read_text().splitlines() if ":" in line
            )
            found.append(lines.get("GPU UUID", "").strip())
    return found


def place_evenly(number: int) -> float:
    """0, 1/2, 1/4, 3/4, 1/8 and so on: evenly over [0, 1), however many numbers there are."""
    return int(f"{number:b}"[::-1], 2) / (1 << number.bit_length())


def _name_device(device: Device) -> str:
    return f"cuda:{getattr(device, 'ordinal', 0)}" if device.kind == "cuda" else device.kind
