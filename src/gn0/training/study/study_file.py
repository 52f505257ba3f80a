"""`study.yaml`: which policies were to be trained and examined, and which claims are judged.

It is written before anything is run; the page that is made of it says what was not.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec

from gn0.config import Config
from gn0.errors import ConfigError, FormatError
from gn0.training.exams.walks import MEANS
from gn0.yaml_file import load_yaml

Names = Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]


class Exam(Config, frozen=True, kw_only=True):
    """Where policies are examined.

    Attributes:
        name: in folder patterns.
        title: in tables.
        scenes, episodes: how many there are to be, so that the smallest effect that would be seen
            can be stated beforehand; 0 where that is not known.
    """

    name: str
    title: str
    scenes: Annotated[int, msgspec.Meta(ge=0)] = 0
    episodes: Annotated[int, msgspec.Meta(ge=0)] = 0


class PaperRow(Config, frozen=True, kw_only=True):
    """A row of a table of the paper.

    Attributes:
        name: by which arms point to it.
        line: of the paper's source.
        seen, unseen: TL [m], NE [m], OS, SR, SPL [%].
    """

    name: str
    line: int
    seen: tuple[float, float, float, float, float]
    unseen: tuple[float, float, float, float, float]


class Arm(Config, frozen=True, kw_only=True):
    """A row: policies that were trained alike, one a seed.

    Attributes:
        name: by which claims point to it.
        title: in tables.
        table: the table that it stands in.
        command: what makes it, for rows that were not run.
        seeds: of its policies.
        exams: that it takes part in, by name.
        walks: folder of the walks, of `gn0 policy examine` or `gn0 bench run`; {arm}, {seed} and
            {exam} are filled in.
        run: folder of the training run, likewise; "" for none of its own.
        trained: whether seeds mean anything to it; one that is not stands against every seed.
        paper: name of the paper's row.
    """

    name: str
    title: str
    table: str
    command: str = ""
    seeds: Annotated[tuple[int, ...], msgspec.Meta(min_length=1)] = (0,)
    exams: tuple[str, ...] = ("unseen",)
    walks: str = "walks/{arm}-{seed}/{exam}"
    run: str = ""
    trained: bool = True
    paper: str = ""

    def folder(self, pattern: str, seed: int, exam: str = "") -> str:
        """A pattern with its names filled in."""
        for name, value in (("arm", self.name), ("seed", seed), ("exam", exam)):
            pattern = pattern.replace(f"{{{name}}}", str(value))
        return pattern


class Table(Config, frozen=True, kw_only=True):
    """A table of the page: its arms, in order, in each of their exams.

    Attributes:
        name: by which arms point to it.
        title: its heading.
        about: a sentence below.
    """

    name: str
    title: str
    about: str = ""


class Difference(Config, frozen=True, kw_only=True):
    """Two arms on the same episodes: a − b.

    Attributes:
        a, b: arms.
        exam, exam_b: of both, or of each, where episodes then are paired by their paths.
        missions: all, a kind (goal, instruction, instruction/detailed), or visible.
        metric: SR, SPL, OS, … of walks; or a figure of the training runs, such as entropy.
    """

    a: str
    b: str
    exam: str = "unseen"
    exam_b: str = ""
    missions: str = "all"
    metric: str = "SR"


class Claim(Config, frozen=True, kw_only=True):
    """A sentence that intervals decide; see `gn0.training.study.claims`.

    Attributes:
        text: what is claimed.
        source: who claims it, with the line.
        a: an arm; b: the one that it is held against, "" for none: then its own mean is judged.
        exam, exam_b, missions, metric: see `Difference`.
        above: the claim is that a − b (or a alone) is more than this; points, m or nat.
        below: that it is less.
    """

    text: str
    a: str
    source: str = ""
    b: str = ""
    exam: str = "unseen"
    exam_b: str = ""
    missions: str = "all"
    metric: str = "SR"
    above: float | None = None
    below: float | None = None


class Figure(Config, frozen=True, kw_only=True):
    """A number of the training runs, a column of the table of stages.

    Attributes:
        title: of the column.
        key: in `metrics.jsonl`; or card_seconds, seconds times the cards that trained together.
        at: which of its reports: first, last, lowest or highest.
        factor: it is shown times this.
    """

    title: str
    key: str
    at: str = "last"
    factor: float = 1.0


class Study(Config, frozen=True, kw_only=True):
    """All of a study.

    Attributes:
        title: of the page.
        sentence: what must be known before any number is read; stands at the top.
        preface: file beside this one, Markdown, how the study is made and read.
        missions: groups that are told apart, see `Difference`.
        exams, tables, arms, differences, claims, figures, paper: see there.
    """

    title: str
    sentence: str
    preface: str = ""
    missions: Names = ("all", "goal", "instruction", "visible")
    exams: Annotated[tuple[Exam, ...], msgspec.Meta(min_length=1)]
    tables: Annotated[tuple[Table, ...], msgspec.Meta(min_length=1)]
    arms: Annotated[tuple[Arm, ...], msgspec.Meta(min_length=1)]
    differences: tuple[Difference, ...] = ()
    claims: tuple[Claim, ...] = ()
    figures: tuple[Figure, ...] = ()
    paper: tuple[PaperRow, ...] = ()

    def arm(self, name: str) -> Arm:
        """The arm of that name; `load_study` has seen to it that there is one."""
        return next(arm for arm in self.arms if arm.name == name)

    def exam(self, name: str) -> Exam:
        """The exam of that name."""
        return next(exam for exam in self.exams if exam.name == name)


def load_study(path: Path | str) -> Study:
    """Read a study's description.

    Raises:
        StorageError: it cannot be read.
        FormatError: it is no study; says where.
        ConfigError: it names an arm, a table or an exam that it does not have.
    """
    try:
        study = msgspec.convert(load_yaml(path), Study)
    except msgspec.ValidationError as error:
        raise FormatError(
            f"not a study: {error}", file=path, remedy="see runs/ablation/study.yaml"
        ) from None
    _check_names(study, path)
    return study


def _check_names(study: Study, path: Path | str) -> None:
    arms = _collect("arm", [arm.name for arm in study.arms], path)
    exams = _collect("exam", [exam.name for exam in study.exams], path)
    tables = _collect("table", [table.name for table in study.tables], path)
    rows = _collect("row of the paper", [row.name for row in study.paper], path)
    for arm in study.arms:
        _check("table", [arm.table], tables, f"arm {arm.name}", path)
        _check("exam", arm.exams, exams, f"arm {arm.name}", path)
        _check("row of the paper", [arm.paper] if arm.paper else [], rows, f"arm {arm.name}", path)
    judged: list[Difference | Claim] = [*study.differences, *study.claims]
    for one in judged:
        where = f"{one.a} − {one.b}" if one.b else one.a
        _check("arm", [one.a, *([one.b] if one.b else [])], arms, where, path)
        _check("exam", [one.exam, *([one.exam_b] if one.exam_b else [])], exams, where, path)
        metrics = {*MEANS, *(figure.key for figure in study.figures)}
        _check("metric", [one.metric], metrics, where, path)
    for claim in study.claims:
        if (claim.above is None) == (claim.below is None):
            raise ConfigError(
                f"claim {claim.text!r} needs either `above` or `below`",
                where=path,
                remedy="above: 0 says that a is higher than b",
            )
    for figure in study.figures:
        _check("place", [figure.at], {"first", "last", "lowest", "highest"}, figure.title, path)


def _collect(kind: str, names: list[str], path: Path | str) -> set[str]:
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"two {kind}s {name!r}", where=path, remedy="name each differently")
    return set(names)


def _check(
    kind: str, names: list[str] | tuple[str, ...], known: set[str], where: str, path: Path | str
) -> None:
    for name in names:
        if name not in known:
            raise ConfigError(
                f"{where}: no {kind} {name!r}",
                where=path,
                remedy=f"known: {', '.join(sorted(known))}",
            )
