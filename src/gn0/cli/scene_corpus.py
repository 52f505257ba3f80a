"""Make a corpus of scenes with train, unseen-validation and test splits from one description.

A run that was stopped goes on where it was; the same spec gives the same bytes for any number of
workers.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 scene corpus --spec corpus.yaml --out out/corpus --workers 2
  gn0 scene corpus --spec corpus.yaml --out out/corpus --executor ray --ray-address auto

a spec (YAML or JSON):
  name: tiny
  seed: 1
  parts:
    - {kind: apartment, count: 6, size: small}
    - {kind: office, count: 2, light: draft}
    - {path: worlds/small_house, split: test}
  splits: {train: 0.7, val_unseen: 0.15, test: 0.15}
  val_seen: 0.25   # of the training scenes, missions hold out paths
  held_out: {styles: [classic], variants: 0.25}   # never in training scenes"""


class Args(Config, frozen=True):
    """What to make, and where.

    Attributes:
        spec: the description, see below.
        out: folder of the corpus.
        workers: scenes made at a time; each takes 2 to 8 GB.
        executor: process on this machine, or ray.
        ray_address: address of a running Ray cluster.
        skip_failed: leave out scenes that cannot be made, instead of ending with an error.
        no_sheet: do not draw all scenes from above into corpus.jpg.
        fresh: forget what an earlier command left in the output folder, instead of going on.
    """

    spec: str
    out: str
    workers: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 1
    executor: Literal["process", "ray"] = "process"
    ray_address: str = ""
    skip_failed: bool = False
    no_sheet: bool = False
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False


def run(args: Args) -> int:
    """Make the scenes, and list them."""
    from pathlib import Path

    from gn0.cli.console import draw_progress
    from gn0.locked_folder import forget_folder
    from gn0.scenes.corpus import load_spec
    from gn0.scenes.corpus_build import JOURNAL_FILE, generate_corpus
    from gn0.storage import write_atomic
    from gn0.viewer.corpus_sheet import render_corpus

    if args.fresh:
        forget_folder(args.out, JOURNAL_FILE)
    with draw_progress() as progress:
        corpus = generate_corpus(
            load_spec(args.spec),
            args.out,
            base=Path(args.spec).resolve().parent,
            workers=args.workers,
            executor=args.executor,
            ray_address=args.ray_address,
            skip_failed=args.skip_failed,
            progress=progress,
        )
        picture = Path(args.out) / "corpus.jpg"
        if not args.no_sheet:
            sheet = render_corpus(corpus, args.out, progress=progress)
            write_atomic(picture, lambda stream: sheet.save(stream, "JPEG", quality=88))
    print(f"{'scene':<28}{'split':<12}{'m²':>7}{'objects':>9}{'rooms':>7}{'Gaussians':>12}")
    for scene in corpus.scenes:
        split = scene.split + (" +seen" if scene.val_seen else "")
        print(
            f"{scene.id:<28}{split:<12}{scene.area:>7.1f}{scene.objects:>9}{scene.rooms:>7}"
            f"{scene.gaussians:>12,}"
        )
    if corpus.left_out:
        print(f"left out, since they cannot be made: {', '.join(corpus.left_out)}")
    print(f"written to {args.out}" + ("" if args.no_sheet else f"; look at {picture}"))
    print(f"next: gn0 missions generate {args.out} --out MISSIONS")
    return 0
