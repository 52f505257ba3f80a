"""Fuzz targets of all splat formats but PLY.

Most damage to a packed file ends at a checksum. So archives have their checksums made to agree
again, and packed streams are also mutated bare: that is how mutants get to the decoders.
"""

from __future__ import annotations

import gzip
import io
import zlib
from pathlib import Path

import numpy as np

from gn0.errors import FormatError
from gn0.gaussians.cloud_source import CloudSource
from gn0.gaussians.sog_zip import load_zip_directory
from gn0.gaussians.splat_files import load_cloud
from gn0.testing.splat_writers import (
    build_gltf,
    build_ksplat,
    build_sog,
    build_sog_files,
    build_sog_streamed,
    build_splat,
    build_spz,
)
from gn0_trials.fuzz import FuzzTarget
from gn0_trials.splat_corpus import check_cloud_file, small_cloud

_META_TOKENS = (
    b'"count":', b'"version":', b'"files":', b'"codebook":', b'"mins":', b'"maxs":', b'"shN":',
    b'"bands":', b"null", b"[]", b"{}", b"true", b"-1", b"1e300", b'"../means_l.webp"',
    b'"/etc/passwd"', b'"meta.json"', b'"means_l.webp",', b'"lods":', b'"children":', b'"0":',
    b'"offset":', b'"environment":', b"1.5",
)  # fmt: skip
_GLTF_TOKENS = (
    b'"uri":', b'"byteOffset":', b'"byteLength":', b'"byteStride":', b'"count":', b'"matrix":',
    b'"scale":', b'"children":', b'"mesh":', b"5120", b"5121", b"5122", b"5123", b"5125", b"5126",
    b'"VEC3"', b'"VEC4"', b'"SCALAR"', b'"normalized":true,', b"null", b"[]", b"{}", b"-1",
    b"1e300", b'"splats.bin"', b'"../splats.bin"', b'"data:;base64,AAAA"', b'"sparse":{},',
    b'"KHR_gaussian_splatting:OPACITY":', b'"COLOR_0":', b'"mode":',
)  # fmt: skip


def splat_target() -> FuzzTarget:
    """Fuzz target: .splat."""
    corpus = {f"n{n}": build_splat(small_cloud(n, 0)) for n in (1, 5, 40)}
    return FuzzTarget("splat", load_cloud, corpus, check_cloud_file, suffix=".splat")


def ksplat_target() -> FuzzTarget:
    """Fuzz target: .ksplat of every compression."""
    corpus = {
        f"c{c}-sh{d}": build_ksplat(small_cloud(9, d), c, bucket=4)
        for c, d in ((0, 0), (1, 0), (1, 1), (2, 2), (0, 3))
    }
    return FuzzTarget("ksplat", load_cloud, corpus, check_cloud_file, suffix=".ksplat")


def spz_target() -> FuzzTarget:
    """Fuzz target: SPZ 1 to 4, packed and bare."""
    corpus = {
        f"v{v}-sh{d}{'' if packed else '-bare'}": build_spz(small_cloud(5, d), v, packed=packed)
        for v, d in ((1, 0), (2, 1), (2, 3), (3, 2), (4, 0), (4, 3))
        for packed in ((False, True) if v < 4 else (True,))
    }

    def finish(data: bytes, rng: np.random.Generator) -> bytes:
        if data.startswith(b"NGSP") and rng.random() < 0.3:
            return gzip.compress(data, 1, mtime=0)
        return data

    return FuzzTarget("spz", load_cloud, corpus, check_cloud_file, suffix=".spz", finish=finish)


def sog_target() -> FuzzTarget:
    """Fuzz target: SOG bundles of both versions."""
    corpus = {
        f"v{v}-sh{d}": build_sog(small_cloud(5, d), v) for v, d in ((1, 0), (1, 3), (2, 0), (2, 1))
    }

    def finish(data: bytes, rng: np.random.Generator) -> bytes:
        return repair_zip(data) if rng.random() < 0.8 else data

    return FuzzTarget(
        "sog", load_cloud, corpus, check_cloud_file, _META_TOKENS, ".sog", finish=finish
    )


def sog_folder_target() -> FuzzTarget:
    """Fuzz target: meta.json and lod-meta.json of SOG folders, the planes being sound."""
    folder = build_sog_files(small_cloud(5, 2))
    first = build_sog_files(small_cloud(5, 0), 1)
    streamed = build_sog_streamed([small_cloud(8, 0), small_cloud(4, 0)])
    corpus = {
        "meta": folder.pop("meta.json"),
        "meta-v1": first["meta.json"],
        "lod-meta": streamed.pop("lod-meta.json"),
    }
    return FuzzTarget(
        "sog-folder",
        load_cloud,
        corpus,
        check_cloud_file,
        _META_TOKENS,
        ".json",
        beside={**folder, **streamed},
    )


def gltf_target() -> FuzzTarget:
    """Fuzz target: glTF with its buffer inside, beside, and binary."""
    corpus: dict[str, bytes] = {}
    beside: dict[str, bytes] = {}
    for layout, degree in (("glb", 0), ("glb", 3), ("text", 1), ("beside", 0)):
        files = build_gltf(
            small_cloud(5, degree), layout, node={"scale": [2, 2, 2], "rotation": [0, 0, 0, 1]}
        )
        main = next(iter(files))
        corpus[f"{layout}-sh{degree}"] = files.pop(main)
        beside |= files
    return FuzzTarget(
        "gltf", load_cloud, corpus, check_cloud_file, _GLTF_TOKENS, ".gltf", beside=beside
    )


def repair_zip(data: bytes) -> bytes:
    """The same zip with the CRC of every stored entry made to agree, where it can be parsed."""
    source = CloudSource(io.BytesIO(data), Path("mutant"), len(data))
    repaired = bytearray(data)
    try:
        for entry in load_zip_directory(source).values():
            start = entry.header + 30
            start += sum(int.from_bytes(data[start - i : start - i + 2], "little") for i in (4, 2))
            crc = zlib.crc32(data[start : start + entry.packed])
            repaired[entry.listed + 16 : entry.listed + 20] = crc.to_bytes(4, "little")
    except FormatError:
        return data
    return bytes(repaired)
