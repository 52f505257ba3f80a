"""Who draws a dataset's pictures: the workers themselves, or one process that owns the GPU."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from gn0.data.dataset import DATASET_FILE, load_dataset_file
from gn0.data.settings import Backend, PictureSettings
from gn0.errors import ConfigError, DataError, Gn0Error
from gn0.jobs import ExecutorName
from gn0.jobs.process import count_cores
from gn0.render.open import choose_backend
from gn0.render.share.server_process import DrawServer
from gn0.suites import scene_drawing

MOST_WORKERS = 64


def choose_drawing(backend: str, out: Path | str) -> tuple[Backend, str]:
    """The renderer that is to draw a dataset, and why.

    Args:
        backend: "auto", "cpu" or "cuda". "auto" takes what the dataset in `out` was begun with,
            and the best that is here for a new one.
        out: the dataset folder, whether it is there or not.
    """
    if backend != "auto":
        return ("cuda" if backend == "cuda" else "cpu"), "asked for by name"
    if (Path(out) / DATASET_FILE).is_file():
        pictures = load_dataset_file(Path(out)).settings.pictures
        if pictures.layout != "none" or pictures.backend is not msgspec.UNSET:
            return pictures.drawn_by, "the dataset was begun with it"
    name, why = choose_backend("auto")
    return ("cuda" if name == "cuda" else "cpu"), why


def with_backend(settings: PictureSettings, backend: Backend) -> PictureSettings:
    """The settings, drawn by that backend."""
    name = msgspec.UNSET if backend == "cpu" else backend
    return msgspec.structs.replace(settings, backend=name)


def count_workers(workers: int, settings: PictureSettings) -> int:
    """Workers to start: as asked for; 0 means one, or a core each where a GPU draws for them."""
    if workers:
        return workers
    if settings.layout == "none" or settings.drawn_by not in scene_drawing.SHARED:
        return 1
    return max(1, min(count_cores(), MOST_WORKERS))


def check_drawn_here(settings: PictureSettings) -> None:
    """Refuse to draw with a backend that is not here.

    Raises:
        DataError: says which, and why it is not.
    """
    backend = settings.drawn_by
    if backend == "cpu":
        return
    try:
        choose_backend(backend)
        from gn0.device.open import find_device

        device, why = find_device()
    except (Gn0Error, ImportError) as error:
        device, why = None, str(error)
    if device is None:
        raise DataError(
            f"its pictures are drawn by backend {backend!r}, which does not run here: {why}",
            where="dataset.json",
            remedy="run it on a machine with such a GPU; the CPU's pictures differ by rounding",
        )


@contextlib.contextmanager
def open_drawing(
    settings: PictureSettings,
    *,
    executor: ExecutorName = "process",
    gpus: float = 0,
    batch: int = 0,
    server: DrawServer | None = None,
    note: Callable[[str], None] = lambda text: None,
) -> Iterator[DrawServer | None]:
    """The drawing process for a build's workers; None where each draws for itself.

    Args:
        settings: how pictures are drawn.
        executor: where the workers live.
        gpus: cards set aside for each worker of a cluster, which then draws for itself.
        batch: views a call; 0 takes the server's default.
        server: one that is running already, which goes on afterwards.
        note: called with each thing that a person should be told, once.

    Raises:
        ConfigError: the workers are on other machines, without cards of their own.
        DataError: the backend is not here.
    """
    if settings.layout == "none" or settings.drawn_by not in scene_drawing.SHARED:
        yield None
        return
    if executor != "process" and gpus:
        yield None
        return
    if executor != "process":
        raise ConfigError(
            "workers on other machines cannot use this one's GPU",
            where=f"--executor {executor}",
            remedy="give each a part of its own with --gpus, or use --backend cpu",
        )
    if server is not None:
        if server.backend != settings.drawn_by:
            raise ConfigError(
                f"the drawing process has backend {server.backend!r}, not {settings.drawn_by!r}",
                remedy="start one with the backend of the dataset",
            )
        yield server
        return
    try:
        server = DrawServer(
            settings.drawn_by, scene_drawing.LOADER, batch, note, pose=scene_drawing.POSER
        ).__enter__()
    except Gn0Error as error:
        raise DataError(
            f"pictures are to be drawn by backend {settings.drawn_by!r}, which does not run here: "
            f"{error.what}",
            where=error.where,
            remedy=error.remedy or "see `gn0 doctor`, or use --backend cpu",
        ) from None
    try:
        yield server
    finally:
        server.end()
