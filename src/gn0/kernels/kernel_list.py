"""Which kernels GN0's jobs compile, with which types: recorded from real calls, in their order.

`kernel_list.txt` has a section per job and a line per call of a kernel from Python; the kernels
that those call are compiled with them. `python -m gn0_trials.kernel_record` of a checkout writes
it, and a test holds it to what the jobs call.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_suffix(".txt")


def read_list(text: str | None = None) -> dict[str, tuple[str, ...]]:
    """The calls of each job, as texts, in the order in which it came to them."""
    found: dict[str, list[str]] = {}
    job: list[str] = []
    for line in (FILE.read_text("utf-8") if text is None else text).splitlines():
        if line.startswith("["):
            job = found.setdefault(line.strip("[]"), [])
        elif line:
            job.append(line)
    return {name: tuple(calls) for name, calls in found.items()}


def write_list(jobs: dict[str, Iterable[str]]) -> str:
    """The text of a list that `read_list` reads."""
    return "\n".join(f"[{name}]\n" + "".join(f"{c}\n" for c in jobs[name]) for name in sorted(jobs))


def list_calls(*jobs: str) -> tuple[str, ...]:
    """What some jobs call, each call once, in order; of all jobs when none is named.

    Raises:
        KeyError: no such job.
    """
    known = read_list()
    return tuple(dict.fromkeys(call for job in jobs or known for call in known[job]))


def find_kernel(call: str) -> Any:
    """The kernel of a call.

    Raises:
        ImportError, AttributeError: it is not where the list says.
    """
    module, _, name = call.split(" ", 1)[0].rpartition(".")
    return getattr(import_module(f"gn0.{module}"), name)


def compile_call(call: str) -> bool:
    """Compile a kernel for a call and keep its code in the cache; whether it was not there yet.

    Raises:
        Exception: whatever Numba says where the list is of other code than this.
    """
    from gn0.kernels.kernel_types import read_type

    kernel = find_kernel(call)
    kernel.compile(tuple(read_type(text) for text in call.split()[1:]))
    return sum(kernel.stats.cache_misses.values()) > 0


def list_digest(calls: Iterable[str]) -> str:
    """Digest of calls."""
    return hashlib.blake2b("\n".join(calls).encode(), digest_size=6).hexdigest()
