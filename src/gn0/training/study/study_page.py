"""The page of a study, Markdown: tables with intervals, differences, verdicts, what was not run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from gn0.counted import counted
from gn0.errors import ConfigError, FormatError
from gn0.storage import read_bytes, write_text
from gn0.training.exams.walks import MEANS
from gn0.training.study.claims import (
    Judged,
    Verdict,
    find_difference,
    find_mean,
    judge_claim,
    scale_of,
)
from gn0.training.study.crossed_intervals import (
    ALIKE,
    DISCORDANT,
    FEW_SCENES,
    Estimate,
    smallest_effect,
)
from gn0.training.study.outcomes import Found
from gn0.training.study.page_before import MISSIONS, NOT_RUN, PageBefore, draw_cell, load_page
from gn0.training.study.study_file import Arm, Claim, Difference, Exam, PaperRow, Study, load_study

METRES = ("TL", "NE", "NE_straight")
_TITLES = {
    "SR": "SR", "SPL": "SPL", "OS": "OS", "TL": "TL m", "NE": "NE m", "NE_straight": "NE straight",
    "SR_straight": "SR straight", "SPL_straight": "SPL straight", "SR_1m": "SR 1 m",
    "SPL_1m": "SPL 1 m", "STOP": "STOP",
}  # fmt: skip
_COLUMNS = tuple(_TITLES)
_PAPER = ("TL", "NE_straight", "OS", "SR_straight", "SPL_straight")  # where its five stand
_ROW = ("policy", "seeds", *_TITLES.values(), "cut short")
_JUDGED = ("claim", "source", "measured", "claimed", "found, 95 %", "of", "verdict")
_DIFFERENCES = "Differences on the same episodes"
_DIFFERENCE = (
    "a − b", "exam", "missions", "metric", "difference, 95 %", "smallest seen", "of"
)  # fmt: skip
_STAGES = "Stages of training"
_VERDICTS: tuple[Verdict, ...] = ("held", "did not hold", "too close to tell", "not run")
_PAPER_EXAMS = ("seen", "unseen")


def write_study(
    study: Path | str,
    folder: Path | str,
    out: Path | str,
    *,
    onto: Path | str | None = None,
    say: Callable[[str], None] = print,
) -> list[Judged]:
    """Make the page of a study from what lies in a folder.

    Args:
        study: its description, see `gn0.training.study.study_file`.
        folder: of walks and runs.
        out: the page.
        onto: a page of this study from before, whose rows stand where they are of more seeds than
            what lies in the folder, and where no such walks are under way; it may be `out`.
        say: is told what is there but unfinished, and how many rows are of the page before.

    Returns:
        the claims with their verdicts.

    Raises:
        ConfigError, FormatError: the description makes no sense, walks do not belong together, or
            the page before is none of this study.
        TrainingError, StorageError: walks are damaged, or the page cannot be written.
    """
    described = load_study(study)
    if not Path(folder).is_dir():
        raise ConfigError("no such folder", where=folder, remedy="give that of the walks")
    found = Found(described, folder, say)
    preface = ""
    if described.preface:
        preface = read_bytes(Path(study).parent / described.preface).decode()
    before = PageBefore() if onto is None else load_page(onto)
    judged, verdicts = _judge(found, before)
    write_text(out, "\n".join(_list_lines(found, before, preface, judged, verdicts)) + "\n")
    if onto is not None:  # none: the page is of another study, or all was walked again
        say(f"{counted(len(before.used), 'row')} of {onto}, of more seeds than what is here")
    return judged


def _judge(found: Found, before: PageBefore) -> tuple[list[Judged], list[tuple[str, ...]]]:
    """Claims with their verdicts, and their rows."""
    judged, rows = [], []
    for claim in found.study.claims:
        one = judge_claim(found, claim)
        row = _tell_claim(one)
        seeds = one.estimate.seeds if one.estimate else 0
        kept = None
        if not _walks_anew(found, claim):
            kept = before.find("Verdicts", "", _JUDGED, *row[:4], more=seeds)
        if kept:
            verdict = next((told for told in _VERDICTS if kept[-1] == f"**{told}**"), None)
            if verdict is None:
                raise FormatError(
                    f"no verdict: {kept[-1]!r}",
                    file=before.path or "",
                    field=claim.text,
                    remedy=f"one of {', '.join(_VERDICTS)}",
                )
            one, row = replace(one, verdict=verdict), kept
        judged.append(one)
        rows.append(row)
    return judged, rows


def _walks_anew(found: Found, what: Difference | Claim) -> bool:
    """Whether walks that it speaks of have begun here, so that those of a page are others."""
    if what.metric not in MEANS:
        return False
    pairs = [(what.a, what.exam), *([(what.b, what.exam_b or what.exam)] if what.b else [])]
    return any(found.under_way(found.study.arm(arm), exam) for arm, exam in pairs)


def _list_lines(
    found: Found,
    before: PageBefore,
    preface: str,
    judged: Sequence[Judged],
    verdicts: Sequence[tuple[str, ...]],
) -> Iterator[str]:
    study = found.study
    made, whole = _count(found, before)
    yield f"# {study.title}\n"
    yield f"**{study.sentence.strip()}**\n"
    yield f"Of the {whole} policies and exams of this study, {made or 'none'} {_was(made)} run.\n"
    if preface:
        yield preface.strip() + "\n"
    yield "## What can be seen\n"
    yield from _say_power(study)
    yield "## Verdicts\n"
    yield (
        "A claim held where the whole 95 % interval is on its side of the number, did not hold "
        "where the whole interval is on the other side, and is too close to tell where the number "
        "lies inside. Claims and numbers were written down before anything was run.\n"
    )
    yield from _tell_verdicts(judged, verdicts)
    for table in study.tables:
        arms = [arm for arm in study.arms if arm.table == table.name]
        if not arms:
            continue
        yield f"## {table.title}\n"
        if table.about:
            yield f"{table.about.strip()}\n"
        if not any(arm.exams for arm in arms):
            yield "Nobody walks here; what the runs reported is in the last table.\n"
        for exam in study.exams:
            if any(exam.name in arm.exams for arm in arms):
                own = [arm for arm in arms if exam.name in arm.exams]
                yield from _tell_exam(found, before, table.title, exam, own)
        yield from _tell_missions(found, before, table.title, arms)
    yield from _tell_differences(found, before)
    yield from _tell_stages(found, before)


def _count(found: Found, before: PageBefore) -> tuple[int, int]:
    """Policies and exams that were walked, and all of them."""
    titles = {table.name: table.title for table in found.study.tables}
    exams = {exam.name: exam for exam in found.study.exams}
    cells = [(arm, exam) for arm in found.study.arms for exam in arm.exams]
    made = 0
    for arm, exam in cells:
        kept = _find_row(found, before, titles.get(arm.table, ""), arm, exams[exam])
        made += int(kept[1].split()[0]) if kept else len(found.outcomes(arm, exam))
    return made, sum(len(arm.seeds) for arm, _ in cells)


def _find_row(
    found: Found, before: PageBefore, section: str, arm: Arm, exam: Exam
) -> tuple[str, ...] | None:
    """The row of an arm's exam on the page before, where it is of more seeds than are here."""
    seeds = len(found.outcomes(arm, exam.name))
    if found.under_way(arm, exam.name):
        return None
    return before.find(section, exam.title, _ROW, _tell_name(arm), more=seeds)


