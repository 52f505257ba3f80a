"""Shared fixtures: third-party data when present, scratch caches, and nothing else."""

from __future__ import annotations

import compileall
import contextlib
import gc
import importlib.util
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

# before NumPy is loaded: workers side by side, each of whose linear algebra waits on every core by
# spinning, wait for each other; a third of all time went there
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gn0
from gn0.cache import trust_folder
from gn0.device.open import find_device
from gn0.storage import cache_dir

if TYPE_CHECKING:
    from gn0.suites.suite import Suite

ROOT = Path(__file__).resolve().parent.parent

# code of this checkout that is no part of the package: pytest finds it by `pythonpath`, the
# processes that tests start find it here
BESIDE = [str(ROOT / "benchmarks"), str(ROOT / "tests" / "trials")]
os.environ["PYTHONPATH"] = os.pathsep.join([*BESIDE, *filter(None, [os.environ.get("PYTHONPATH")])])

# the same examples on every run, so that a change is judged by itself; `make search` draws new ones
settings.register_profile("steady", derandomize=True, deadline=None, max_examples=60)
settings.register_profile("search", deadline=None, print_blob=True)
settings.load_profile("steady")

# where Python is told to write no bytecode, as in many containers, each process that a test starts
# would compile the package anew and each test worker all tests; only fault trials mean it
KEEPS_BYTECODE = sys.dont_write_bytecode and "GN0_FAULT_NOTES" not in os.environ
if KEEPS_BYTECODE:
    sys.dont_write_bytecode = False

# a shell starts background jobs deaf to Ctrl-C, and their children inherit it: tests that send it
# to a process of theirs mean it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def data_folder() -> Path | None:
    """Folder of third-party data: `$GN0_DATA`, else ../shared/data beside the checkout."""
    folder = Path(os.environ.get("GN0_DATA", ROOT.parent / "shared" / "data"))
    return folder if folder.is_dir() else None


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The data folder; the test is skipped, and says so, where it is absent."""
    folder = data_folder()
    if folder is None:
        pytest.skip("third-party data not present: set GN0_DATA to its folder")
    return folder


def load_beside(name: str) -> ModuleType:
    """A module that lies beside this file; tests are no packages that could import it."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that goes away with the tests, but for the kernels of the emulation.

    The fixtures that set it last until a session ends; compiled anew in each, kernels would cost
    every run of the tests a minute.
    """
    made, kept = tmp_path_factory.mktemp("cache"), cache_dir() / "emulation"
    if os.name == "posix" and trust_folder(kept):
        (made / "emulation").symlink_to(kept)
    return made


@pytest.fixture
def empty_cache(own_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache that one test begins with nothing in it but, again, the emulation's kernels."""
    (tmp_path / "cache").mkdir(mode=0o700)
    if (own_cache / "emulation").exists():
        (tmp_path / "cache" / "emulation").symlink_to(own_cache / "emulation")
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="session")
def flat_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flat of flats.py as a scene folder."""
    from gn0.scenes.folder import save_scene

    folder = tmp_path_factory.mktemp("scene") / "flat"
    save_scene(load_beside("flats").build_flat(), folder)
    return folder


@pytest.fixture(scope="session")
def flats_suite(flat_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """Six episodes in each of two flats, sixty steps at most."""
    from gn0.scenes.folder import save_scene
    from gn0.suites.suite import build_suite, load_suite

    root = tmp_path_factory.mktemp("flats")
    save_scene(load_beside("flats").build_flat("talf", mirrored=True), root / "talf")
    build_suite([flat_folder, root / "talf"], root / "suite", count=6, seed=3, max_steps=60)
    return load_suite(root / "suite")


@pytest.fixture(scope="session")
def no_processes() -> Callable[[], contextlib.AbstractContextManager[None]]:
    """Makes benchmark runs by one worker stay in this process: see workers_here.py."""
    found: Callable[[], contextlib.AbstractContextManager[None]]
    found = load_beside("workers_here").no_processes
    return found


@pytest.fixture
def worker_here(
    no_processes: Callable[[], contextlib.AbstractContextManager[None]],
) -> Iterator[None]:
    """In one test no run by one worker starts a process."""
    with no_processes():
        yield


@pytest.fixture(scope="module")
def workers_here(
    no_processes: Callable[[], contextlib.AbstractContextManager[None]],
) -> Iterator[None]:
    """In a whole file no run by one worker starts a process."""
    with no_processes():
        yield


@pytest.fixture
def cut_after_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[Path, list[Path]]]:
    """Run `make(folder)`; (the folder, what a kill at each change of it would have left).

    `begin(folder)` prepares it, undisturbed.

    Changes are seen where this process syncs, renames or removes a file, so `make` must not leave
    its work to others.
    """

    def record(
        make: Callable[[Path], object], begin: Callable[[Path], object] = lambda folder: None
    ) -> tuple[Path, list[Path]]:
        whole, cuts = tmp_path / "whole" / "out", tmp_path / "cuts"
        cuts.mkdir()
        begin(whole)
        states: list[dict[str, bytes]] = []

        def look() -> None:
            state = {str(p): p.read_bytes() for p in sorted(whole.rglob("*")) if p.is_file()}
            if whole.is_dir() and (not states or state != states[-1]):
                states.append(state)
                shutil.copytree(whole, cuts / f"{len(states):03d}" / "out")

        def seen(real: Callable[..., object]) -> Callable[..., object]:
            def call(*given: object, **named: object) -> object:
                answer = real(*given, **named)
                look()
                return answer

            return call

        with monkeypatch.context() as patch:
            for name in ("fsync", "replace", "unlink"):
                patch.setattr(os, name, seen(getattr(os, name)))
            make(whole)
        return whole, [folder / "out" for folder in sorted(cuts.iterdir())]

    return record


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The emulation is the device, and this hears of each episode that begins on it."""
    from gn0.sim.device_walkers import WalkersDevice

    monkeypatch.setenv("GN0_DEVICE", "host")
    heard: list[str] = []
    begin = WalkersDevice.begin

    def note(self: WalkersDevice, which, episodes) -> None:  # type: ignore[no-untyped-def]
        begin(self, which, episodes)
        heard.extend(episode.id for episode in episodes)

    monkeypatch.setattr(WalkersDevice, "begin", note)
    return heard


