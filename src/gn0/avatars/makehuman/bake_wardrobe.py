"""What the package's people wear, taken from MakeHuman's outfits: tops and bottoms apart.

An outfit of MakeHuman is one file; its parts that hang together lie wholly above the hips or below
the chest. Islands of its texture tell a shirt from the jacket over it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gn0.avatars.makehuman.mhclo import Binding, Cloth, load_mhclo
from gn0.geometry import F64

_CHEST, _SOCK = 1.15, 200  # height that tops reach [m]; socks have fewer vertices than shoes


@dataclass(frozen=True)
class Source:
    """Where a piece comes from: a file below `base`, which parts of it, whether uv is kept."""

    file: str
    part: str = "all"
    strands: bool = False


SOURCES: dict[str, Source] = {
    "top/tee_slim": Source("clothes/female_casualsuit01/female_casualsuit01", "top"),
    "top/sports_top": Source("clothes/female_sportsuit01/female_sportsuit01", "top"),
    "top/sweater": Source("clothes/male_casualsuit02/male_casualsuit02", "top"),
    "top/collar_jacket": Source("clothes/male_casualsuit03/male_casualsuit03", "top"),
    "top/tee": Source("clothes/male_casualsuit04/male_casualsuit04", "top"),
    "top/parka": Source("clothes/male_casualsuit05/male_casualsuit05", "top"),
    "top/loose_tee": Source("clothes/male_casualsuit06/male_casualsuit06", "top"),
    "top/suit": Source("clothes/male_elegantsuit01/male_elegantsuit01", "top"),
    "bottom/slim": Source("clothes/female_casualsuit01/female_casualsuit01", "bottom"),
    "bottom/shorts": Source("clothes/female_casualsuit02/female_casualsuit02", "bottom"),
    "bottom/trousers": Source("clothes/male_casualsuit02/male_casualsuit02", "bottom"),
    "bottom/suit": Source("clothes/male_elegantsuit01/male_elegantsuit01", "bottom"),
    "shoes/trainers": Source("clothes/shoes01/shoes01", "shoes"),
    "shoes/laced": Source("clothes/shoes02/shoes02", "shoes"),
    "shoes/boots": Source("clothes/shoes03/shoes03", "shoes"),
    "socks/socks": Source("clothes/shoes01/shoes01", "socks"),
    "hat/hat": Source("clothes/fedora01/fedora"),
    "hat/cocked_hat": Source("clothes/fedora01/fedora_cocked"),
    **{f"hair/{name}": Source(f"hair/{name}/{name}", strands=True)
       for name in ("bob01", "bob02", "long01", "ponytail01", "short01", "short02", "short03",
                    "short04")},
    **{f"brows/{k}": Source(f"eyebrows/eyebrow{k:03}/eyebrow{k:03}", strands=True)
       for k in (1, 4, 7, 10)},
    "lashes/lashes": Source("eyelashes/eyelashes01/eyelashes01", strands=True),
}  # fmt: skip


def bake_wardrobe(
    folder: Path | str, sculpted: F64, say: Callable[[str], None] = lambda _: None
) -> dict[str, Cloth]:
    """All pieces of `SOURCES`, from the folder `base` of MakeHuman's assets.

    Args:
        folder: holds `clothes`, `hair`, `eyebrows` and `eyelashes`.
        sculpted: vertices of the mean body in the sculpted pose [V, 3] m.
        say: is told each piece.

    Raises:
        StorageError, FormatError: as `load_mhclo`.
    """
    pieces = {}
    for name, source in SOURCES.items():
        cloth = load_mhclo(Path(folder) / f"{source.file}.mhclo")
        pieces[name] = choose_part(cloth, sculpted, source.part, keep_uv=source.strands)
        say(name)
    return pieces


def choose_part(cloth: Cloth, sculpted: F64, part: str, *, keep_uv: bool) -> Cloth:
    """The faces of a part (`top`, `bottom`, `shoes`, `socks`, `all`) with their vertices alone.

    Without `keep_uv` the texture coordinates become the number of the face's texture island, the
    largest 0, in both of their values.
    """
    points = cloth.binding.fit(sculpted)
    piece = _connected(cloth.faces, len(points))
    keep = np.ones(len(cloth.faces), bool)
    for number in range(int(piece.max()) + 1):
        here = piece == number
        top = points[here, 1].max() > _CHEST
        sock = int(here.sum()) < _SOCK
        wanted = {"all": True, "top": top, "bottom": not top, "shoes": not sock, "socks": sock}
        if not wanted[part]:
            keep &= ~here[cloth.faces[:, 0]]
    faces, uv = cloth.faces[keep], cloth.uv[keep]
    if not keep_uv:
        uv = np.broadcast_to(_islands(faces, uv)[:, None, None], uv.shape).astype(np.float64)
    used = np.unique(faces)
    renumber = np.zeros(len(points), np.int32)
    renumber[used] = np.arange(len(used))
    covers = cloth.covers
    if len(used) < len(points) and len(covers):  # of an outfit: what lies nearer to this part
        others = np.setdiff1d(np.arange(len(points)), used)
        near = cKDTree(points[used]).query(sculpted[covers])[0]
        covers = covers[near <= cKDTree(points[others]).query(sculpted[covers])[0]]
    b = cloth.binding
    binding = Binding(b.refs[used], b.shares[used], b.offsets[used], b.lengths, b.units)
    return replace(cloth, binding=binding, faces=renumber[faces], uv=uv, covers=covers)


def _connected(quads: NDArray[np.integer], count: int) -> NDArray[np.int32]:
    edges = quads[:, [0, 1, 1, 2, 2, 3]].reshape(-1, 2)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (count, count))
    found: NDArray[np.int32] = connected_components(graph, directed=False)[1]
    return found


def _islands(faces: NDArray[np.integer], uv: F64) -> NDArray[np.int64]:
    """For each face the number of the texture island that it lies in, by falling size."""
    corner = np.concatenate([faces.reshape(-1, 1), uv.reshape(-1, 2).round(5)], axis=1)
    _, index = np.unique(corner, axis=0, return_inverse=True)
    quads = index.reshape(-1, 4)
    island = _connected(quads, int(index.max()) + 1)[quads[:, 0]]
    _, first, sizes = np.unique(island, return_index=True, return_counts=True)
    order = np.lexsort((first, -sizes))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank[np.unique(island, return_inverse=True)[1]]
