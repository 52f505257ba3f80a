"""Scenes in their lights, named to a renderer: what the looks of one scene share is done once.

Reading a home's splats, checking them and finding their order takes longer than lighting them, and
an environment shows each home in three lights or more. Looks are loaded by several threads.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from threading import Lock
from typing import Any, NamedTuple

from gn0.gaussians.cloud import GaussianCloud
from gn0.progress import Progress, no_progress
from gn0.render.light import relight_cloud
from gn0.render.renderer import Renderer
from gn0.scenes.scene import Scene, read_splats
from gn0.sim.open import look_hash, split_look

_SHARED = 3  # scenes whose splats stay in host memory for their next look


class _AsMade(NamedTuple):
    cloud: GaussianCloud
    ready: Any  # what the renderer's `prepare` made of it


class SceneLooks:
    """How a renderer comes by scenes in their lights.

    Args:
        renderer: knows looks by their names (`gn0.sim.open.name_look`); None where nothing is
            drawn.
        scenes: scene id → how to get the scene; its splats are read from what each call gives.

    Attributes:
        progress: is told of looks as they are loaded, and of how many have a name, by whatever
            thread loads one.
    """

    def __init__(
        self, renderer: Renderer | None, scenes: Mapping[str, Callable[[], Scene]]
    ) -> None:
        self._renderer, self._scenes = renderer, scenes
        self.progress: Progress = no_progress
        self._named: set[str] = set()
        self._loaded: set[str] = set()  # once at least
        self._opened: dict[str, Scene] = {}  # nobody asks these for their splats
        self._as_made: OrderedDict[str, Future[_AsMade]] = OrderedDict()
        self._lock = Lock()

    def scene(self, scene_id: str) -> Scene:
        """The scene, opened once.

        Raises:
            Gn0Error: it cannot be read.
        """
        if scene_id not in self._opened:
            self._opened[scene_id] = self._scenes[scene_id]()
        return self._opened[scene_id]

    def add(self, look: str) -> None:
        """Name a scene in its light to the renderer, which loads it when it is drawn.

        Raises:
            Gn0Error: the scene cannot be read.
        """
        renderer = self._renderer
        assert renderer is not None
        scene_id, light = split_look(look)

        def load() -> Any:
            made = self._load(scene_id)
            lit = made.cloud if light is None else relight_cloud(made.cloud, light)
            found = made.ready if lit is made.cloud else renderer.prepare(lit, made.ready)
            with self._lock:
                self._loaded.add(look)
                self.progress("scenes in their lights", len(self._loaded), len(self._named))
            return found

        with self._lock:
            self._named.add(look)
        renderer.add(look, load, look_hash(self.scene(scene_id), light))

    def _load(self, scene_id: str) -> _AsMade:
        """The splats as they were made; threads that ask for the same wait for the first."""
        with self._lock:
            coming = self._as_made.get(scene_id)
            mine = coming is None
            if coming is None:
                coming = self._as_made[scene_id] = Future()
                if len(self._as_made) > _SHARED:
                    self._as_made.popitem(last=False)
            self._as_made.move_to_end(scene_id)
        if mine:
            try:
                assert self._renderer is not None
                cloud = read_splats(self._scenes[scene_id]())
                coming.set_result(_AsMade(cloud, self._renderer.prepare(cloud)))
            except BaseException as error:
                with self._lock:  # the next one tries again
                    if self._as_made.get(scene_id) is coming:
                        del self._as_made[scene_id]
                coming.set_exception(error)
        return coming.result()
