"""Writers of the splat formats that GN0 only reads, for tests, fuzzing and figures.

They are plain and follow the formats to the letter; what they lose is what the format loses.
Pictures and archives are made as fast as may be, not as small.
"""

from __future__ import annotations

import base64
import gzip
import io
import json
import math
import struct
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.cloud_file import logit
from gn0.gaussians.ply import log_scales
from gn0.gaussians.sh import rotate_sh

_TURN_X = np.diag([1.0, -1.0, -1.0])
_TURN_Z = np.diag([-1.0, -1.0, 1.0])


def _bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Values rounded to bytes."""
    return np.clip(np.floor(values + 0.5), 0, 255).astype(np.uint8)


def _colour_bytes(cloud: GaussianCloud) -> NDArray[np.uint8]:
    """Red, green, blue and opacity [N, 4]."""
    return np.concatenate([_bytes(cloud.rgb() * 255), _bytes(cloud.opacities[:, None] * 255)], 1)


def build_splat(cloud: GaussianCloud) -> bytes:
    """A .splat file."""
    table = np.empty(
        len(cloud),
        [("floats", "<f4", 6), ("rgba", "u1", 4), ("quat", "u1", 4)],
    )
    table["floats"] = np.concatenate([cloud.means, cloud.scales], 1)
    table["rgba"] = _colour_bytes(cloud)
    table["quat"] = np.clip(cloud.quats * 128 + 128, 0, 255)
    return table.tobytes()


def _turned(cloud: GaussianCloud, turn: NDArray[np.float64]) -> tuple[NDArray[Any], ...]:
    """Means, quaternions and SH after a half turn about an axis."""
    axis = int(np.argmax(np.diag(turn)))
    signs = np.diag(turn).astype(np.float32)
    w, x, y, z = cloud.quats.T
    # SPZ turns the local axes as well, which leaves the Gaussian the same; glTF does not
    turned = {0: (w, x, -y, -z), 2: (-z, -y, x, w)}[axis]
    return cloud.means * signs, np.stack(turned, 1), rotate_sh(cloud.sh, turn)


def build_spz(
    cloud: GaussianCloud, version: int = 2, *, packed: bool = True, bits: int = 12
) -> bytes:
    """An SPZ file; `packed=False` leaves the gzip of versions 1 to 3 out."""
    means, quats, sh = _turned(cloud, _TURN_X)
    n = len(cloud)
    if version == 1:
        positions = means.astype("<f2").tobytes()
    else:
        fixed = np.clip(np.round(means.astype(np.float64) * 2**bits), -(2**23), 2**23 - 1)
        positions = fixed.astype("<i4").view(np.uint8).reshape(n * 3, 4)[:, :3].tobytes()
    planes = [
        positions,
        _bytes(cloud.opacities * 255).tobytes(),
        _bytes((cloud.sh[:, 0] * 0.15 + 0.5) * 255).tobytes(),
        _bytes((log_scales(cloud.scales) + 10) * 16).tobytes(),
        _spz_rotations(quats, version),
    ]
    if cloud.sh_degree:
        planes.append(_bytes(sh[:, 1:] * 128 + 128).tobytes())
    head = struct.pack("<4sIIBBBB", b"NGSP", version, n, cloud.sh_degree, bits, 0, 0)
    if version < 4:
        data = head + b"".join(planes)
        return gzip.compress(data, 1, mtime=0) if packed else data
    import pyarrow as pa

    streams = [pa.compress(plane, codec="zstd", asbytes=True) for plane in planes]
    head = head[:15] + bytes([len(streams)]) + struct.pack("<I12x", 32)
    sizes = zip(streams, planes, strict=True)
    table = b"".join(struct.pack("<2Q", len(s), len(p)) for s, p in sizes)
    return head + table + b"".join(streams)


def _spz_rotations(quats: NDArray[Any], version: int) -> bytes:
    if version < 3:
        signed = quats * np.where(quats[:, :1] < 0, -1, 1)
        return _bytes(signed[:, 1:] * 127.5 + 127.5).tobytes()
    xyzw = quats[:, [1, 2, 3, 0]].astype(np.float64)
    which, three = _smallest_three(xyzw)
    fields = np.floor(np.abs(three) * math.sqrt(2) * 511 + 0.5).astype(np.uint32)
    fields |= (three < 0).astype(np.uint32) << np.uint32(9)
    words = which.astype(np.uint32) << np.uint32(30)
    for column, shift in enumerate((20, 10, 0)):
        words |= fields[:, column] << np.uint32(shift)
    return words.astype("<u4").tobytes()


def _smallest_three(quats: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Index of the largest component, and the others in order once that one is positive."""
    which = np.argmax(np.abs(quats), axis=1)
    at = np.arange(len(quats))
    signed = quats * np.where(quats[at, which] < 0, -1, 1)[:, None]
    others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[which]
    return which, signed[at[:, None], others]


