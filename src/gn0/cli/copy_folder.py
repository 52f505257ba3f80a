"""Copy a folder to or from an object store: s3://, gs://, hf:// and whatever else fsspec opens.

To a store, each file goes under the name of its content and the manifest goes last, so that the
folder is there whole or not at all; what is there already is not sent again. From a store, every
byte is checked. Other verbs take URLs as well: inputs are fetched, and `--out URL` is published
when the work is done.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 copy out/data s3://bucket/walks
  gn0 copy hf://datasets/lab/flats out/flats
  gn0 data build gs://bucket/suite --shard 2/8 --out gs://bucket/walks/shard-2"""


class Args(Config, frozen=True):
    """From where, to where; one of them is a URL.

    Attributes:
        source: a folder or file, or the URL of one.
        target: where it goes; a local folder must not be there yet.
    """

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    target: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TARGET")]


def run(args: Args) -> int:
    """Copy, and say how much."""
    from gn0.cli.console import draw_progress
    from gn0.errors import StorageError
    from gn0.remote import is_url, publish
    from gn0.storage import check_contained, storage_error

    source = Path(args.source)  # fetched already where it was a URL
    if not source.exists():
        raise StorageError("nothing is there", where=source, remedy="give a folder, or a URL")
    if source.is_dir():
        check_contained(source)
    if is_url(args.target):
        with draw_progress() as progress:
            publish(source, args.target, progress=progress)
    else:
        target = Path(args.target)
        if target.exists():
            raise StorageError("is there already", where=target, remedy="choose another TARGET")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copytree(source, target) if source.is_dir() else shutil.copyfile(source, target)
        except OSError as error:
            raise storage_error(error, target, "copy") from error
    files = [path for path in source.rglob("*") if path.is_file()] or [source]
    size = sum(path.stat().st_size for path in files)
    print(f"{counted(len(files), 'file')}, {size / 1e6:,.1f} MB: {args.target}")
    return 0
