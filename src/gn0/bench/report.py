"""The report: one HTML file that opens from disk, with no network, under a strict content policy.

Everything is inside the file: style, script, maps, paths and clips. The content policy allows the
one style and the one script by their hashes and data: pictures and clips; nothing else runs or
loads, whatever names or instructions a suite brings along.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import jinja2
import msgspec
import numpy as np
from markupsafe import Markup

from gn0.bench.breakdown import Bar, split_categories, split_lengths, split_tiers
from gn0.bench.episode_clip import ClipScene, render_clip
from gn0.bench.follow_metrics import FOLLOW_METRICS, FollowMetrics, score_steps
from gn0.bench.follow_split import split_following, split_tables
from gn0.bench.intervals import Interval
from gn0.bench.metrics import METRICS, TOUCHED
from gn0.bench.people_replay import PeopleReplay
from gn0.bench.release_score import SIDE_BY_SIDE
from gn0.bench.report_follow import (
    distance_strip,
    tell_end,
    track_marks,
)
from gn0.bench.report_maps import (
    MapWindow,
    bev_symbol,
    data_uri,
    encode_jpeg,
    find_window,
    fit_view,
    path_marks,
    plan_symbol,
)
from gn0.bench.results import (
    EpisodeResult,
    EpisodeTrace,
    RunSummary,
    load_results,
    load_summary,
    load_traces,
)
from gn0.bench.spreadsheet import render_csv
from gn0.bench.standing import group_runs
from gn0.config import load_json
from gn0.counted import counted
from gn0.errors import BenchError, Gn0Error, brief
from gn0.missions.episode import Episode, MissionFollow
from gn0.missions.follow_rules import follow_rules
from gn0.progress import Progress, no_progress
from gn0.render.bev import BevPicture, render_bev
from gn0.render.light import LightCondition, relight_cloud
from gn0.render.open import build_renderer
from gn0.render.renderer import DrawnScene
from gn0.scenes.scene import Scene
from gn0.sim.open import look_hash
from gn0.sim.presets import find_preset
from gn0.storage import plain_path, safe_join, write_text
from gn0.suites.known_suites import known_suites, remember_suite
from gn0.suites.profiles import DIFFERENCES
from gn0.suites.run_files import RUN
from gn0.suites.suite import SUITE_FILE, Suite, load_suite, load_suite_scene
from gn0.suites.track import read_track

_SplitRow = dict[str, Any]

TEMPLATES = Path(__file__).parent / "templates"
STYLES = ("report.css", "follow.css")
BEV_PIXELS = 760  # px along the longer side, fewer when there are many scenes
BEV_PIXELS_MANY, MANY_SCENES = 380, 12
CEILING_CUT = 2.0  # m
CLIP_BUDGET = 24_000_000  # bytes of all clips together


@dataclass(frozen=True)
class RunData:
    """A run read back from disk."""

    folder: Path
    summary: RunSummary
    results: list[EpisodeResult]
    traces: dict[str, EpisodeTrace]
    about: dict[str, Any]


@dataclass(frozen=True)
class SceneArt:
    """A scene drawn once: its window, SVG symbols, and what its clips need under a light."""

    window: MapWindow
    symbols: Markup
    bev: str
    plan: str
    clips: Callable[[LightCondition | None], ClipScene]


def load_run(folder: Path | str) -> RunData:
    """A finished run.

    Raises:
        StorageError: no finished run there.
        FormatError: one of its files is damaged.
    """
    path = plain_path(folder)
    return RunData(
        folder=path,
        summary=load_summary(path),
        results=load_results(path),
        traces=load_traces(path),
        about=load_json(safe_join(path, RUN), dict[str, Any]),
    )


def find_suite(run: RunData, given: Suite | Path | str | None = None) -> Suite:
    """The suite of a run, checked by its hash.

    The path in `run.json` is a stranger's word and is never opened. A suite is looked for inside
    the run's own folder, and where this person has run or named one of that hash before.

    Args:
        run: the run.
        given: the suite, or its folder, as the caller was told it by a person.

    Raises:
        BenchError: it is not known here, it changed, or the given one is another.
    """
    wanted = run.summary.suite_hash
    if given is not None:
        suite = given if isinstance(given, Suite) else load_suite(given)
        suite = _as_run(suite, run)
        if suite.hash != wanted:
            raise BenchError(
                f"suite {suite.name!r} has hash {suite.hash}; the run is of suite "
                f"{run.summary.suite!r}, hash {wanted}",
                where=suite.folder,
                remedy="give the suite that was run",
            )
        remember_suite(wanted, suite.folder)
        return suite
    own = safe_join(run.folder, "suite")
    for place in (own, *known_suites(wanted)):
        if (place / SUITE_FILE).is_file():
            with suppress(Gn0Error):  # another may do
                suite = _as_run(load_suite(place), run)
                if suite.hash == wanted:
                    return suite
    told = brief(run.about.get("suite_folder", "nowhere"))
    raise BenchError(
        f"its suite {run.summary.suite!r}, hash {wanted}, is not known here any more, or it "
        f"changed; run.json says it was at {told}",
        where=run.folder,
        remedy="name the suite's folder with --suite DIR; it is checked by its hash",
    )


def _as_run(suite: Suite, run: RunData) -> Suite:
    suite = suite.with_profile(run.summary.profile).with_map_mode(run.summary.map_mode)
    return suite.with_track(read_track(run.summary.track))


def write_report(
    runs: Sequence[Path | str] | Path | str,
    out: Path | str | None = None,
    *,
    suite: Suite | Path | str | None = None,
    videos: int = 4,
    backend: str = "auto",
    bank: Path | str | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write the report of one run, or of several policies side by side.

    Args:
        runs: run folders of one suite.
        out: the HTML file; `report.html` in the first run's folder by default.
        suite: the suite that was run; by default found as `find_suite` says.
        videos: clips a run, half of them failures where there are any.
        backend: renderer backend for BEV and clips.
        bank: folder of the bank of people whom episodes name, for clips of them.
        progress: progress sink.

    Returns:
        Path of the report.

    Raises:
        BenchError: runs of different suites, or a suite that is not known here.
        StorageError, FormatError: a run is missing or damaged, or `out` cannot be written.
    """
    folders = [runs] if isinstance(runs, str | Path) else list(runs)
    if not folders:
        raise BenchError("no run given", remedy="name at least one run folder")
    loaded = [load_run(folder) for folder in folders]
    ran = find_suite(loaded[0], suite)
    for run in loaded[1:]:
        if run.summary.task_hash != ran.task_hash:
            raise BenchError(
                "ran another suite than the first run; their numbers cannot be compared",
                where=run.folder,
                remedy="report them separately",
            )
    path = Path(out) if out is not None else Path(folders[0]) / "report.html"
    page = _render(ran, loaded, videos, backend, progress, beside=path.parent, bank=bank)
    write_text(path, page)
    return path