def build_sog_files(cloud: GaussianCloud, version: int = 2) -> dict[str, bytes]:
    """The files of a SOG folder by name."""
    n = len(cloud)
    logs = np.sign(cloud.means) * np.log1p(np.abs(cloud.means.astype(np.float64)))
    low, high = logs.min(0), logs.max(0)
    steps = np.round((logs - low) / np.where(high > low, high - low, 1) * 65535).astype(np.uint16)
    which, three = _smallest_three(cloud.quats.astype(np.float64))
    quats = np.concatenate(
        [_bytes((three * math.sqrt(2) + 1) * 127.5), (which + 252).astype(np.uint8)[:, None]], 1
    )
    scales, dc = log_scales(cloud.scales), cloud.sh[:, 0]
    files = {
        "means_l.webp": _webp(steps & 255),
        "means_u.webp": _webp(steps >> 8),
        "quats.webp": _webp(quats),
    }
    means = {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]}
    meta: dict[str, Any] = {"means": means, "quats": {"files": ["quats.webp"]}}
    if version == 1:
        means["shape"] = [n, 3]
        scale_codes, scale_bounds = _between(scales)
        colour_codes, colour_bounds = _between(
            np.concatenate([dc, logit(np.clip(cloud.opacities, 1e-4, 1 - 1e-4))[:, None]], 1)
        )
        meta["scales"] = {**scale_bounds, "files": ["scales.webp"]}
        meta["sh0"] = {**colour_bounds, "files": ["sh0.webp"]}
    else:
        meta |= {"version": 2, "count": n}
        scale_codes, scale_book = _codebook(scales)
        dc_codes, dc_book = _codebook(dc)
        colour_codes = np.concatenate([dc_codes, _bytes(cloud.opacities[:, None] * 255)], 1)
        meta["scales"] = {"codebook": scale_book, "files": ["scales.webp"]}
        meta["sh0"] = {"codebook": dc_book, "files": ["sh0.webp"]}
    files |= {"scales.webp": _webp(scale_codes), "sh0.webp": _webp(colour_codes)}
    if cloud.sh_degree:
        shn, planes = _sog_palette(cloud, version)
        meta["shN"] = shn
        files |= planes
    return {"meta.json": json.dumps(meta).encode(), **files}


def _sog_palette(cloud: GaussianCloud, version: int) -> tuple[dict[str, Any], dict[str, bytes]]:
    """SH of the first 65536 Gaussians as a palette, the others pointing to one of them."""
    n, per_entry = len(cloud), cloud.sh.shape[1] - 1
    entries = min(n, 65536)
    rest = cloud.sh[:entries, 1:]
    rows = -(-entries // 64)
    picture = np.zeros((rows * 64, per_entry, 3), np.uint8)
    names = {"files": ["shN_centroids.webp", "shN_labels.webp"]}
    meta: dict[str, Any]
    if version == 1:
        low, high = float(rest.min()), float(rest.max())
        picture[:entries] = _bytes((rest - low) / max(high - low, 1e-9) * 255)
        meta = {"mins": low, "maxs": high, **names}
    else:
        picture[:entries], book = _codebook(rest)
        meta = {"count": entries, "bands": cloud.sh_degree, "codebook": book, **names}
    labels = np.arange(n) % entries
    codes = np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], 1)
    return meta, {
        "shN_centroids.webp": _webp(picture.reshape(-1, 3), 64 * per_entry),
        "shN_labels.webp": _webp(codes),
    }


