"""A process that compiles the kernels whose calls it is told, a line each; see `kernel_list`.

It answers each line with one word: `compiled`, `kept` (it was in the cache), `busy` (another
process is at it), `nowhere` (there is no cache), or `failed`, after which it ends: so it holds no
lock of what did not compile.
"""

from __future__ import annotations

import logging
import sys
import warnings

from gn0.jit import is_locked, kernel_cache
from gn0.kernels.kernel_list import compile_call, find_kernel


def answer_calls() -> int:
    """Compile what comes in until nothing more comes; 1 after a failure."""
    warnings.simplefilter("ignore")  # the job itself says them
    for line in sys.stdin:
        said = _answer(line.strip())
        print(said, flush=True)  # noqa: T201 (its parent reads it)
        if said == "failed":
            return 1
    return 0


def _answer(call: str) -> str:
    if kernel_cache() is None:
        return "nowhere"
    try:
        if is_locked(find_kernel(call)):
            return "busy"
        return "compiled" if compile_call(call) else "kept"
    except Exception:  # the list may be of other code
        logging.getLogger(__name__).debug("not compiled: %s", call, exc_info=True)
        return "failed"


if __name__ == "__main__":
    sys.exit(answer_calls())
