"""Names of the files in a run's folder, for everything that reads one."""

from __future__ import annotations

from pathlib import Path

from gn0.storage import content_hash, read_bytes, safe_join

RESULTS, TRAJECTORIES, SUMMARY, RUN = (
    "results.jsonl",
    "trajectories.jsonl",
    "summary.json",
    "run.json",
)
BYTES_PER_EPISODE = 200_000  # journal and results of a long episode


def digest_run(run: Path | str) -> str:
    """Digest of the trajectories of a run folder.

    Raises:
        StorageError: no finished run there.
    """
    return content_hash(read_bytes(safe_join(run, TRAJECTORIES)))