def _place_of(scope: str) -> int:
    """Place of a file, or of a test that goes by itself, among the dearest."""
    places = (place for place, end in enumerate(DEAREST) if scope.endswith(end))
    return next(places, len(DEAREST))


@pytest.hookimpl(optionalhook=True)  # without xdist nobody asks
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Side by side: a file stays in one process, for its fixtures; documents go one by one.

    Not by marks of groups: these travel in the names of tests, which pytest 9.2 does not let xdist
    change any more.
    """
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Dealer(LoadFileScheduling):
        _sorted = False

        def _split_scope(self, nodeid: str) -> str:
            alone = "::test_every_command_block_runs" in nodeid
            return nodeid if alone else super()._split_scope(nodeid)

        def _assign_work_unit(self, node: Any) -> None:
            if not self._sorted:  # xdist puts first what has the most tests
                self._sorted = True
                for scope in sorted(self.workqueue, key=_place_of, reverse=True):
                    if _place_of(scope) < len(DEAREST):
                        self.workqueue.move_to_end(scope, last=False)
            super()._assign_work_unit(node)

    return Dealer(config, log)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[object]:
    """On a machine with a card, only the tests that ask for one get it: `auto` is `cpu` else."""
    asked = "GN0_DEVICE" in os.environ or item.path.parent.name in ("gpu", "device")
    if asked or find_device()[0] is None:
        return (yield)
    os.environ["GN0_DEVICE"] = "none"
    try:
        return (yield)
    finally:
        del os.environ["GN0_DEVICE"]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[object]:
    """What only cycles hold goes with its file: 64 MB and more for each world of the emulation."""
    done = yield
    if "device" in item.path.name and (nextitem is None or nextitem.path != item.path):
        gc.collect()
    return done


# what takes a minute and more of `make test-all` or `make bae`, the dearest first: begun late, one
# would leave the other processes with nothing to do
DEAREST = (
    "data/test_drawing.py", "training/test_recurrent.py", "training/test_sharding.py",
    "[training.md]", "data/test_crash_points.py", "gaussians/test_fuzz.py",
    "training/test_dagger_verb.py", "device/test_compile.py", "e2e/test_runs.py",
    "training/test_runs.py", "[missions.md]", "training/test_processes.py",
    "cli/test_compile_ahead.py", "[following.md]", "[data.md]", "avatars/test_people.py",
    "bench/test_executors.py", "[README.md]", "viewer/test_live_browser.py",
    "policies/bae/test_policy_bae.py", "capture/test_strange_captures.py",
    "data/test_data_verbs.py", "procedural/test_refine_draft.py", "[export.md]",
    "testing/test_trust_trials.py", "[people.md]", "[labels.md]", "[for_students.md]",
    "jobs/test_jobs.py",
)  # fmt: skip


class Clock:
    """Says which tests take long, while they run: a run that is cut short still shows where.

    Lives where the terminal is: in the one process, or in the one that deals out the tests.
    """

    LONG, SILENT = 60.0, 240.0  # seconds until a finished, and a running test is named

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._begun = time.monotonic()
        self._running: dict[str, float] = {}
        self._named: set[str] = set()
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._running[nodeid] = time.monotonic()

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        took = time.monotonic() - self._running.pop(nodeid, time.monotonic())
        if took > self.LONG:
            self._say(f"{nodeid} took {took:.0f} s")

    def pytest_unconfigure(self) -> None:
        self._over.set()

    def _watch(self) -> None:
        while not self._over.wait(10.0):
            now = time.monotonic()
            for nodeid, since in list(self._running.items()):
                if now - since > self.SILENT and nodeid not in self._named:
                    self._named.add(nodeid)
                    self._say(f"{nodeid} has been running for {now - since:.0f} s")

    def _say(self, text: str) -> None:
        self._config.get_terminal_writer().line(
            f"\n[{time.monotonic() - self._begun:.0f} s] {text}"
        )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where slow tests alone are asked for, a file that marks none is not even read in."""
    if not config.getoption("markexpr").startswith("slow"):
        return None
    file = collection_path.name.startswith("test_") and collection_path.suffix == ".py"
    return True if file and b"slow" not in collection_path.read_bytes().lower() else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """What is collected is there to stay: it is no garbage, however often one looks."""
    if not session.config.pluginmanager.hasplugin("dsession"):  # who deals out tests collects none
        gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)  # what compiles a kernel makes objects by the million
    gc.enable()
    if KEEPS_BYTECODE:  # what tests write themselves is edited faster than bytecode can tell
        sys.dont_write_bytecode = True


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        if KEEPS_BYTECODE:
            compileall.compile_dir(Path(gn0.__file__).parent, quiet=2)
        config.pluginmanager.register(Clock(config), "clock")
