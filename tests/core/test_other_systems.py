"""What Windows lacks is done without: every module imports there, and small jobs run.

The system is pretended: a child process without the calls that Windows' Python does not have
(docs.python.org, "Availability: Unix" of each). What Windows does otherwise is not shown here.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PRETENCE = '''
import os, signal, socket, sys
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None  # import of it fails
for module, names in {
    os: ("getuid", "geteuid", "getpgid", "killpg", "setsid", "fork", "sysconf", "sched_getaffinity",
         "sched_getscheduler", "sched_getparam", "sched_setscheduler", "fchmod"),
    socket: ("AF_UNIX", "SO_PEERCRED"),
    signal: ("SIGKILL", "SIGUSR1", "SIGUSR2", "SIGHUP", "SIGALRM"),
}.items():
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
'''  # fmt: skip


def run_pretended(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "GN0_DEVICE": "none", "GN0_CACHE": str(folder / "cache")}
    environment.pop("NUMBA_CACHE_DIR", None)
    return subprocess.run(
        [sys.executable, "-c", PRETENCE + code],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


def test_every_module_imports_without_unix_calls(tmp_path: Path) -> None:
    done = run_pretended(
        """
import importlib, pathlib, gn0
root = pathlib.Path(gn0.__file__).parent
for path in sorted(root.rglob("*.py")):
    parts = ("gn0", *path.relative_to(root).with_suffix("").parts)
    name = ".".join(parts).removesuffix(".__init__")
    optional = name.startswith(("gn0.testing", "gn0.viewer.live"))
    if name == "gn0.__main__" or optional:
        continue
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:  # what only extra `train` brings
        if error.name not in ("safetensors", "tokenizers", "torch", "transformers"):
            raise
""",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr


def test_files_are_written_and_locks_do_without(tmp_path: Path) -> None:
    done = run_pretended(
        """
from pathlib import Path
from gn0.export.staged_files import Shelf
from gn0.locked_folder import lock_folder, sweep_folder
from gn0.storage import Journal, folder_atomic, write_json
out = Path("out")
write_json(out / "one.json", {"a": 1})
with folder_atomic(out / "scene") as part:
    (part / "file").write_text("x")
with lock_folder(out):
    sweep_folder(out)
with Journal(out / "journal.jsonl") as journal:
    journal.append({"n": 1})
shelf = Shelf()
shelf.put(out / "shelf" / "picture", b"bytes")
shelf.sync()
print(sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()))
""",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr
    for name in ("one.json", "journal.jsonl", "file", "picture"):
        assert name in done.stdout


def test_one_drawing_process_says_that_it_needs_unix_sockets(tmp_path: Path) -> None:
    done = run_pretended(
        """
from gn0.errors import DeviceError
from gn0.render.share.connection import DrawConnection
try:
    DrawConnection("@nobody")
except DeviceError as error:
    print(error.what, error.remedy)
""",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert "Unix sockets" in done.stdout and "--backend cpu" in done.stdout


def test_what_is_synced_on_windows_is_open_for_writing(tmp_path: Path) -> None:
    """`os.fsync` is `_commit` there, which fails with EBADF on a handle opened for reading."""
    done = run_pretended(
        """
from pathlib import Path
import gn0.storage, gn0.export.export_card  # pathlib is ready before the system's name changes
os.name = "nt"
real_open, real_sync, writable = os.open, os.fsync, set()
def open_seen(path, flags, *rest):
    descriptor = real_open(path, flags, *rest)
    if flags & (os.O_RDWR | os.O_WRONLY):
        writable.add(descriptor)
    else:
        writable.discard(descriptor)
    return descriptor
def sync_seen(descriptor):
    if descriptor not in writable:
        raise OSError(9, "Bad file descriptor")
    real_sync(descriptor)
os.open, os.fsync = open_seen, sync_seen
import gn0.export.staged_files as shelf
os.name = "posix"
kept = shelf.Shelf()
kept.put(Path("picture").absolute(), b"bytes")
kept.sync()
""",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr
