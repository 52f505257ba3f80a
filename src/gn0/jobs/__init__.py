"""Independent units of work in worker processes: generation, datasets, corpora."""

from gn0.jobs.executors import ExecutorName
from gn0.jobs.run import run_jobs

__all__ = ["ExecutorName", "run_jobs"]
