"""Any splat file as a 3DGS PLY or a compressed PLY, which every other tool reads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 scene convert capture.spz capture.ply
  gn0 scene convert capture.sog capture.compressed.ply
  gn0 scene convert streamed_sog_folder coarse.ply --level 2"""


class Args(Config, frozen=True):
    """What to convert, and into what.

    Attributes:
        source: a splat file of any format, or the folder of an unbundled SOG.
        out: the file to write: *.compressed.ply is packed to about a quarter, any other
            *.ply is plain.
        level: level of detail of a streamed SOG, 0 the finest.
        overwrite: replace the file if it exists.
    """

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SPLATS")]
    out: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    level: int | None = None
    overwrite: bool = False


def run(args: Args) -> int:
    """Convert, and say what came of it."""
    from gn0.cli.console import draw_progress, plain_text
    from gn0.errors import ConfigError, StorageError
    from gn0.gaussians.ply import save_ply
    from gn0.gaussians.ply_packed import save_ply_packed
    from gn0.gaussians.splat_files import load_cloud

    out = Path(args.out)
    if not out.name.lower().endswith(".ply"):
        raise ConfigError(
            f"cannot write {out.name!r}: only .ply and .compressed.ply are written",
            remedy="name the output something.ply or something.compressed.ply",
        )
    if out.exists() and not args.overwrite:
        raise StorageError(
            "file exists already", where=out, remedy="choose another name, or add --overwrite"
        )
    packed = out.name.lower().endswith(".compressed.ply")
    save = save_ply_packed if packed else save_ply
    with draw_progress("converting the file"):
        file = load_cloud(args.source, level=args.level)
        save(file.cloud, out, comments=[f"converted by GN0 from {file.format}"])
    dropped = f", {file.dropped:,} left out as non-finite" if file.dropped else ""
    print(
        f"{plain_text(str(out))}: {len(file.cloud):,} Gaussians{dropped}, "
        f"SH degree {file.cloud.sh_degree}, {out.stat().st_size / 1e6:,.2f} MB"
    )
    for note in file.notes:
        print(f"note: {plain_text(note)}")
    return 0
