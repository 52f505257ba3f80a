"""Times the drawing kernels stage by stage, and tries their sizes.

`python -m gn0_figures.tune` prints milliseconds a stage for the standard cases on the device that
`GN0_DEVICE` names (the host emulation draws tiny ones), and for the scenes of our own in the folder
that `GN0_FIGURE_SCENES` names; `--sweep` also tries other kernel sizes and says whether their
pictures are the same bytes. `--people` times kernels one by one instead, of pictures and of steps
among people, see `gn0_figures.tune_people_drawn` and `gn0_figures.tune_people`; with `--sweep` of
pictures for other sizes as well. Nothing is written.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gn0.device.device import Device
from gn0.errors import Gn0Error
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.draw import STAGES, Drawer
from gn0.render.cuda.pack import upload_cloud
from gn0.render.cuda.renderer import RendererCuda, RendererVisibleCuda
from gn0.render.cuda.replay import PicturesDevice
from gn0.render.cuda.tune import FEW, MANY, Tuning, choose_tuning
from gn0_figures.device import describe_device, is_emulation, open_figure_device
from gn0_figures.device_scenes import FigureScene, flat_scene, scene_of
from gn0_figures.flat import build_flat, flat_bev, flat_camera, flat_views
from gn0_figures.stages import time_stages
from gn0_figures.tune_people import list_lines
from gn0_figures.tune_people_drawn import print_people

_POSES = 4  # different sets of poses, taken in turn
_BLACK = np.zeros(3, np.float32)
_COLUMNS = (*STAGES, "all", "host")


@dataclass(frozen=True, eq=False)
class TuneCase:
    """Views of clouds, to be drawn again and again.

    Attributes:
        name: for the table.
        camera: of all views.
        views: [turns, V, 4, 4].
        clouds: shown in turn.
    """

    name: str
    camera: Camera
    views: F64
    clouds: list[CloudDevice]

    def pictures(self, drawer: Drawer) -> PicturesDevice:
        """Room for rgb and depth."""
        return drawer.pictures(self.camera, self.views.shape[1], ("rgb", "depth"))

    def draw(self, drawer: Drawer, pictures: PicturesDevice, turn: int) -> None:
        """Draw the views of a turn."""
        views = self.views[turn % len(self.views)]
        of = np.arange(len(views), dtype=np.int32) * len(self.clouds) // len(views)
        drawer.draw(
            self.camera, views, self.clouds, of.astype(np.int32), pictures=pictures,
            background=_BLACK,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SetsCase(TuneCase):
    """The same from visible sets, which are found once."""

    sets: RendererVisibleCuda

    def draw(self, drawer: Drawer, pictures: PicturesDevice, turn: int) -> None:
        """Draw the views of a turn, the long way."""
        batch = self.sets.full.batch
        batch.drawer = drawer
        views = self.views[turn % len(self.views)]
        drawn = batch.draw(
            self.camera, views, "scene", outputs=("rgb", "depth"), visible=self.sets.sets
        )
        for into, array in zip(
            (pictures.rgb, pictures.depth), (drawn.rgb, drawn.depth), strict=True
        ):
            assert into is not None and array is not None
            if turn == 0:
                drawer.device.upload(array.numpy(), into)


def build_cases(device: Device, only: str = "") -> Iterator[TuneCase]:
    """The standard cases (tiny ones on the host emulation) whose names hold `only`."""
    tiny = is_emulation(device)
    million, scenes, part = (3000, 3, 800) if tiny else (1_000_000, 64, 300_000)
    many, some = (4, 2) if tiny else (256, 16)
    small = flat_camera(32, 32) if tiny else flat_camera(224, 224)
    large = flat_camera(64, 48) if tiny else flat_camera(640, 480)
    above, view = flat_bev(64 if tiny else 1024)
    poses = flat_views(_POSES * many).reshape(_POSES, many, 4, 4)
    for degree in (0, 3):
        cases = (
            (f"224x224 x{many} SH{degree}", small, poses),
            (f"640x480 x1 SH{degree}", large, poses[:, :1]),
            (f"640x480 x{some} SH{degree}", large, poses[:, :some]),
            (f"BEV 1024 SH{degree}", above, np.broadcast_to(view, (1, 1, 4, 4))),
        )
        if any(only in case[0] for case in cases):
            clouds = [upload_cloud(device, build_flat(million, sh_degree=degree))]
            for name, camera, views in cases:
                if only in name:
                    yield TuneCase(name, camera, np.ascontiguousarray(views), clouds)
            del clouds
    if not tiny:
        yield from _scene_cases(device, "sets", partial(flat_scene, million), only, (True,))
        for folder in _own_scenes():
            yield from _scene_cases(
                device, folder.name, partial(_load, folder), only, (False, True)
            )
    name = f"224x224 x{many} of {scenes} scenes"
    if only in name:
        flats = [build_flat(part, seed=seed) for seed in range(min(scenes, 8))]
        clouds = [upload_cloud(device, flats[k % len(flats)]) for k in range(scenes)]
        yield TuneCase(name, small, poses, clouds)


def _own_scenes() -> list[Path]:
    folder = os.environ.get("GN0_FIGURE_SCENES")
    if not folder:
        return []
    return [path for name in ("apartment", "small_house") if (path := Path(folder) / name).is_dir()]


def _load(folder: Path) -> FigureScene:
    from gn0.scenes.folder import load_scene

    return scene_of(load_scene(folder), folder.name)


def _scene_cases(
    device: Device, name: str, load: Callable[[], FigureScene], only: str, forms: Sequence[bool]
) -> Iterator[TuneCase]:
    """The cases of a scene whose names hold `only`: from visible sets, or from all splats."""
    scene: FigureScene | None = None
    renderer: RendererCuda | None = None
    for sets_only in forms:
        for width, height, count in ((224, 224, 256), (640, 480, 16), (640, 480, 1)):
            form = " sets" if sets_only and name != "sets" else ""
            title = f"{name}{form} {width}x{height} x{count}"
            if only not in title or (sets_only and count == 1):
                continue
            scene = scene or load()
            camera = flat_camera(width, height)
            views = scene.views(_POSES * count, 1).reshape(_POSES, count, 4, 4)
            if not sets_only:
                yield TuneCase(title, camera, views, [upload_cloud(device, scene.cloud)])
                continue
            renderer = renderer or RendererCuda(scene.cloud, device=device)
            sets = RendererVisibleCuda(renderer, scene.cloud.content_hash, scene.floor, scene.eye)
            for batch in views:
                found = [c for c in sets.sets.locate(camera, batch) if c is not None]
                sets.sets.open(found, renderer.cloud)
            yield SetsCase(title, camera, views, [], sets)


def list_tunings(few_tiles: bool) -> list[Tuning]:
    """What to try on calls with few tiles, or with many."""
    many: list[dict[str, Any]] = [
        {"predicate": False},
        {"threads": 256, "stage": 256, "blocks": 4},
        {"blocks": 6},
        {"blocks": 8},
        {"capacity": 256},
        {"capacity": 1024},
        {"stage": 64},
        {"stage": 128},
        {"stage": 256},
        {"turns": 1},
        {"turns": 4},
        {"puts": 1},
        {"puts": 3},
        {"chunks": 4},
        {"spread": 4096},
        {"spread": 16384},
        {"large": 4},
        {"large": 9},
        {"cover_blocks": 3},
        {"cover_blocks": 5},
    ]
    few: list[dict[str, Any]] = [
        {"turns": 1},
        {"turns": 4},
        {"blocks": 2},
        {"blocks": 4},
        {"stage": 128},
        {"split": 0},
        {"split": 64},
        {"split": 256},
        {"spread": 2048},
        {"spread": 1024},
        {"spread": 512},
        {"large": 4, "spread": 1024},
        {"capacity": 1024},
        {"capacity": 256, "buckets": 256},
        {"puts": 1},
        {"puts": 3},
        {"large": 2},
        {"large": 4},
        {"large": 9},
    ]
    base = FEW if few_tiles else MANY
    tried = (replace(base, **change) for change in (few if few_tiles else many))
    return [base, *(tuning for tuning in tried if tuning != base)]


def name_tuning(tuning: Tuning) -> str:
    """Where it differs from the default."""
    base = Tuning()
    changed = [
        f"{f.name}={int(getattr(tuning, f.name))}"
        for f in fields(tuning)
        if getattr(tuning, f.name) != getattr(base, f.name)
    ]
    return " ".join(changed) or "default"


def time_case(case: TuneCase, device: Device, tuning: Tuning, repeat: int) -> str:
    """Milliseconds a stage, frames a second, entries a view, a digest of the first pictures."""
    drawer = Drawer(device, tuning)
    pictures = case.pictures(drawer)
    case.draw(drawer, pictures, 0)
    found = hashlib.sha256()
    for array in (pictures.rgb, pictures.depth):
        assert array is not None
        found.update(array.numpy().tobytes())
    taken = time_stages(drawer, lambda turn: case.draw(drawer, pictures, turn), repeat)
    milliseconds = " ".join(f"{taken[name]:8.3f}" for name in _COLUMNS)
    frames = case.views.shape[1] / taken["all"] * 1e3 if taken["all"] else 0.0
    listed = drawer.entries / case.views.shape[1]
    return f"{milliseconds} {frames:9.0f} {listed:9.0f}  {found.hexdigest()[:10]}"


def main(arguments: list[str]) -> None:
    """`[--sweep] [part of a case's name]`, or `--people [--sweep]`."""
    sweep = "--sweep" in arguments
    only = next((word for word in arguments if not word.startswith("--")), "")
    device = open_figure_device()
    if "--people" in arguments:
        print(describe_device(device))
        print_people(device, sweep=sweep)
        for line in list_lines(device):
            print(line, flush=True)
        return
    repeat = 1 if is_emulation(device) else 9
    head = " ".join(f"{name:>8}" for name in _COLUMNS)
    print(describe_device(device))
    print(f"{'ms':32} {head}    frames   entries  bytes")
    for case in build_cases(device, only):
        few_tiles = choose_tuning(case.camera, case.views.shape[1]) == FEW
        tunings = (
            list_tunings(few_tiles) if sweep else [choose_tuning(case.camera, case.views.shape[1])]
        )
        print(case.name, flush=True)
        for tuning in tunings:
            try:
                line = time_case(case, device, tuning, repeat)
            except Gn0Error as error:
                line = f"failed: {error}"
            print(f"  {name_tuning(tuning):30} {line}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