def _between(values: NDArray[Any]) -> tuple[NDArray[np.uint8], dict[str, list[float]]]:
    low, high = values.min(0).astype(np.float64), values.max(0).astype(np.float64)
    codes = _bytes((values - low) / np.where(high > low, high - low, 1) * 255)
    return codes, {"mins": low.tolist(), "maxs": high.tolist()}


def _codebook(values: NDArray[Any]) -> tuple[NDArray[np.uint8], list[float]]:
    """Even steps between the bounds: as good a codebook as any for a test."""
    low, high = float(values.min()), float(values.max())
    span = max(high - low, 1e-9)
    return _bytes((values - low) / span * 255), (low + span * np.arange(256) / 255).tolist()


def _webp(codes: NDArray[Any], width: int = 0) -> bytes:
    """Codes [N, 3 or 4] as lossless WebP, quick to make."""
    from PIL import Image

    n = len(codes)
    width = width or 4 * math.ceil(math.sqrt(n) / 4)
    height = math.ceil(n / width)
    picture = np.zeros((height * width, codes.shape[1]), np.uint8)
    picture[:n] = codes
    out = io.BytesIO()
    image = Image.fromarray(picture.reshape(height, width, -1))
    image.save(out, "WEBP", lossless=True, quality=0, method=0, exact=True)
    return out.getvalue()