def _render(
    suite: Suite,
    runs: list[RunData],
    videos: int,
    backend: str,
    progress: Progress,
    *,
    beside: Path,
    bank: Path | str | None = None,
) -> str:
    episodes = {episode.id: episode for episode in suite.episodes}
    names = _run_names(runs)
    ran = sorted({episodes[r.episode].scene_id for run in runs for r in run.results})
    wanted = {
        (number, episode_id)
        for number, run in enumerate(runs)
        for episode_id in choose_videos(run.results, videos)
    }
    rows: list[dict[str, Any]] = []
    symbols: list[Markup] = []
    spent, made = 0, 0
    for index, scene_id in enumerate(ran):
        progress("drawing scenes", index, len(ran))
        art = draw_scene(suite, scene_id, index, len(ran), backend, bank)
        symbols.append(art.symbols)
        for number, run in enumerate(runs):
            for result in run.results:
                episode = episodes[result.episode]
                if episode.scene_id != scene_id:
                    continue
                trace = run.traces[result.episode]
                row = _row(suite, art, names[number], number, episode, result, trace)
                if (number, result.episode) in wanted and spent < CLIP_BUDGET:
                    progress("rendering clips", made, len(wanted))
                    made += 1
                    lit = art.clips(episode.light)
                    clip = render_clip(
                        lit, episode, result, trace, title=names[number], progress=progress
                    )
                    spent += len(clip.mp4)
                    row["video"] = data_uri(clip.mp4, "video/mp4")
                    row["poster"] = data_uri(encode_jpeg(clip.poster, 75), "image/jpeg")
                rows.append(row)
    rows.sort(key=lambda row: (row["rank"], row["episode"], row["run"]))
    shown = [row for row in rows if row["video"]]
    for clip_number, row in enumerate(shown):
        row["clip"] = clip_number
    among = any(TOUCHED.key in run.summary.metrics for run in runs)
    columns = (*METRICS, TOUCHED) if among else METRICS
    return _fill(
        suite=suite,
        runs=[
            {
                "number": number,
                "name": names[number],
                "summary": run.summary,
                "cells": [_cell(info.key, info.unit, run.summary.metrics) for info in columns],
                "following": _following_cells(run.summary),
                "seconds": run.about.get("seconds"),
                "failures": Counter(r.status for r in run.summary.failed),
            }
            for number, run in enumerate(runs)
        ],
        metrics=columns,
        touches=among,
        follow_metrics=FOLLOW_METRICS,
        follow_split=_follow_tables(runs, episodes),
        groups=[
            {
                "title": group.title,
                "rank": group.rank,
                "members": group.members,
                "best": _best([runs[i] for i in group.members]),
            }
            for group in group_runs([run.summary for run in runs])
        ],
        rows=rows,
        histograms=_histograms(runs, episodes),
        table=data_uri(
            render_csv(
                [(name, run.results) for name, run in zip(names, runs, strict=True)], episodes
            ),
            "text/csv;charset=utf-8",
        ),
        folders=json.dumps([_way_to(run.folder, beside) for run in runs]),
        symbols=symbols,
        videos=shown,
        protocol=_protocol_rows(runs, names),
        released=[
            _released(run, name)
            for run, name in zip(runs, names, strict=True)
            if run.summary.release
        ],
        differences=DIFFERENCES,
    )


