"""One line that says how a training run is going."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from time import monotonic

PATIENCE = 20.0  # s without a word, after which a run says at least where it is


@dataclass(frozen=True)
class TrainingReport:
    """How a run stands.

    Attributes:
        step, steps: updates made, and to be made; 0 where the end is not known.
        samples: learned from.
        loss: of the last report's batches, the mean.
        groups: losses by group of slots.
        first: share of first actions that are right.
        waypoint: median error of the twelfth waypoint of free answers [m]; None: not measured.
        walks: shares of what walks beside the learner came to, by word; NaN ones are not said.
    """

    step: int
    steps: int
    samples: int
    loss: float
    groups: Mapping[str, float]
    first: float
    waypoint: float | None = None
    walks: Mapping[str, float] = field(default_factory=dict)


def format_report(report: TrainingReport, rate: float, left: float | None) -> str:
    """A report as a line.

    Args:
        report: how the run stands.
        rate: samples a second; 0 where it is not known yet.
        left: seconds; None where they are not known.
    """
    steps = f"/{report.steps:,}" if report.steps else ""
    groups = " ".join(f"{name} {loss:.3f}" for name, loss in report.groups.items())
    walks = [f"{word} {share:.0%}" for word, share in report.walks.items() if share == share]
    parts = [
        f"step {report.step:,}{steps}",
        f"{report.samples:,} samples",
        f"{rate:,.0f}/s" if rate else "",
        f"loss {report.loss:.4f}" + (f" ({groups})" if groups else ""),
        f"first action {report.first:.1%}",
        "" if report.waypoint is None else f"12th waypoint {report.waypoint:.2f} m",
        ", ".join(walks),
        "" if left is None else f"{format_seconds(left)} left",
    ]
    return " · ".join(part for part in parts if part)


def format_seconds(seconds: float) -> str:
    """Seconds as 0:07, 12:05 or 3:04:05."""
    minutes, rest = divmod(max(round(seconds), 0), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


class ProgressLine:
    """Says a report's line every few seconds, with the rate and the time left of the last ones.

    Args:
        say: takes a line.
        seconds: between two lines at least; 0 says all.
        window: reports over which the rate is taken.
        clock: seconds.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        seconds: float = 5.0,
        window: int = 20,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._say, self._seconds, self._clock = say, seconds, clock
        self._seen: deque[tuple[float, int, int]] = deque(maxlen=window)
        self._said = -float("inf")
        self._pulsed = self._said
        self._first: tuple[float, int, int] | None = None  # s, step and samples

    def pulse(self, step: int, steps: int, samples: int, most: float | None = None) -> None:
        """Say where a run is that has said nothing for a while, between its reports.

        Args:
            step: that is done.
            steps: to be made.
            samples: learned from.
            most: seconds after which the run ends whatever is still to be made; None: no limit.
        """
        now = self._clock()
        self._first = self._first or (now, step, samples)
        began, first, before = self._first
        if now - max(self._said, self._pulsed, began) < PATIENCE:
            return
        self._pulsed = now
        rate, each = (samples - before) / (now - began), (now - began) / (step - first)
        left = each * (steps - step)
        end = f"/{steps:,}"
        if most is not None and most < left:
            left, end = most, ""
        when = format_seconds(left)
        self._say(f"step {step:,}{end} · {samples:,} samples · {rate:,.1f}/s · {when} left")

    def update(self, report: TrainingReport, most: float | None = None) -> None:
        """Take a report; the last one of a run is always said.

        Args:
            report: how the run stands.
            most: as for `pulse`; steps that will not be made are not said then.
        """
        now = self._clock()
        self._seen.append((now, report.step, report.samples))
        if now - self._said < self._seconds and report.step != report.steps:
            return
        self._said = now
        began, step, samples = self._seen[0]
        passed = now - began
        rate = (report.samples - samples) / passed if passed > 0 else 0.0
        left = None
        if report.steps and passed > 0 and report.step > step:
            left = (report.steps - report.step) * passed / (report.step - step)
        if most is not None and (left is None or most < left):
            left, report = most, replace(report, steps=0)
        self._say(format_report(report, rate, left))
