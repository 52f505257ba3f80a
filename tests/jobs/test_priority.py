"""No library may take the machine: encoders leave threads at the priority they had."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from gn0.jobs.priority import keep_priority
from gn0.render.video import VideoWriter

pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_getscheduler"), reason="this system has no scheduling policies"
)


def policies() -> set[int]:
    tasks = [int(path.name) for path in Path("/proc/self/task").iterdir()]
    return {os.sched_getscheduler(task) for task in tasks}


def test_writing_a_video_leaves_every_thread_as_it_was() -> None:
    """As root SVT-AV1 makes its caller a real-time thread, which starves the whole machine."""
    assert os.SCHED_FIFO not in policies()
    writer = VideoWriter((64, 48), 30, 5)
    for level in range(3):
        writer.add(np.full((48, 64, 3), 80 * level, np.uint8))
        assert os.SCHED_FIFO not in policies()
    assert writer.finish()
    assert os.SCHED_FIFO not in policies()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may ask for real time")
def test_a_thread_that_turns_real_time_is_turned_back() -> None:
    with keep_priority():
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
