"""The page of a training run: `OUT/page.html`, curves, examinations, recipe and hashes.

One file that opens from disk, without network or scripts; written at the end of every stage, and by
`gn0 train page RUN` at any time.
"""

from __future__ import annotations

import html
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from gn0.training.runs.run_chart import Series, draw_chart

_AXES = ("step", "samples", "seconds")
# title -> names that are drawn together; what is in none of these is drawn alone
_CHARTS: dict[str, tuple[str, ...]] = {
    "loss": ("loss", "loss_*", "distance_loss"),
    "first action": ("first_taught", "first_action", "all_actions"),
    "success in closed loop": ("SR", "SPL", "OS", "SR_1m", "SR_straight"),
    "success by mission": ("SR_goal*", "SR_instruction*", "SR_follow*"),
    "STOP": ("STOP", "stop_recall", "stop_precision"),
    "FORWARDs cut short": ("cut_short", "cut_short_*"),
    "last waypoint, m": ("waypoint_12_median", "waypoint_12_mean"),
    "entropy, nat": ("entropy", "entropy_*"),
    "rewards": ("reward*",),
    "samples a second": ("samples_per_second",),
    "share of the learning rate": ("share_of_rate",),
    "norm of the gradient": ("gradient",),
}
_HIDDEN = ("SPL_*", "OS_*", "TL*", "NE*", "STOP_*", "steps*", "episodes*", "decisions*", "SR_*_*")
_TABLE = ("first_action", "waypoint_12_median", "SR", "SPL", "SR_1m", "OS", "STOP", "cut_short",
          "entropy")  # fmt: skip
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 2rem auto;
  max-width: 1160px; padding: 0 1rem }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem }
.charts { display: flex; flex-wrap: wrap; gap: 1rem }
figure { margin: 0; width: 360px } figcaption { font-weight: 600 }
svg { width: 100%; height: auto } svg text { font: 11px system-ui, sans-serif; fill: #555 }
table { border-collapse: collapse } td, th { padding: 2px 10px; border-bottom: 1px solid #ddd;
  text-align: left; vertical-align: top } td.n, th.n { text-align: right;
  font-variant-numeric: tabular-nums } code { word-break: break-all }
"""


def draw_run_page(name: str, record: Mapping[str, Any], lines: Sequence[Mapping[str, Any]]) -> str:
    """The page of a run, HTML.

    Args:
        name: of the run.
        record: what `run.json` says, see `RunRecord`.
        lines: those of `metrics.jsonl`.
    """
    return "\n".join(_list_lines(name, record, lines)) + "\n"


def _list_lines(
    name: str, record: Mapping[str, Any], lines: Sequence[Mapping[str, Any]]
) -> Iterator[str]:
    title = f"{record['stage']}: {name}"
    yield "<!doctype html>"
    yield '<html lang="en"><head><meta charset="utf-8">'
    yield '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
    yield "style-src 'unsafe-inline'\">"
    yield '<meta name="viewport" content="width=device-width">'
    yield f"<title>{_say(title)}</title><style>{_STYLE}</style></head><body>"
    yield f"<h1>{_say(title)}</h1><p>{_say(_tell_state(record, lines))}</p>"
    charts = list(_list_charts(lines))
    yield '<div class="charts">' if charts else "<p>Nothing was reported yet.</p>"
    for heading, series in charts:
        yield f"<figure><figcaption>{_say(heading)}</figcaption>{draw_chart(series)}</figure>"
    yield "</div>" if charts else ""
    once = [one for one in _list_others(lines) if len(one.points) == 1]
    if once:
        yield "<h2>Reported once</h2><table><tr><th>figure</th><th class=n>step</th>"
        yield "<th class=n>value</th></tr>"
        for one in once:
            step, value = one.points[0]
            yield f"<tr><td>{_say(_head(one))}</td><td class=n>{step}</td>"
            yield f"<td class=n>{_tell_value(value)}</td></tr>"
        yield "</table>"
    yield from _list_examinations(lines)
    yield "<h2>Recipe</h2>"
    yield from _draw_pairs(_flatten(record["recipe"]))
    yield "<h2>Hashes</h2>"
    yield from _draw_pairs(record["hashes"].items())
    yield "<h2>Sessions</h2><table><tr><th>began (UTC)</th><th class=n>from step</th>"
    yield "<th>device</th><th>command</th><th>packages</th></tr>"
    for one in record["sessions"]:
        packages = ", ".join(f"{package} {version}" for package, version in one["versions"].items())
        yield (
            f"<tr><td>{_say(one['began'])}</td><td class=n>{one['step']}</td>"
            f"<td>{_say(name_devices(one['device'], one['processes']))}</td>"
            f"<td><code>{_say(' '.join(one['command']))}</code></td><td>{_say(packages)}</td></tr>"
        )
    yield "</table></body></html>"


def name_devices(device: str, processes: int) -> str:
    """The device of a session, and how many of them."""
    return f"{processes} × {device}" if processes > 1 else device


def _say(text: object) -> str:
    return html.escape(str(text))


def _tell_state(record: Mapping[str, Any], lines: Sequence[Mapping[str, Any]]) -> str:
    last = lines[-1] if lines else {}
    end = record["finished"]
    told = [f"done at step {end}" if end is not None else "not finished"]
    if end is None and lines:
        told[0] += f": step {last['step']}"
    if isinstance(last.get("samples"), int | float):
        told.append(f"{last['samples']:,.0f} samples")
    if isinstance(last.get("seconds"), int | float):
        told.append(f"{last['seconds'] / 60:.1f} minutes of training")
    return ", ".join(told)


def _list_charts(lines: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, list[Series]]]:
    """Headings, and what is drawn below each."""
    left = _list_names(lines)
    for heading, patterns in _CHARTS.items():
        own = [name for name in left if _matches(name, patterns)]
        left = [name for name in left if name not in own]
        if own:
            yield heading, [_take(lines, name) for name in own]
    yield from ((_head(one), [one]) for one in _list_others(lines) if len(one.points) > 1)


def _list_others(lines: Sequence[Mapping[str, Any]]) -> list[Series]:
    """What has a chart of its own, or a row where it was reported once."""
    known = (*_HIDDEN, *itertools.chain.from_iterable(_CHARTS.values()))
    return [_take(lines, name) for name in _list_names(lines) if not _matches(name, known)]


def _head(series: Series) -> str:
    return series.name.replace("_", " ")


def _list_names(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    names = dict.fromkeys(name for line in lines for name in line if name not in _AXES)
    return [name for name in names if any(_is_number(line.get(name)) for line in lines)]


def _tell_value(value: float) -> str:
    return f"{value:,.0f}" if value == round(value) else f"{value:.3f}"


def _matches(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _take(lines: Sequence[Mapping[str, Any]], name: str) -> Series:
    points = [(line["step"], float(line[name])) for line in lines if _is_number(line.get(name))]
    return Series(name, tuple(points))


def _list_examinations(lines: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    examined = [line for line in lines if _is_number(line.get("first_action") or line.get("SR"))]
    names = [name for name in _TABLE if any(_is_number(line.get(name)) for line in examined)]
    if not examined:
        return
    yield "<h2>Examinations</h2><table><tr><th class=n>step</th><th class=n>samples</th>"
    yield "".join(f"<th class=n>{_say(name.replace('_', ' '))}</th>" for name in names) + "</tr>"
    for line in examined:
        cells = [f"{line['step']}", f"{line.get('samples') or 0:,.0f}"]
        cells += [f"{line[n]:.3f}" if _is_number(line.get(n)) else "" for n in names]
        yield "<tr>" + "".join(f"<td class=n>{cell}</td>" for cell in cells) + "</tr>"
    yield "</table>"


def _flatten(value: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of a described recipe, one a row."""
    for name, one in value.items():
        if isinstance(one, Mapping):
            yield from _flatten(one, f"{before}{name}.")
        else:
            yield f"{before}{name}", one if isinstance(one, str) else json.dumps(one)


def _draw_pairs(pairs: Any) -> Iterator[str]:
    yield "<table>"
    for name, value in pairs:
        yield f"<tr><td>{_say(name)}</td><td><code>{_say(value)}</code></td></tr>"
    yield "</table>"