def _tell_name(arm: Arm) -> str:
    return f"{arm.title} (`{arm.name}`)"


def _was(count: int) -> str:
    return "was" if count < 2 else "were"


def _say_power(study: Study) -> Iterator[str]:
    yield (
        "Two policies walk the same episodes, and their success rates are compared episode by "
        f"episode. If they end {100 * DISCORDANT:.0f} % of episodes differently, and episodes of "
        f"one scene are a little more alike than others (intraclass correlation {ALIKE}), then in "
        "80 of 100 studies a difference is seen that is at least as large as this; what seeds "
        "differ by comes on top:\n"
    )
    yield from _draw_table(
        ("exam", "scenes", "episodes", "smallest effect, points"),
        [
            (exam.title, f"{exam.scenes}", f"{exam.episodes}", f"{_tell_smallest(exam):.1f}")
            for exam in study.exams
            if exam.scenes and exam.episodes
        ],
    )


def _tell_smallest(exam: Exam) -> float:
    return 100 * smallest_effect(exam.scenes, exam.episodes)


def _tell_verdicts(judged: Sequence[Judged], rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    for verdict in _VERDICTS:
        texts = [" ".join(one.claim.text.split()) for one in judged if one.verdict == verdict]
        if verdict == "not run" and texts:
            yield f"* Not run: {len(texts)} of {len(judged)} claims."
        elif texts:
            yield f"* {verdict.capitalize()}: {'; '.join(texts)}."
    yield ""
    yield from _draw_table(_JUDGED, rows)


def _tell_claim(one: Judged) -> tuple[str, ...]:
    claim = one.claim
    bound = f"> {claim.above:g}" if claim.above is not None else f"< {claim.below:g}"
    what = _tell_metric(claim.metric) + (f", {claim.a} − {claim.b}" if claim.b else "")
    where = "" if claim.metric not in MEANS else f", {claim.exam}"
    where += f" − {claim.exam_b}" if claim.exam_b else ""
    where += f", {claim.missions}" if claim.missions != "all" else ""
    return (
        claim.text.strip(),
        claim.source,
        f"{what}{where}",
        bound,
        _tell(one.estimate, signed=bool(claim.b), digits=_digits(claim.metric)),
        _tell_basis(one.estimate),
        f"**{one.verdict}**",
    )


def _tell_metric(metric: str) -> str:
    unit = "points" if scale_of(metric) == 100 else "m" if metric in METRES else ""
    return f"{metric.replace('_', ' ')}" + (f" [{unit}]" if unit else "")


def _digits(metric: str) -> int:
    """Decimals: three for figures of training, such as entropy."""
    return 2 if metric in METRES else 1 if metric in MEANS else 3


def _tell_exam(
    found: Found, before: PageBefore, section: str, exam: Exam, arms: Sequence[Arm]
) -> Iterator[str]:
    yield f"### {exam.title}\n"
    rows: list[tuple[str, ...]] = []
    for arm in arms:
        own = found.outcomes(arm, exam.name)
        name = _tell_name(arm)
        kept = _find_row(found, before, section, arm, exam)
        if kept:
            rows.append((name, f"{kept[1].split()[0]} of {len(arm.seeds)}", *kept[2:]))
        elif not own:
            cells = [""] * (len(_COLUMNS) + 1)
            rows.append((name, f"0 of {len(arm.seeds)}", f"*{_tell_not_run(arm)}*", *cells[1:]))
        else:
            means = [find_mean(found, arm, exam.name, "all", metric) for metric in _COLUMNS]
            cells = [
                _tell(one, digits=_digits(metric))
                for metric, one in zip(_COLUMNS, means, strict=True)
            ]
            seeds = f"{len(own)} of {len(arm.seeds)}"
            rows.append((name, seeds, *cells, _tell_cut(found, arm, exam.name)))
        if arm.paper and exam.name in _PAPER_EXAMS:
            rows.append(_tell_paper(found.study, arm.paper, exam.name))
    yield from _draw_table(_ROW, rows)


def _tell_not_run(arm: Arm) -> str:
    return f"{NOT_RUN}: `{arm.command}`" if arm.command else NOT_RUN


def _tell_cut(found: Found, arm: Arm, exam: str) -> str:
    walks = [w for own in found.outcomes(arm, exam).values() for w in own.walks.values()]
    forwards = sum(w.forwards for w in walks)
    return f"{100 * sum(w.cut_short for w in walks) / forwards:.1f}" if forwards else "–"


def _tell_paper(study: Study, name: str, exam: str) -> tuple[str, ...]:
    row: PaperRow = next(one for one in study.paper if one.name == name)
    numbers = dict(zip(_PAPER, row.seen if exam == "seen" else row.unseen, strict=True))
    cells = [f"*{numbers[metric]:.1f}*" if metric in numbers else "" for metric in _COLUMNS]
    return (f"*the paper: {row.name} (l. {row.line})*", "", *cells, "")


def _tell_missions(
    found: Found, before: PageBefore, section: str, arms: Sequence[Arm]
) -> Iterator[str]:
    """Success by kind, in exams that somebody took."""
    titles = ("policy", *found.study.missions)
    for exam in found.study.exams:
        rows: list[tuple[str, ...]] = []
        for arm in arms:
            kept = None
            if exam.name in arm.exams and _find_row(found, before, section, arm, exam):
                kept = before.find(section, f"{MISSIONS}{exam.title}", titles, arm.title)
            cells = [find_mean(found, arm, exam.name, group) for group in found.study.missions]
            if kept:
                rows.append(kept)
            elif any(cells):
                rows.append((arm.title, *(_tell(cell) for cell in cells)))
        if rows:
            yield f"{MISSIONS}{exam.title}:\n"
            yield from _draw_table(titles, rows)


def _tell_differences(found: Found, before: PageBefore) -> Iterator[str]:
    if not found.study.differences:
        return
    yield f"## {_DIFFERENCES}\n"
    rows: list[tuple[str, ...]] = []
    missing: list[str] = []
    for one in found.study.differences:
        label = f"`{one.a}` − `{one.b}`"
        estimate = find_difference(found, one)
        key = (
            label,
            one.exam + (f" − {one.exam_b}" if one.exam_b else ""),
            one.missions,
            _tell_metric(one.metric),
        )
        seeds = estimate.seeds if estimate else 0
        kept = None
        if not _walks_anew(found, one):
            kept = before.find(_DIFFERENCES, "", _DIFFERENCE, *key, more=seeds)
        if kept:
            rows.append(kept)
        elif estimate is None:
            missing.append(label)
        else:
            rows.append(
                (
                    *key,
                    _tell(estimate, signed=True, digits=_digits(one.metric)),
                    _tell_least(one, estimate),
                    _tell_basis(estimate),
                )
            )
    if rows:
        yield from _draw_table(_DIFFERENCE, rows)
    if missing:
        yield f"{NOT_RUN.capitalize()}: {', '.join(dict.fromkeys(missing))}.\n"


def _tell_least(what: Difference, estimate: Estimate) -> str:
    """The smallest effect that would have been seen, from what was there before the run."""
    if scale_of(what.metric) != 100 or estimate.scenes < FEW_SCENES:
        return ""
    return f"{100 * smallest_effect(estimate.scenes, estimate.episodes):.1f}"


def _tell_stages(found: Found, before: PageBefore) -> Iterator[str]:
    figures = found.study.figures
    arms = [arm for arm in found.study.arms if arm.run]
    if not figures or not arms:
        return
    yield f"## {_STAGES}\n"
    yield "Means over seeds of what each run itself reported.\n"
    titles = ("run", *(figure.title for figure in figures))
    rows: list[tuple[str, ...]] = []
    for arm in arms:
        cells = []
        for figure in figures:
            values = list(found.figures(arm, figure).values())
            mean = figure.factor * sum(values) / len(values) if values else math.nan
            cells.append(f"{mean:.4g}" if values else "")
        name = _tell_name(arm)
        kept = before.find(_STAGES, "", titles, name) if not any(cells) else None
        rows.append(kept or (name, *(cells if any(cells) else [f"*{NOT_RUN}*", *cells[1:]])))
    yield from _draw_table(titles, rows)


def _tell(estimate: Estimate | None, *, signed: bool = False, digits: int = 1) -> str:
    if estimate is None:
        return ""
    sign = "+" if signed else ""
    mean = f"{estimate.value:{sign}.{digits}f}"
    if not math.isfinite(estimate.low):
        return f"{mean} (one seed)"
    return f"{mean} [{estimate.low:{sign}.{digits}f}, {estimate.high:{sign}.{digits}f}]"


def _tell_basis(estimate: Estimate | None) -> str:
    """Of how much an estimate is, and what it therefore speaks of."""
    if estimate is None:
        return ""
    seeds = counted(estimate.seeds, "seed")
    if not estimate.episodes:
        return seeds
    own = "" if estimate.unit == "scene" else ", these very scenes"
    scenes, episodes = counted(estimate.scenes, "scene"), counted(estimate.episodes, "episode")
    return f"{seeds}, {scenes}, {episodes}{own}"


def _draw_table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(titles)} |"
    yield f"|{' --- |' * len(titles)}"
    for row in rows:
        cells = (draw_cell(cell) for cell in row)
        yield f"| {' | '.join(cells)} |"
    yield ""
