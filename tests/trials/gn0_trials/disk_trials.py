"""Full disks, read-only folders and failing disks, real where the system lends one.

`run_disk_trials` mounts a small file system of its own in a private mount namespace (Linux, root or
user namespaces) and starts this module there; nothing of it is seen outside. Each trial does a
piece of work on the bad disk, mends the disk, does it again, and looks at what is left.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import msgspec

from gn0.bench.report import write_report
from gn0.bench.runner import run_suite
from gn0.data.build import build_dataset
from gn0.data.settings import BuildSettings
from gn0.errors import Gn0Error, StorageError
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.storage import TEMPORARY_PREFIX, read_bytes
from gn0.suites.suite import build_suite, load_suite, open_suite

Fault = Literal["full", "read-only", "failing read"]
MOUNT = "small"
KILOBYTES = 24_000
DISK_FULL, READ_ONLY = "disk is full", "read-only"


class DiskTrial(msgspec.Struct, frozen=True, kw_only=True):
    """One piece of work on a bad disk.

    Attributes:
        work: what was tried.
        fault: what was wrong with the disk.
        error: what was raised, "" when the work must succeed all the same.
        clean: it was a StorageError with the right remedy, or no error where none is due.
        whole: nothing half-written was left in the place of the result.
        resumed: the same work succeeded when the disk was mended.
        leftovers: temporary files after that.
    """

    work: str
    fault: Fault
    error: str
    clean: bool
    whole: bool
    resumed: bool
    leftovers: int

    @property
    def ok(self) -> bool:
        """Whether the promise was kept."""
        return self.clean and self.whole and self.resumed and not self.leftovers


def why_no_small_disk(folder: Path) -> str:
    """Why this system lends no small disk; "" when it does."""
    if shutil.which("unshare") is None or not sys.platform.startswith("linux"):
        return "no unshare on this system"
    mount = folder / "probe"
    mount.mkdir(parents=True, exist_ok=True)
    tried = subprocess.run(
        [*_unshare(), "sh", "-c", 'mount -t tmpfs -o size=1m tmpfs "$0" && umount "$0"', mount],
        capture_output=True,
        check=False,
        timeout=60,
    )
    return tried.stderr.decode("utf-8", "replace").strip() if tried.returncode else ""


def _unshare() -> list[str]:
    return ["unshare", "-m"] if os.geteuid() == 0 else ["unshare", "-rm"]


def run_disk_trials(folder: Path, *, caches: bool = True) -> list[DiskTrial]:
    """All trials, on a file system of 24 MB that is theirs alone.

    Args:
        folder: scratch folder.
        caches: also the caches; these trials compile all kernels twice.

    Raises:
        RuntimeError: the trials themselves broke; shows their last words.
    """
    mount = folder / MOUNT
    mount.mkdir(parents=True, exist_ok=True)
    script = (
        f'mount -t tmpfs -o size={KILOBYTES}k tmpfs "$0" && exec "$1" -m gn0_trials.disk_trials '
        '"$0" "$2" "$3"'
    )
    done = subprocess.run(
        [*_unshare(), "sh", "-c", script, mount, sys.executable, folder, str(int(caches))],
        capture_output=True,
        check=False,
        timeout=900,
    )
    if done.returncode:
        raise RuntimeError(done.stderr.decode("utf-8", "replace")[-4000:])
    return msgspec.json.decode(done.stdout.splitlines()[-1], type=list[DiskTrial])


class SmallDisk:
    """The mounted file system: filled up, made read-only, mended."""

    def __init__(self, mount: Path) -> None:
        self.mount = mount
        self._filler = mount / "filler"

    def fill(self, leave: int = 0) -> None:
        """Leave no more than so many bytes free."""
        with open(self._filler, "ab", buffering=0) as stream:
            for size in (1 << 20, 1 << 12):
                with contextlib.suppress(OSError):
                    while self.free > leave + size:
                        stream.write(bytes(size))
            if not leave:
                with contextlib.suppress(OSError):
                    while True:
                        stream.write(bytes(4096))

    @property
    def free(self) -> int:
        """Bytes left."""
        return shutil.disk_usage(self.mount).free

    def mend(self) -> None:
        """Room again, and writable."""
        self._remount("rw")
        self._filler.unlink(missing_ok=True)

    def protect(self) -> None:
        """Make it read-only."""
        self._remount("ro")

    def _remount(self, how: str) -> None:
        subprocess.run(["mount", "-o", f"remount,{how}", self.mount], check=True)


def _trials(disk: SmallDisk, home: Path, caches: bool) -> Iterator[DiskTrial]:
    """Each piece of work on a full and on a read-only disk."""
    place = disk.mount
    scene = build_example_scene()
    save_scene(scene, home / "flat")
    suite = build_suite([home / "flat"], home / "suite", 6, 0, max_steps=40)
    run_suite(suite, "random", home / "run")

    def run_there() -> None:
        run_suite(suite, "random", place / "run")
        for name in ("results.jsonl", "trajectories.jsonl", "summary.json"):
            assert (place / "run" / name).read_bytes() == (home / "run" / name).read_bytes()

    def run_full() -> None:
        """The disk fills up in the middle of the run."""
        run_suite(
            suite,
            "random",
            place / "run",
            progress=lambda stage, done, _: (
                disk.fill() if (stage, done) == ("episodes", 2) else None
            ),
        )

    chunks = BuildSettings(chunk=1)

    def build_there() -> None:
        build_dataset(suite, place / "data", chunks)
        for path in (home / "data").rglob("*.*"):
            assert (
                path.read_bytes() == (place / "data" / path.relative_to(home / "data")).read_bytes()
            )

    def build_full() -> None:
        """The disk fills up in the middle of a dataset."""
        build_dataset(
            suite,
            place / "data",
            chunks,
            progress=lambda stage, done, _: disk.fill() if (stage, done) == ("parts", 2) else None,
        )

    build_dataset(suite, home / "data", chunks)
    work: list[tuple[str, Callable[[], object], Callable[[], object], Path]] = [
        ("bench run", run_full, run_there, place / "run" / "summary.json"),
        (
            "data build", build_full, build_there,
            place / "data" / "pictures" / "webdataset" / "manifest.json",
        ),
        (
            "bench report",
            lambda: write_report(home / "run", place / "page" / "report.html", videos=1),
            lambda: write_report(home / "run", place / "page" / "report.html", videos=1),
            place / "page" / "report.html",
        ),
        (
            "scene save (generate, import)",
            lambda: save_scene(scene, place / "flat"),
            lambda: (save_scene(scene, place / "flat"), load_scene(place / "flat").gaussians),
            place / "flat",
        ),
        (
            "suite build",
            lambda: build_suite([home / "flat"], place / "suite", 3, 0),
            lambda: (build_suite([home / "flat"], place / "suite", 3, 0),
                     load_suite(place / "suite")),
            place / "suite",
        ),
        (
            "a scene as its own suite",
            lambda: open_suite(home / "flat", beside=place / "own"),
            lambda: open_suite(home / "flat", beside=place / "own"),
            place / "own" / "suite",
        ),
    ]  # fmt: skip
    for fault in ("full", "read-only"):
        for name, bad, good, result in work:
            if fault == "read-only":
                disk.protect()
                begin = good if bad in (run_full, build_full) else bad
            else:
                begin = bad
                if bad not in (run_full, build_full):
                    disk.fill(leave=20_000)
            error, clean = _attempt(begin, DISK_FULL if fault == "full" else READ_ONLY)
            whole = not result.exists()
            disk.mend()
            resumed, _ = _attempt(good, "")
            yield DiskTrial(
                work=name, fault=fault, error=error, clean=clean, whole=whole,
                resumed=not resumed, leftovers=_leftovers(place),
            )  # fmt: skip
            for path in place.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    if caches:
        yield from _cache_trials(disk, home)
    error, clean = _attempt(lambda: read_bytes("/proc/self/mem"), "check the disk")
    yield DiskTrial(
        work="reading", fault="failing read", error=error, clean=clean, whole=True, resumed=True,
        leftovers=0,
    )  # fmt: skip


def _cache_trials(disk: SmallDisk, home: Path) -> Iterator[DiskTrial]:
    """A cache that cannot be written costs time, never a run: in a process that has none yet."""
    code = (
        "import sys; from gn0.sim.open import open_simulator; "
        "open_simulator(sys.argv[1], sensors={'bev'})"
    )
    cache = disk.mount / "cache"
    for fault in ("full", "read-only"):
        cache.mkdir()
        if fault == "full":
            disk.fill(leave=100_000)
        else:
            disk.protect()
        environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
        done = subprocess.run(
            [sys.executable, "-c", code, home / "flat"],
            env={**environment, "GN0_CACHE": str(cache)},
            capture_output=True,
            check=False,
        )
        disk.mend()
        words = done.stderr.decode("utf-8", "replace")
        yield DiskTrial(
            work="caches of kernels and pictures", fault=fault,
            error=words if done.returncode else "", clean=done.returncode == 0,
            whole=True, resumed=True, leftovers=_leftovers(disk.mount),
        )  # fmt: skip
        shutil.rmtree(cache)


def _attempt(work: Callable[[], object], remedy: str) -> tuple[str, bool]:
    """What a piece of work raised, and whether that was a clean error with that remedy."""
    try:
        work()
    except StorageError as error:
        return str(error), bool(remedy) and remedy in error.remedy
    except Gn0Error as error:
        return f"{type(error).__name__}: {error}", False
    except Exception as error:
        return f"foreign {type(error).__name__}: {error}", False
    return "", not remedy


def _leftovers(folder: Path) -> int:
    return sum(1 for path in folder.rglob("*") if path.name.startswith(TEMPORARY_PREFIX)) + sum(
        1 for _ in folder.rglob(".gn0-probe")
    )


def main(arguments: list[str]) -> int:
    """Run the trials on the mounted file system and print them as JSON."""
    mount, home, caches = arguments
    trials = list(_trials(SmallDisk(Path(mount)), Path(home), caches == "1"))
    sys.stdout.write(msgspec.json.encode(trials).decode() + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