def _fill(**values: Any) -> str:
    style = "".join((TEMPLATES / name).read_text("utf-8") for name in STYLES)
    script = (TEMPLATES / "report.js").read_text("utf-8")
    policy = (
        "default-src 'none'; img-src data:; media-src data:; "
        f"style-src '{_csp_hash(style)}'; script-src '{_csp_hash(script)}'; "
        "base-uri 'none'; form-action 'none'"
    )
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html").render(
        style=Markup(style),  # noqa: S704 (our own file, byte for byte what the hash covers)
        script=Markup(script),  # noqa: S704
        content_policy=policy,
        counted=counted,
        **values,
    )


def _csp_hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _run_names(runs: Sequence[RunData]) -> list[str]:
    """A name a run: its own; where two share it, with the map mode, else with the folder's."""
    policies = [run.summary.label for run in runs]
    if len({run.summary.map_mode for run in runs}) > 1:
        policies = [f"{run.summary.label}, map {run.summary.map_mode}" for run in runs]
    return [
        f"{policy} ({run.folder.name})" if policies.count(policy) > 1 else policy
        for policy, run in zip(policies, runs, strict=True)
    ]


def choose_videos(results: Sequence[EpisodeResult], count: int) -> list[str]:
    """Episodes worth watching: half failures, half successes, longest tasks first."""

    def length(result: EpisodeResult) -> float:  # of following: its steps, as it has no one goal
        if isinstance(result.follow, FollowMetrics):
            return result.follow.steps
        return result.metrics.shortest_length if result.metrics is not None else 0.0

    shown = [r for r in results if r.success is not None]
    longest = sorted(shown, key=lambda r: (-length(r), r.episode))
    good = [r.episode for r in longest if r.success]
    bad = [r.episode for r in longest if not r.success]
    from_bad = min(len(bad), max(count // 2, count - len(good)))
    return bad[:from_bad] + good[: count - from_bad]


def draw_scene(
    suite: Suite,
    scene_id: str,
    index: int,
    scenes: int,
    backend: str,
    bank: Path | str | None = None,
) -> SceneArt:
    """Maps of a scene, and what its clips need; `bank` holds people whom episodes name."""
    scene = load_suite_scene(suite.scene_folder(scene_id), scene_id, suite.scene_hash(scene_id))
    window = find_window(scene.grid)
    pixels = BEV_PIXELS_MANY if scenes > MANY_SCENES else BEV_PIXELS

    @lru_cache(maxsize=1)  # splats in one light at a time
    def clips(light: LightCondition | None) -> ClipScene:
        cloud = scene.gaussians if light is None else relight_cloud(scene.gaussians, light)
        renderer = build_renderer(cloud, backend)
        return ClipScene(
            renderer=renderer,
            bev=draw_bev(scene, renderer, window, pixels, light),
            preset=find_preset(suite.about.camera),
            camera_height=suite.about.agent.camera_height,
            people=PeopleReplay(scene, DrawnScene(renderer), light, suite.about.profile, bank),
        )

    names = f"bev-{index}", f"plan-{index}"
    symbols = bev_symbol(names[0], window, clips(None).bev.rgb)
    return SceneArt(
        window, symbols + plan_symbol(names[1], window, scene), names[0], names[1], clips
    )


def draw_bev(
    scene: Scene,
    renderer: Any,
    window: MapWindow,
    pixels: int,
    light: LightCondition | None = None,
) -> BevPicture:
    """The BEV of a window, at most `pixels` along its longer side; `light` is the renderer's."""
    longer = max(window.x_max - window.x_min, window.y_max - window.y_min)
    return render_bev(
        look_hash(scene, light),
        renderer,
        np.array([[window.x_min, window.y_min], [window.x_max, window.y_max]]),
        max(longer / pixels, 0.005),
        CEILING_CUT,
        background=(0.07, 0.08, 0.1),
    )


def _row(
    suite: Suite,
    art: SceneArt,
    policy: str,
    number: int,
    episode: Episode,
    result: EpisodeResult,
    trace: EpisodeTrace,
) -> dict[str, Any]:
    """What the template shows of one episode of one run; rank 0 comes first."""
    m = result.metrics
    success = result.success
    outcome = result.status if success is None else ("success" if success else "failure")
    follow = _follow_row(suite, art.window, episode, trace)
    path = np.array(trace.poses, np.float64).reshape(-1, 3)[:, :2]
    return {
        "episode": episode.id,
        "scene": episode.scene_id,
        "instruction": episode.instruction,
        "policy": policy,
        "run": number,
        "outcome": outcome,
        "rank": {"failed": 0, "invalid": 1, "failure": 2, "success": 3}[outcome],
        "reason": result.reason or _explain(result),
        "metrics": m,
        "follows": follow is not None or isinstance(episode.mission, MissionFollow),
        "scored": result.follow if isinstance(result.follow, FollowMetrics) else None,
        "touches": result.touches if isinstance(result.touches, int) else None,
        "follow": follow,
        "view": fit_view(
            art.window,
            np.array([*episode.path, episode.goal, *path]) if follow is None else follow["places"],
        ),
        "can_view": episode.id.isprintable(),
        "bev": art.bev,
        "plan": art.plan,
        "marks": follow["marks"]
        if follow is not None
        else path_marks(
            art.window,
            reference=np.array(episode.path, np.float64).reshape(-1, 2),
            path=path,
            goal=episode.goal,
            goal_set=episode.goal_set,
            collided=trace.collided,
            success_radius=episode.success_within(suite.about.success_radius),
        ),
        "video": "",
        "poster": "",
        "clip": -1,
    }


def _follow_row(
    suite: Suite, window: MapWindow, episode: Episode, trace: EpisodeTrace
) -> dict[str, Any] | None:
    """What the template shows of an episode of following; None of any other."""
    record = trace.follow_record()
    if record is None:
        return None
    about = suite.about
    rules = follow_rules(about.profile)
    rules = msgspec.structs.replace(rules, max_steps=min(rules.max_steps, about.max_steps))
    steps = score_steps(record, rules)
    return {
        "marks": track_marks(window, record, steps),
        "places": np.vstack([record.poses[:, :2], record.people[record.target]]),
        "strip": distance_strip(record, steps, rules, title=f"distance over time: {episode.id}"),
    }


def _following_cells(summary: RunSummary) -> list[dict[str, Any] | None] | None:
    """The cells of a run's measures of following; None where nobody was followed."""
    if not isinstance(summary.following, dict):
        return None
    return [_cell(info.key, info.unit, summary.following) for info in FOLLOW_METRICS]


def _follow_tables(
    runs: Sequence[RunData], episodes: dict[str, Episode]
) -> list[tuple[str, list[tuple[str, list[_SplitRow]]]]]:
    """What is split by, and of each word of it a row of cells a run."""
    splits = [split_following(run.results, episodes) for run in runs]
    tables = split_tables([split if isinstance(split, dict) else None for split in splits])
    return [
        (
            table["kind"],
            [(word, [_split_row(own, number) for number, own in enumerate(found) if own])
             for word, found in table["rows"]],
        )
        for table in tables
    ]  # fmt: skip


def _split_row(found: dict[str, Interval], number: int) -> _SplitRow:
    """The cells of a run's measures, and of how many episodes they are."""
    cells = [_cell(info.key, info.unit, found) for info in FOLLOW_METRICS]
    return {"run": number, "count": found["SR"].count, "cells": cells}


def _histograms(
    runs: Sequence[RunData], episodes: dict[str, Episode]
) -> list[tuple[str, str, list[Bar]]]:
    """Title, what the bars are of, and the bars."""
    results = [run.results for run in runs]
    found = [
        ("By path length", "shortest way", split_lengths(results)),
        ("By goal category", "category", split_categories(results, episodes)),
        ("By tier of goals", "tier", split_tiers(results, episodes)),
    ]
    return [entry for entry in found if entry[2]]


def _way_to(folder: Path, beside: Path) -> str:
    """A run's folder as seen from the page's: the page works out the rest where it is opened."""
    try:
        way = os.path.relpath(folder, beside)
    except ValueError:  # another drive
        way = str(folder.absolute())
    return Path(way).as_posix()


def _released(run: RunData, name: str) -> dict[str, Any]:
    """The official harness's numbers of a run, ours beside them, and what it did."""
    theirs = run.summary.release
    assert theirs is not None
    rows = []
    for key, title, ours, factor, unit in SIDE_BY_SIDE:
        mean = run.summary.metrics.get(ours)
        rows.append(
            {
                "title": title,
                "unit": unit,
                "theirs": f"{getattr(theirs, key) * factor:.2f}",
                "ours": "–" if mean is None else f"{mean.mean * factor:.2f}",
            }
        )
    return {"name": name, "rows": rows, "report": theirs, "valid": run.summary.valid}


def _explain(result: EpisodeResult) -> str:
    m = result.metrics
    if isinstance(result.follow, FollowMetrics):
        return "" if result.follow.success else tell_end(result.follow.end, False)
    theirs = result.release
    if theirs is not None and theirs.forced_stop is not None:
        verdict = "success" if theirs.success else "failure"
        return (
            f"stopped by the gn0-release harness at action {theirs.forced_stop}, which counts it "
            f"as a {verdict}"
        )
    if m is None or m.success:
        return ""
    left = f"{m.navigation_error_geodesic:.2f} m from the goal"
    if result.stopped:
        return f"stopped {left}" + (", after being within reach" if m.oracle_success else "")
    return f"ran out of steps {left}"


def _cell(key: str, unit: str, metrics: dict[str, Interval]) -> dict[str, Any] | None:
    interval = metrics.get(key)
    if interval is None:
        return None
    scale = 100.0 if unit == "%" else 1.0
    digits = 1 if unit in ("%", "") else 2
    values = [v * scale for v in (interval.mean, interval.low, interval.high)]
    words = [f"{value:.{digits}f}" for value in values]
    if unit == "%":  # a table full of 100.0–100.0 is wider than its page
        words = ["100" if word == "100.0" else word for word in words]
    mean, low, high = words
    bar = [round(v, 2) for v in values] if unit == "%" else None
    return {"mean": mean, "low": low, "high": high, "bar": bar}


def _best(runs: Sequence[RunData]) -> dict[str, float]:
    """The best mean of each metric that has a better way, when there is something to compare.

    Only runs that were told alike are given.
    """
    best: dict[str, float] = {}
    for info in (*METRICS, TOUCHED):
        means = [m[info.key].mean for m in (r.summary.metrics for r in runs) if info.key in m]
        if len(means) > 1 and info.better and max(means) > min(means):
            best[info.key] = max(means) if info.better == "up" else min(means)
    return best


def _protocol_rows(runs: Sequence[RunData], names: Sequence[str]) -> list[dict[str, Any]]:
    """Protocol rows; what differs between runs is told a run."""
    rows = []
    cards = [dict(run.summary.protocol) for run in runs]
    for what in dict.fromkeys(key for card in cards for key in card):
        told = [card.get(what, "") for card in cards]
        if len(set(told)) == 1:
            rows.append({"what": what, "how": [("", told[0])]})
        else:
            rows.append({"what": what, "how": list(zip(names, told, strict=True))})
    return rows
