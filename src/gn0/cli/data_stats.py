"""One page about what a dataset holds: paths, turns, actions, words, goals, scenes, coverage.

Writes stats.html, which opens from disk and runs no script, and stats.json with the same numbers.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 data stats out/data
  gn0 data stats out/data --out out/stats --sheets 0"""


class Args(Config, frozen=True):
    """The dataset and the page.

    Attributes:
        folder: a dataset folder.
        out: folder of stats.html and stats.json; default: the dataset itself.
        sheets: sample sheets on the page; they need the scenes' splats or cached pictures.
        seed: seed of the choice of samples shown.
    """

    folder: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE_OR_DATASET")]
    out: str = ""
    sheets: Annotated[int, msgspec.Meta(ge=0, le=50)] = 4
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0


def run(args: Args) -> int:
    """Count, draw, write."""
    import io
    from pathlib import Path

    from gn0.cli.console import draw_progress
    from gn0.counted import counted
    from gn0.data.dataset import open_dataset
    from gn0.data.dataset_stats import measure_dataset
    from gn0.data.people_stats import describe_people
    from gn0.data.sample_sheet import draw_sheet
    from gn0.seeds import random_stream
    from gn0.storage import write_json, write_text
    from gn0.viewer.stats_page import render_stats

    dataset = open_dataset(args.folder)
    out = Path(args.out or args.folder)
    with draw_progress() as progress:
        stats, coverage = measure_dataset(dataset, progress)
        names = list(dataset.sampled)
        rng = random_stream(args.seed, "sample sheets")
        chosen = sorted(rng.permutation(names)[: args.sheets].tolist()) if names else []
        sheets = []
        for k, name in enumerate(chosen):
            progress("sample sheets", k, len(chosen))
            stream = io.BytesIO()
            draw_sheet(dataset, name, 3).save(stream, "JPEG", quality=84)
            instruction = dataset.episode(name).instruction
            sheets.append((f"{name}: {instruction}", stream.getvalue()))
        progress("sample sheets", len(chosen), len(chosen))
    write_json(out / "stats.json", msgspec.to_builtins(stats))
    write_text(out / "stats.html", render_stats(stats, coverage, sheets))
    print(
        f"{counted(sum(stats.samples.values()), 'sample')}, "
        f"{counted(stats.steps.count, 'episode')}, {counted(stats.paths, 'path')}, "
        f"{counted(len(stats.scenes), 'scene')}; mean path {stats.length.mean:.1f} m"
    )
    shares = ", ".join(f"{name} {share:.1f} %" for name, share in stats.actions.items())
    print(f"actions: {shares}")
    if stats.people is not msgspec.UNSET:
        print(describe_people(stats.people))
    print(f"written to {out / 'stats.html'}: open it in a browser")
    return 0
