"""Independent units of work in worker processes: generation, datasets, corpora."""

from gn0.jobs.run import ExecutorName, run_jobs

__all__ = ["ExecutorName", "run_jobs"]
