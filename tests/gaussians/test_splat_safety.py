"""Hostile splat files: refused with a place and a remedy, and at the cost of little memory."""

from __future__ import annotations

import gzip
import io
import json
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gn0.errors import FormatError, Gn0Error
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
from gn0_trials.peak_memory import peak_memory_bytes
from gn0_trials.splat_corpus import small_cloud

TEN = small_cloud(10, 0)
SPZ = build_spz(TEN, 2, packed=False)
SPZ4 = build_spz(TEN, 4)
GLB = build_gltf(TEN)["splats.glb"]
KSPLAT = build_ksplat(TEN, 1, bucket=4)
SECTION = 4096  # where the only section header of KSPLAT begins


def put(data: bytes, offset: int, form: str, *values) -> bytes:
    changed = bytearray(data)
    struct.pack_into(form, changed, offset, *values)
    return bytes(changed)


def bundle(change=lambda meta: None, *, planes=None, method=zipfile.ZIP_STORED) -> bytes:
    """A SOG bundle of ten Gaussians of SH 1 with its meta changed and planes replaced."""
    files = build_sog_files(small_cloud(10, 1))
    meta = json.loads(files["meta.json"])
    change(meta)
    files["meta.json"] = json.dumps(meta).encode()
    files |= planes or {}
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, method)
    return out.getvalue()


def glb(change, *, data: bytes = GLB) -> bytes:
    """A .glb with its JSON changed."""
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = data[20 + length :]
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(body), len(text), b"JSON")
    return head + text + body


def webp(width: int, height: int, **options) -> bytes:
    out = io.BytesIO()
    Image.fromarray(np.zeros((height, width, 4), np.uint8)).save(out, "WEBP", **options)
    return out.getvalue()


def setting(path: str, value):
    """A change of one value deep in a JSON."""

    def change(document):
        *parents, last = path.split(".")
        for key in parents:
            document = document[int(key) if key.isdigit() else key]
        document[int(last) if last.isdigit() else last] = value

    return change


HUGE_WEBP = b"RIFF\x16\0\0\0WEBPVP8L\x0a\0\0\0" + struct.pack("<BI", 0x2F, (16383 << 14) | 16383)
HUGE_WEBP += b"\0" * 8