def build_sog(cloud: GaussianCloud, version: int = 2) -> bytes:
    """A SOG bundle."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in build_sog_files(cloud, version).items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return out.getvalue()


def build_sog_streamed(levels: list[GaussianCloud]) -> dict[str, bytes]:
    """A streamed SOG by relative path: two leaves, each with half of every level."""
    files: dict[str, bytes] = {}
    halves: list[dict[str, Any]] = [{}, {}]
    names = []
    for level, cloud in enumerate(levels):
        names.append(f"{level}_0/meta.json")
        files |= {f"{level}_0/{name}": data for name, data in build_sog_files(cloud).items()}
        middle = len(cloud) // 2
        halves[0][str(level)] = {"file": level, "offset": 0, "count": middle}
        halves[1][str(level)] = {"file": level, "offset": middle, "count": len(cloud) - middle}
    bound = {"min": [0, 0, 0], "max": [1, 1, 1]}
    index = {
        "version": 1,
        "counts": [len(cloud) for cloud in levels],
        "lodLevels": len(levels),
        "filenames": names,
        "tree": {"bound": bound, "children": [{"bound": bound, "lods": half} for half in halves]},
    }
    return {"lod-meta.json": json.dumps(index).encode(), **files}


def build_gltf(
    cloud: GaussianCloud, layout: str = "glb", *, node: dict[str, Any] | None = None
) -> dict[str, bytes]:
    """A glTF with splats by file name.

    Args:
        cloud: the Gaussians.
        layout: "glb", "text" (buffer in the JSON) or "beside" (buffer in splats.bin).
        node: placement of the node, e.g. {"translation": [1, 2, 3]}.
    """
    means, quats, sh = _turned(cloud, _TURN_Z)
    name = "KHR_gaussian_splatting"
    columns = {
        "POSITION": means,
        f"{name}:ROTATION": quats[:, [1, 2, 3, 0]],
        f"{name}:SCALE": cloud.scales,
        f"{name}:OPACITY": cloud.opacities[:, None],
    }
    for degree in range(cloud.sh_degree + 1):
        for i in range(2 * degree + 1):
            columns[f"{name}:SH_DEGREE_{degree}_COEF_{i}"] = sh[:, degree * degree + i]
    views: list[dict[str, int]] = []
    accessors: list[dict[str, Any]] = []
    parts: list[bytes] = []
    at = 0
    for values in columns.values():
        data = np.ascontiguousarray(values, "<f4").tobytes()
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1]]
        accessors.append(
            {"bufferView": len(views), "componentType": 5126, "count": len(cloud), "type": kind}
        )
        views.append({"buffer": 0, "byteOffset": at, "byteLength": len(data)})
        parts.append(data)
        at += len(data)
    about = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    primitive = {
        "attributes": {column: i for i, column in enumerate(columns)},
        "mode": 0,
        "extensions": {name: about},
    }
    buffer: dict[str, Any] = {"byteLength": at}
    body = b"".join(parts)
    if layout == "text":
        text = base64.b64encode(body).decode()
        buffer["uri"] = f"data:application/octet-stream;base64,{text}"
    elif layout == "beside":
        buffer["uri"] = "splats.bin"
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [name],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **(node or {})}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [buffer],
        "bufferViews": views,
        "accessors": accessors,
    }
    head = json.dumps(document).encode()
    if layout == "text":
        return {"splats.gltf": head}
    if layout == "beside":
        return {"splats.gltf": head, "splats.bin": body}
    head += b" " * (-len(head) % 4)
    total = 12 + 8 + len(head) + 8 + len(body)
    return {
        "splats.glb": struct.pack("<4sIII4s", b"glTF", 2, total, len(head), b"JSON")
        + head
        + struct.pack("<I4s", len(body), b"BIN\0")
        + body
    }


def build_ksplat(cloud: GaussianCloud, compression: int = 1, *, bucket: int = 256) -> bytes:
    """A .ksplat file of one section; Gaussians keep their order, whatever the buckets span."""
    n, degree = len(cloud), cloud.sh_degree
    values = "<f4" if compression == 0 else "<f2"
    kinds = ["<f4", "<f2", "u1"]
    record = np.empty(
        n,
        [
            ("place", "<f4" if compression == 0 else "<u2", (3,)),
            ("scale", values, (3,)),
            ("rotation", values, (4,)),
            ("colour", "u1", (4,)),
            ("sh", kinds[compression], (3 * (cloud.sh.shape[1] - 1),)),
        ],
    )
    full, left = divmod(n, bucket)
    buckets = full + bool(left)
    starts = np.arange(buckets) * bucket
    block = 1.0
    centres = np.zeros((buckets, 3), np.float32)
    if compression:
        low = np.minimum.reduceat(cloud.means, starts)
        high = np.maximum.reduceat(cloud.means, starts)
        centres = ((low + high) / 2).astype(np.float32)
        block = float((high - low).max()) * 1.001 or 1.0
        offsets = cloud.means - centres[np.arange(n) // bucket]
        record["place"] = np.clip(np.round(offsets / (block / 2 / 32767)) + 32767, 0, 65535)
    else:
        record["place"] = cloud.means
    record["scale"], record["rotation"] = cloud.scales, cloud.quats
    record["colour"] = _colour_bytes(cloud)
    low_sh, high_sh = -1.5, 1.5
    if degree:
        bands = [cloud.sh[:, b * b : (b + 1) ** 2].transpose(0, 2, 1) for b in range(1, degree + 1)]
        rest = np.concatenate([band.reshape(n, -1) for band in bands], 1)
        low_sh, high_sh = float(rest.min()), float(rest.max())
        record["sh"] = (
            _bytes((rest - low_sh) / (high_sh - low_sh) * 255) if compression == 2 else rest
        )
    header = bytearray(4096)
    struct.pack_into("<BBxxIIIIH", header, 0, 0, 1, 1, 1, n, n, compression)
    struct.pack_into("<2f", header, 36, low_sh, high_sh)
    section = bytearray(1024)
    struct.pack_into("<4IfHxxIxxxxIIH", section, 0, n, n, bucket, buckets, block, 12,
                     0 if compression == 0 else 32767, full, int(bool(left)), degree)  # fmt: skip
    sizes = struct.pack("<I", left) if left else b""
    return bytes(header + section) + sizes + centres.tobytes() + record.tobytes()
