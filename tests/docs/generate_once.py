"""`gn0` as the documents' blocks find it: what many pages generate alike is generated once.

A generated scene depends on what was typed and on nothing else, not on where it is laid either,
which tests of `scene generate` hold, and one flat of the pages is half a minute of work. So the
first page to type one such command runs it, in its own folder; where another page types the same,
for a folder of whatever name, what came of it is laid there. Everything else is run as it is.

    python generate_once.py GN0 KEPT scene generate ...
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path


def main(real: str, kept: Path, typed: list[str]) -> int:
    out = Path(dict(itertools.pairwise(typed)).get("--out", ""))
    if typed[:2] != ["scene", "generate"] or out == Path() or out.exists():
        os.execv(real, [real, *typed])  # the same process: pages stop servers by its number
    alike = [f"anywhere{out.suffix}" if one == str(out) else one for one in typed]
    kept /= hashlib.blake2b("\0".join(alike).encode(), digest_size=12).hexdigest()
    here = str(out).encode()
    kept.mkdir(parents=True, exist_ok=True)
    with alone(kept):
        if not (kept / "said").exists():
            done = subprocess.run([real, *typed], stdout=subprocess.PIPE)
            sys.stdout.buffer.write(done.stdout)
            if done.returncode == 0:
                copy(out, kept / "out")
                (kept / "said").write_bytes(done.stdout.replace(here, b"\0"))
            return done.returncode
        copy(kept / "out", out)
        sys.stdout.buffer.write((kept / "said").read_bytes().replace(b"\0", here))
        return 0


def copy(source: Path, target: Path) -> None:
    """A scene folder, or a bare splat file."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target)
    else:
        shutil.copyfile(source, target)


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Who else wants the same waits for it."""
    with open(folder / "lock", "ab") as lock:
        with contextlib.suppress(ImportError):  # no such lock on this system
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:]))