CASES = {
    "splat, cut": (build_splat(TEN)[:-5], "not a multiple"),
    "splat, all NaN after a good start": (
        build_splat(TEN)[:32] * 8 + b"\xff" * 31, "not a multiple"
    ),
    "spz, one more": (put(SPZ, 8, "<I", 11), "truncated or its header is forged"),
    "spz, 4 billion": (put(SPZ, 8, "<I", 0xFFFFFFFF), "forged: 4294967295"),
    "spz, gzip of 4 billion": (gzip.compress(put(SPZ, 8, "<I", 0xFFFFFFFF)), "forged"),
    "spz, fractions": (put(SPZ, 13, "<B", 31), "31 fractional bits"),
    "spz, gzip cut": (gzip.compress(SPZ)[:-9], "cut off|ends within"),
    "spz, gzip without its end": (gzip.compress(SPZ)[:-1], "cut off"),
    "spz, gzip bomb": (gzip.compress(SPZ + b"\0" * 20_000_000), "gzip bomb"),
    "spz, gzip of version 4": (gzip.compress(SPZ4), "SPZ 4 is not packed with gzip"),
    "spz 4, no streams": (put(SPZ4, 15, "<B", 0), "claims 0 streams"),
    "spz 4, table beyond": (put(SPZ4, 16, "<I", 1 << 30), "table of streams"),
    "spz 4, 4 billion": (put(SPZ4, 8, "<I", 0xFFFFFFFF), "forged: 4294967295"),
    "spz 4, raw size forged": (put(SPZ4, 40, "<Q", 91), "have 91 bytes, not 90"),
    "spz 4, all forged alike": (
        put(
            SPZ4, 8, "<I", 1 << 20
        )[:32]
        + b"".join(
            struct.pack("<2Q", struct.unpack_from("<Q", SPZ4, 32 + i * 16)[0], n << 20)
            for i, n in enumerate((9, 1, 3, 3, 4))
        )
        + SPZ4[112:],
        "forged|unpack to less",
    ),
    "spz 4, packed size forged": (put(SPZ4, 32, "<Q", 1 << 40), "needs 1099511627776 bytes"),
    "spz 4, damaged": (SPZ4[:120] + b"\xff" * 8 + SPZ4[128:], "damaged|unpack to"),
    "zip, no end": (build_sog(TEN)[:-30], "no directory at its end"),
    "zip, directory forged": (
        put(build_sog(TEN), len(build_sog(TEN)) - 10, "<I", 0x7FFFFFFF), "does not fit"
    ),
    "zip, zip64": (put(build_sog(TEN), len(build_sog(TEN)) - 10, "<I", 0xFFFFFFFF), "zip64"),
    "zip, CRC": (
        build_sog(TEN).replace(b'"count": 10', b'"count": 11', 1), "CRC does not agree"
    ),
    "zip bomb": (
        bundle(planes={"scales.webp": b"\0" * 50_000_000}, method=zipfile.ZIP_DEFLATED),
        "more than the .* it may have",
    ),
    "zip, meta.json too long": (
        bundle(lambda m: m.update(filler="x" * 3_000_000), method=zipfile.ZIP_DEFLATED),
        "more than the 2097152",
    ),
    "sog, bounds short": (bundle(setting("means.mins", [0, 0])), "2 values, not 3"),
    "sog, no file": (bundle(setting("quats.files", [])), "names 0 files"),
    "sog, count negative": (bundle(setting("count", -1)), "claims -1"),
    "sog, count 10^9": (bundle(setting("count", 10**9)), "claims 1000000000"),
    "sog, count 10^8": (bundle(setting("count", 10**8)), "fewer than the 100000000"),
    "sog, count beyond 64 bits": (bundle(setting("count", 10**30)), r"\$\.count|claims 1000"),
    "sog, huge picture": (bundle(planes={"quats.webp": HUGE_WEBP}), "far more than"),
    "sog, animated": (
        bundle(planes={"quats.webp": b"RIFF\x20\0\0\0WEBPANIM\x06\0\0\0" + b"\0" * 16}),
        "animated",
    ),
    "sog, lossy": (bundle(planes={"quats.webp": webp(8, 8, quality=50)}), "lossy"),
    "sog, no picture": (bundle(planes={"quats.webp": b"hello"}), "not a WebP"),
    "sog, picture damaged": (
        bundle(planes={"quats.webp": webp(4, 4, lossless=True)[:25] + b"\xff" * 9}),
        "cannot be decoded|WebP|tag",
    ),
    "sog, palette width": (bundle(setting("shN.bands", 2)), "192 pixels wide, not 512"),
    "sog, palette NaN": (bundle(setting("shN.codebook", [1e39] * 256)), "NaN or infinite"),
    "glb, cut": (GLB[:-4], "truncated"),
    "glb, version": (put(GLB, 4, "<I", 3), "version 3"),
    "glb, chunk forged": (put(GLB, 12, "<I", 0xFFFFFF00), "first chunk"),
    "glb, no JSON": (glb(lambda d: None).replace(b'{"asset"', b'x"asset"'), "malformed"),
    "gltf, count": (glb(setting("accessors.0.count", 10**12)), "forged"),
    "gltf, count 0": (glb(setting("accessors.0.count", 0)), "0 rows"),
    "gltf, counts differ": (glb(setting("accessors.2.count", 9)), "9 rows for 10 positions"),
    "gltf, offset negative": (glb(setting("bufferViews.0.byteOffset", -4)), "forged"),
    "gltf, stride": (glb(setting("bufferViews.0.byteStride", 1)), "1 bytes apart"),
    "gltf, buffer": (glb(setting("buffers.0.byteLength", 10**9)), "1000000000 bytes"),
    "gltf, no such accessor": (
        glb(setting("meshes.0.primitives.0.attributes.POSITION", 99)), "there is none"
    ),
    "gltf, type": (glb(setting("accessors.0.type", "VEC4")), "4 values a row, not 3"),
    "gltf, sparse": (glb(setting("accessors.0.sparse", {"count": 1})), "sparse"),
    "gltf, node cycle": (glb(setting("nodes.0.children", [0])), "used twice"),
    "gltf, no scene": (glb(setting("scene", 7)), "no scene 7"),
    "gltf, matrix": (glb(setting("nodes.0.matrix", [1, 2])), "2 values, not 16"),
    "gltf, triangles": (glb(setting("meshes.0.primitives.0.mode", 4)), "not mode 4"),
    "gltf, mesh only": (
        glb(setting("meshes.0.primitives.0.extensions", {})), "holds no Gaussian splats"
    ),
    "gltf, packed": (
        glb(
            setting(
                "meshes.0.primitives.0.extensions.KHR_gaussian_splatting.extensions",
                {"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}},
            )
        ),
        "packed with 'KHR_gaussian_splatting_compression_spz_2'",
    ),
    "gltf, attribute": (
        glb(lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop(
            "KHR_gaussian_splatting:OPACITY")),
        "lacks an attribute",
    ),
    "gltf, a thousand copies": (
        glb(lambda d: (d.update(nodes=[{"mesh": 0}] * 1000),
                       d.update(scenes=[{"nodes": list(range(1000))}]))),
        "more than 16 copies",
    ),
    "gltf, a million placements": (
        glb(lambda d: (d.update(nodes=[{"mesh": 0}] * 1000),
                       d.update(scenes=[{"nodes": list(range(1000))}]),
                       d["meshes"][0].update(primitives=d["meshes"][0]["primitives"] * 1000))),
        "more than 4096 primitives",
    ),
    "gltf, web address": (
        glb(setting("buffers.0.uri", "https://example.org/a.bin")), "never fetched"
    ),
    "gltf, bad base64": (
        glb(setting("buffers.0.uri", "data:;base64," + "?" * 2000)), "not base64"
    ),
    "gltf, short base64": (glb(setting("buffers.0.uri", "data:;base64,AAAA")), "holds 3 bytes"),
    "gltf, missing file": (glb(setting("buffers.0.uri", "none.bin")), "is missing"),
    "json, deep": (b'{"lodLevels":1,"filenames":[],"tree":' + b'{"children":[' * 100_000, "deep"),
    "ksplat, compression": (put(KSPLAT, 20, "<H", 3), "compression 3"),
    "ksplat, count": (put(KSPLAT, 16, "<I", 11), "claims 11 Gaussians"),
    "ksplat, 4 billion": (put(KSPLAT, SECTION, "<2I", *[0xFFFFFFFF] * 2), "truncated or forged"),
    "ksplat, more than room": (put(KSPLAT, SECTION, "<I", 11), "11 Gaussians in 10"),
    "ksplat, buckets": (put(KSPLAT, SECTION + 32, "<I", 1 << 30), "do not fit"),
    "ksplat, partial buckets": (put(KSPLAT, 5120, "<I", 1), "the buckets hold 9"),
    "ksplat, degree": (put(KSPLAT, SECTION + 40, "<H", 4), "SH degree 4"),
    "ksplat, cut": (KSPLAT[:-1], "truncated"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_hostile_file_is_refused(case, tmp_path):
    data, reason = CASES[case]
    path = tmp_path / "bad"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=reason) as caught:
        load_cloud(path)
    error = caught.value
    assert error.file == str(path) and error.remedy
    assert error.offset is not None and 0 <= error.offset <= len(data)


@pytest.mark.parametrize(
    "data",
    [SPZ, gzip.compress(SPZ), SPZ4, build_sog(TEN), GLB, KSPLAT],
    ids=["spz", "spz.gz", "spz4", "sog", "glb", "ksplat"],
)
def test_no_cut_of_a_file_is_read_or_leaks(data, tmp_path):
    path = tmp_path / "cut"
    for end in range(0, len(data), max(1, len(data) // 200)):
        path.write_bytes(data[:end])
        with pytest.raises(FormatError):
            load_cloud(path)


def test_a_gltf_that_names_no_buffer_and_has_none_is_refused(tmp_path):
    document = json.loads(build_gltf(TEN, "text")["splats.gltf"])
    length = document["buffers"][0]["byteLength"]
    del document["buffers"][0]["uri"]
    path = tmp_path / "splats.gltf"
    path.write_text(json.dumps(document))
    with pytest.raises(FormatError, match=f"should have {length} bytes, and 0 are there"):
        load_cloud(path)


ESCAPES = ["../out", "/etc/passwd", "a/../../out", "..\\out", "C:\\out", "%2e%2e/out", "~/out",
           "a\0b", "", "link/out", "nul", "COM1.webp"]  # fmt: skip


def folders(tmp_path: Path, name: str) -> dict[str, Path]:
    """Every kind of file that names other files, naming this one."""
    outside = tmp_path / "out"
    outside.write_bytes(b"secret")
    inside = tmp_path / "in"
    inside.mkdir()
    (inside / "link").symlink_to(tmp_path, target_is_directory=True)
    kinds = {}
    files = build_sog_files(TEN)
    files["meta.json"] = json.dumps(
        json.loads(files["meta.json"]) | {"quats": {"files": [name]}}
    ).encode()
    for part, data in files.items():
        (inside / part).write_bytes(data)
    kinds["sog folder"] = inside / "meta.json"
    index = json.loads(build_sog_streamed([TEN])["lod-meta.json"])
    index["filenames"] = [name]
    (inside / "lod-meta.json").write_text(json.dumps(index))
    kinds["streamed sog"] = inside / "lod-meta.json"
    document = json.loads(build_gltf(TEN, "beside")["splats.gltf"])
    document["buffers"][0]["uri"] = name
    (inside / "a.gltf").write_text(json.dumps(document))
    kinds["gltf"] = inside / "a.gltf"
    (inside / "b.sog").write_bytes(bundle(setting("quats.files", [name])))
    kinds["sog bundle"] = inside / "b.sog"
    return kinds


@pytest.mark.parametrize("name", ESCAPES)
def test_no_name_leads_out_of_the_folder(name, tmp_path):
    for kind, path in folders(tmp_path, name).items():
        with pytest.raises(Gn0Error) as caught:
            load_cloud(path)
        assert caught.value.remedy and str(path) in str(caught.value), kind
        assert "secret" not in str(caught.value)


def test_a_missing_part_is_named(tmp_path):
    for name, path in folders(tmp_path, "absent.webp").items():
        with pytest.raises(FormatError, match=r"absent\.webp"):
            load_cloud(path)
        assert name


def test_streamed_sog_that_claims_twice(tmp_path):
    files = build_sog_streamed([TEN])
    for name, data in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
    leaf = {"file": 0, "offset": 0, "count": 6}
    changes = {
        "used twice": {"tree": {"children": [{"lods": {"0": leaf}}, {"lods": {"0": leaf}}]}},
        "listed twice": {
            "filenames": ["0_0/meta.json"] * 2,
            "tree": {"children": [{"lods": {"0": leaf}}, {"lods": {"0": leaf | {"file": 1}}}]},
        },
        "chunk is listed twice": {
            "filenames": ["0_0/meta.json", "0_0/.//meta.json"],
            "tree": {"children": [{"lods": {"0": leaf}}, {"lods": {"0": leaf | {"file": 1}}}]},
        },
        "which has 10": {"tree": {"lods": {"0": leaf | {"offset": 9}}}},
        "of 1 chunks": {"tree": {"lods": {"0": leaf | {"file": 3}}}},
        "names chunk 0": {"tree": {"lods": {"0": leaf | {"offset": -3}}}},
        "holds no Gaussians": {"tree": {}},
        "version 2": {"version": 2},
        "claims 0 levels": {"lodLevels": 0},
    }
    for reason, change in changes.items():
        index = json.loads(files["lod-meta.json"]) | change
        (tmp_path / "lod-meta.json").write_text(json.dumps(index))
        with pytest.raises(FormatError, match=reason):
            load_cloud(tmp_path)


_MEASURE = """
import sys, warnings
warnings.simplefilter("error")
from gn0.errors import FormatError
from gn0.gaussians.splat_files import load_cloud
from gn0_trials.peak_memory import peak_memory_bytes
import PIL.Image, PIL.WebPImagePlugin, pyarrow
before = peak_memory_bytes()
try:
    cloud = load_cloud(sys.argv[1]).cloud
    decoded = sum(getattr(cloud, n).nbytes for n in ("means", "quats", "scales", "opacities", "sh"))
except FormatError:
    decoded = 0
print(decoded, peak_memory_bytes() - before)
"""


def peak_growth(path: Path) -> tuple[int, int]:
    """(decoded bytes, growth of peak memory) of reading a file in a process of its own."""
    if not peak_memory_bytes():
        pytest.skip("this system does not tell a process its peak memory")
    out = subprocess.run(
        [sys.executable, "-c", _MEASURE, str(path)], capture_output=True, text=True, check=True
    )
    decoded, growth = out.stdout.split()
    return int(decoded), int(growth)


def big(degree: int = 0):
    return small_cloud(400_000 if degree == 0 else 120_000, degree)


def many_entries() -> bytes:
    """16 MB of the smallest JSON objects there are."""
    return b'{"lodLevels":1,"filenames":[],"tree":{"children":[' + b"{}," * 5_000_000 + b"{}]}}"


MEMORY = {
    "splat": lambda: build_splat(big()),
    "spz 2": lambda: build_spz(big(3), 2),
    "spz 4": lambda: build_spz(big(), 4),
    "sog": lambda: build_sog(big()),
    "sog, SH 3": lambda: build_sog(big(3)),
    "glb": lambda: build_gltf(big())["splats.glb"],
    "gltf text": lambda: build_gltf(big(), "text")["splats.gltf"],
    "ksplat": lambda: build_ksplat(big(1), 1),
    "bad: spz gzip bomb": lambda: gzip.compress(SPZ + b"\0" * 200_000_000, 1),
    "bad: spz 4 zstd bomb": lambda: _zstd_bomb(),
    "bad: spz 4 sizes": lambda: _forged_table(),
    "bad: zip bomb": lambda: bundle(
        planes={"scales.webp": b"\0" * 150_000_000}, method=zipfile.ZIP_DEFLATED
    ),
    "bad: huge picture": lambda: bundle(planes={"quats.webp": HUGE_WEBP}),
    "bad: glb count": lambda: glb(setting("accessors.0.count", 10**12)),
    "bad: entries": many_entries,
}


def _zstd_bomb() -> bytes:
    """Ten Gaussians whose first plane unpacks to 200 MB."""
    import pyarrow as pa

    stream = pa.compress(bytes(200_000_000), codec="zstd", asbytes=True)
    old = struct.unpack_from("<Q", SPZ4, 32)[0]
    return put(SPZ4[:112], 32, "<Q", len(stream)) + stream + SPZ4[112 + old :]


def _forged_table() -> bytes:
    """A table of streams that promises 4 billion Gaussians from bytes that are not there."""
    sizes = b"".join(struct.pack("<2Q", 1 << 40, n * 0xFFFFFFFF) for n in (9, 1, 3, 3, 4))
    return put(SPZ4, 8, "<I", 0xFFFFFFFF)[:32] + sizes + SPZ4[112:]


@pytest.mark.parametrize("case", MEMORY)
def test_memory_stays_within_two_and_a_half_clouds(case, tmp_path):
    """At most 2.5 × the decoded cloud + 64 MB; what is refused decodes to nothing."""
    path = tmp_path / "cloud"
    path.write_bytes(MEMORY[case]())
    decoded, growth = peak_growth(path)
    assert (decoded == 0) == case.startswith("bad")
    assert growth <= 2.5 * decoded + 64e6
    if decoded:
        assert growth > 0.9 * decoded, "the measurement itself is broken"


def test_a_crc_of_zero_is_no_excuse(tmp_path):
    """Deflated entries are checked as well as stored ones."""
    data = bytearray(bundle(method=zipfile.ZIP_DEFLATED))
    at = data.index(b"PK\x01\x02")
    data[at + 16 : at + 20] = zlib.crc32(b"other").to_bytes(4, "little")
    (tmp_path / "a.sog").write_bytes(data)
    with pytest.raises(FormatError, match="CRC"):
        load_cloud(tmp_path / "a.sog")
