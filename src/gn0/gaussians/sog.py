"""SOG, PlayCanvas's picture planes: version 1 and 2, as a zip bundle or a folder.

Both keep means as 16 bits of sign(v) · log(1 + |v|) over two planes, and rotations as the smallest
three with the index of the largest in the alpha byte. Version 2 looks log scales, colours and SH up
in codebooks of 256 values; version 1 (no `version` in meta.json) scales each channel between
bounds, and its opacity is a logit. SH beyond DC is a palette of at most 65536 entries, 64 a row.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gn0.errors import FormatError, StorageError
from gn0.gaussians.cloud_file import CloudBuilder, CloudFile, sigmoid
from gn0.gaussians.cloud_source import REEXPORT, CloudSource, decode_json
from gn0.gaussians.rotation import scatter_rotation
from gn0.gaussians.sh import coefficient_count
from gn0.gaussians.sog_planes import decode_picture, decode_plane, most_pixels
from gn0.gaussians.sog_zip import load_zip_directory, read_zip_entry
from gn0.gaussians.splat import UNIT_OF_BYTE
from gn0.geometry import F32, F64, U8
from gn0.storage import read_bytes, safe_join

META_NAME = "meta.json"
META_LIMIT = 1 << 21  # real ones have 1 to 60 kB
_PLANE_EXTRA = 1 << 16  # bytes of headers and tables beside the pixels
_PALETTE_ROW = 64
_PALETTE_LIMIT = 65536
_BLOCK = 1 << 15  # Gaussians
_DEVICES = {"con", "prn", "aux", "nul", *(f"{n}{i}" for n in ("com", "lpt") for i in range(10))}


class _Files(msgspec.Struct, frozen=True):
    files: list[str]


class _Bounds(msgspec.Struct, frozen=True):
    files: list[str]
    mins: list[float]
    maxs: list[float]


class _BoundsV1(msgspec.Struct, frozen=True):
    files: list[str]
    mins: list[float]
    maxs: list[float]
    shape: list[int]


class _Codebook(msgspec.Struct, frozen=True):
    files: list[str]
    codebook: list[float]


class _Palette(msgspec.Struct, frozen=True):
    files: list[str]
    codebook: list[float]
    count: int
    bands: int


class _PaletteV1(msgspec.Struct, frozen=True):
    files: list[str]
    mins: float
    maxs: float


class _Version(msgspec.Struct, frozen=True):
    version: Any = None


class _MetaV1(msgspec.Struct, frozen=True):
    means: _BoundsV1
    scales: _Bounds
    quats: _Files
    sh0: _Bounds
    shN: _PaletteV1 | None = None  # noqa: N815 (the format's name)


class _MetaV2(msgspec.Struct, frozen=True):
    count: int
    means: _Bounds
    scales: _Codebook
    quats: _Files
    sh0: _Codebook
    shN: _Palette | None = None  # noqa: N815
    antialias: bool = False


@dataclass
class SogFiles:
    """Where the planes of one SOG come from.

    Attributes:
        file: the bundle, or the meta.json, for messages.
        load: bytes of a plane by its checked name, and the most bytes that it may have.
        size: bytes read so far.
    """

    file: Path
    load: Callable[[str, int], bytes]
    size: int = field(default=0)

    def plane(self, names: list[str], index: int, part: str, need: int) -> U8:
        """Pixels [P, 4] of the `index`-th file of a part of the meta."""
        return decode_plane(self.read(names, index, part, need), need, self.file, names[index])

    def read(self, names: list[str], index: int, part: str, need: int) -> bytes:
        """Bytes of the `index`-th file of a part of the meta, its name checked."""
        if len(names) <= index:
            raise self.refuse(f"meta.json names {len(names)} files for {part}", f"{part}.files")
        name = names[index]
        if name.split(".")[0].lower() in _DEVICES:
            raise self.refuse(f"plane name {name!r} is a device on Windows", f"{part}.files")
        try:
            safe_join(self.file.parent, name)
        except StorageError as error:
            raise self.refuse(f"plane {error.what}", f"{part}.files") from error
        data = self.load(name, 4 * most_pixels(need) + _PLANE_EXTRA)
        self.size += len(data)
        return data

    def refuse(self, what: str, name: str) -> FormatError:
        """An error about the meta, to be raised."""
        return FormatError(what, file=self.file, offset=0, field=name, remedy=REEXPORT)


@dataclass(frozen=True)
class _Decoders:
    """How bytes of one version become values, block by block."""

    count: int
    means: _Bounds | _BoundsV1
    scales: Callable[[U8], F32]  # [R, 3] bytes -> log scales
    colours: Callable[[U8], F32]  # [R, 3] bytes -> SH DC
    opacities: Callable[[U8], F32]  # [R] bytes -> opacity
    files: tuple[list[str], list[str], list[str], list[str]]  # means, scales, quats, sh0


def decode_sog_bundle(source: CloudSource) -> CloudFile:
    """Decode a SOG bundle, one zip of meta.json and planes.

    Raises:
        FormatError: no SOG inside, a plane missing, damaged or not of the size promised.
    """
    entries = load_zip_directory(source)
    metas = [n for n in entries if n == META_NAME or n.endswith("/" + META_NAME)]
    if len(metas) != 1:
        raise source.refuse(
            "the zip has no meta.json: this is not a SOG bundle"
            if not metas
            else "the zip has more than one meta.json",
            0,
            field=META_NAME,
            remedy="unpack it if the splats are inside in another format",
        )
    folder = metas[0][: -len(META_NAME)]

    def load(name: str, limit: int) -> bytes:
        entry = entries.get(folder + name)
        if entry is None:
            raise source.refuse("a plane is missing in the bundle", 0, field=name)
        # WebP is packed already: deflate finds next to nothing in it, unless it is a bomb
        return read_zip_entry(source, entry, min(limit, 16 * entry.packed + _PLANE_EXTRA))

    meta_entry = entries[metas[0]]
    meta = read_zip_entry(source, meta_entry, META_LIMIT)
    files = SogFiles(source.file, load)
    return _decode(meta, files, source.limit_bytes, meta_entry.header, source.size, "bundle")


def decode_sog_folder(source: CloudSource) -> CloudFile:
    """Decode an unbundled SOG by its open meta.json; the planes lie beside it.

    Raises:
        FormatError: as for bundles, or a plane's name leads out of the folder.
        StorageError: a plane cannot be read.
    """

    def load(name: str, limit: int) -> bytes:
        path = safe_join(source.file.parent, name)
        if not path.is_file():
            raise FormatError(
                f"plane {name!r} of the SOG folder is missing",
                file=source.file,
                offset=0,
                field=name,
                remedy="copy the whole folder, not meta.json alone",
            )
        return read_bytes(path, limit)

    if source.size > META_LIMIT:
        raise source.refuse(f"SOG meta.json has {source.size} bytes, far more than any real one")
    files = SogFiles(source.file, load)
    meta = source.read(0, source.size, META_NAME)
    return _decode(meta, files, source.limit_bytes, 0, source.size, "folder")


def _decode(
    meta: bytes, files: SogFiles, limit_bytes: int | None, offset: int, size: int, layout: str
) -> CloudFile:
    """The cloud that a meta.json and its planes hold."""
    version = decode_json(meta, _Version, files.file, META_NAME, offset=offset).version
    if version is not None and version != 2:
        raise FormatError(
            f"SOG version {str(version)[:20]} is not read (1 and 2 are)",
            file=files.file,
            offset=offset,
            field="version",
            remedy="write it with a current splat-transform, or convert it to .ply",
        )
    notes = []
    if version is None:
        v1 = decode_json(meta, _MetaV1, files.file, "SOG v1 meta.json", offset=offset)
        decoders = _version_1(v1, files)
        palette = _palette_v1(v1.shN, files) if v1.shN is not None else None
        shn_files = v1.shN.files if v1.shN is not None else []
    else:
        v2 = decode_json(meta, _MetaV2, files.file, "SOG meta.json", offset=offset)
        decoders = _version_2(v2, files)
        palette = _palette_v2(v2.shN, files) if v2.shN is not None else None
        shn_files = v2.shN.files if v2.shN is not None else []
        if v2.antialias:
            notes.append("trained with antialiasing, which no renderer here uses")
    planes = _load_planes(decoders, files)
    degree = math.isqrt(palette[0].shape[1] + 1) - 1 if palette is not None else 0
    builder = CloudBuilder(files.file, decoders.count, degree, limit_bytes, offset)
    _fill(builder, decoders, planes, files)
    planes.clear()
    if palette is not None:
        labels = files.plane(shn_files, 1, "shN", decoders.count)
        _fill_sh(builder, palette, labels, files)
    cloud, dropped = builder.build()
    return CloudFile(
        cloud=cloud,
        path=files.file,
        format=f"sog-v{version or 1}",
        stored=decoders.count,
        dropped=dropped,
        sh_degree=cloud.sh_degree,
        encoding=layout,
        notes=tuple(notes),
        size=size if layout == "bundle" else size + files.size,
    )


def _version_1(meta: _MetaV1, files: SogFiles) -> _Decoders:
    """Decoders of a version 1 meta."""
    if not meta.means.shape:
        raise files.refuse("SOG v1 meta.json has no number of Gaussians", "means.shape")
    scale_tables = _tables(meta.scales, 3, "scales", files)
    colour_tables = _tables(meta.sh0, 4, "sh0", files)
    with np.errstate(over="ignore"):
        opacity_table = sigmoid(colour_tables[3])
    return _Decoders(
        count=meta.means.shape[0],
        means=meta.means,
        scales=lambda codes: _look_up(scale_tables, codes),
        colours=lambda codes: _look_up(colour_tables, codes),
        opacities=lambda codes: opacity_table[codes],
        files=(meta.means.files, meta.scales.files, meta.quats.files, meta.sh0.files),
    )


def _version_2(meta: _MetaV2, files: SogFiles) -> _Decoders:
    """Decoders of a version 2 meta."""
    scales = _codebook(meta.scales.codebook, "scales", files)
    colours = _codebook(meta.sh0.codebook, "sh0", files)
    return _Decoders(
        count=meta.count,
        means=meta.means,
        scales=lambda codes: scales[codes],
        colours=lambda codes: colours[codes],
        opacities=lambda codes: UNIT_OF_BYTE[codes],
        files=(meta.means.files, meta.scales.files, meta.quats.files, meta.sh0.files),
    )


def _codebook(values: list[float], part: str, files: SogFiles) -> F32:
    """256 values, checked."""
    if len(values) != 256:
        raise files.refuse(f"codebook has {len(values)} values, not 256", f"{part}.codebook")
    with np.errstate(over="ignore"):
        return np.array(values, np.float64).astype(np.float32)


def _tables(bounds: _Bounds, channels: int, part: str, files: SogFiles) -> F32:
    """Value of each byte by channel [channels, 256] between the bounds."""
    _check_bounds(bounds, channels, part, files)
    low, high = (np.array(v[:channels], np.float64)[:, None] for v in (bounds.mins, bounds.maxs))
    with np.errstate(all="ignore"):
        table: F64 = low + (high - low) * (np.arange(256) / 255.0)
        return table.astype(np.float32)


def _check_bounds(bounds: _Bounds | _BoundsV1, channels: int, part: str, files: SogFiles) -> None:
    for name in ("mins", "maxs"):
        if len(getattr(bounds, name)) < channels:
            raise files.refuse(
                f"has {len(getattr(bounds, name))} values, not {channels}", f"{part}.{name}"
            )


def _look_up(tables: F32, codes: U8) -> F32:
    return np.stack([tables[c][codes[:, c]] for c in range(codes.shape[1])], axis=1)


def _load_planes(decoders: _Decoders, files: SogFiles) -> dict[str, U8]:
    """The planes that every SOG has, each with at least as many pixels as Gaussians."""
    count = decoders.count
    if not 0 <= count < 1 << 28:
        raise files.refuse(f"meta.json claims {count} Gaussians", "count")
    _check_bounds(decoders.means, 3, "means", files)
    planes: dict[str, U8] = {}
    if count:
        names = zip(("means", "scales", "quats", "sh0"), decoders.files, strict=True)
        for part, listed in names:
            planes[part] = files.plane(listed, 0, part, count)
        planes["means high"] = files.plane(decoders.files[0], 1, "means", count)
    return planes


def _fill(
    builder: CloudBuilder, decoders: _Decoders, planes: dict[str, U8], files: SogFiles
) -> None:
    """Decode the planes block by block."""
    low, high = (np.array(v[:3], np.float64) for v in (decoders.means.mins, decoders.means.maxs))
    for start in range(0, decoders.count, _BLOCK):
        span = slice(start, min(start + _BLOCK, decoders.count))
        with np.errstate(all="ignore"):
            steps = planes["means high"][span, :3].astype(np.float64) * 256.0
            steps += planes["means"][span, :3]
            logs = low + (high - low) * (steps / 65535.0)
            means = np.copysign(np.expm1(np.abs(logs)), logs).astype(np.float32)
            scales = np.exp(decoders.scales(planes["scales"][span, :3]))
        colours = planes["sh0"][span]
        builder.put(
            start,
            means,
            _unpack_rotation(planes["quats"][span], start, files),
            scales,
            decoders.opacities(colours[:, 3]),
            decoders.colours(colours[:, :3]),
        )


def _unpack_rotation(codes: U8, start: int, files: SogFiles) -> F32:
    """Quaternions (w, x, y, z) [R, 4] of bytes [R, 4]: three smallest, and which is left out."""
    tags = codes[:, 3]
    if (tags < 252).any():
        row = int(np.argmax(tags < 252))
        raise files.refuse(
            f"rotation of Gaussian {start + row} has the tag {tags[row]}, not 252 to 255: "
            "the plane is damaged or was not kept lossless",
            "quats",
        )
    three = (codes[:, :3] / 255.0 * 2.0 - 1.0) / math.sqrt(2.0)
    largest = np.sqrt(np.maximum(0.0, 1.0 - np.einsum("ij,ij->i", three, three)))
    return scatter_rotation(three, largest, tags - np.uint8(252))


def _palette_v1(meta: _PaletteV1, files: SogFiles) -> tuple[F32, int]:
    """SH palette [P, K − 1, 3] of version 1, whose degree shows in the width of its picture."""
    data = files.read(meta.files, 0, "shN", _PALETTE_LIMIT * 15)
    picture = decode_picture(data, _PALETTE_ROW * 3, files.file, meta.files[0])
    degree = {_PALETTE_ROW * n: d for d, n in ((1, 3), (2, 8), (3, 15))}.get(picture.shape[1])
    if degree is None:
        raise files.refuse(
            f"SH palette is {picture.shape[1]} pixels wide, not 192, 512 or 960", "shN.files"
        )
    with np.errstate(all="ignore"):
        table = meta.mins + (meta.maxs - meta.mins) * (np.arange(256) / 255.0)
        return _palette(picture, degree, table.astype(np.float32), files)


def _palette_v2(meta: _Palette, files: SogFiles) -> tuple[F32, int]:
    """SH palette [P, K − 1, 3] of version 2, and how many entries of it count."""
    if meta.bands not in (1, 2, 3):
        raise files.refuse(f"SH of {meta.bands} bands, not 1, 2 or 3", "shN.bands")
    if not 0 < meta.count <= _PALETTE_LIMIT:
        raise files.refuse(
            f"SH palette of {meta.count} entries, not 1 to {_PALETTE_LIMIT}", "shN.count"
        )
    per_entry = coefficient_count(meta.bands) - 1
    need = -(-meta.count // _PALETTE_ROW) * _PALETTE_ROW * per_entry
    data = files.read(meta.files, 0, "shN", need)
    width = _PALETTE_ROW * per_entry
    picture = decode_picture(data, need, files.file, meta.files[0], width)
    table = _codebook(meta.codebook, "shN", files)
    values, _ = _palette(picture, meta.bands, table, files)
    return values, meta.count


def _palette(picture: U8, degree: int, table: F32, files: SogFiles) -> tuple[F32, int]:
    """Palette entries of a picture [H, 64 · (K − 1), 4]."""
    if not np.isfinite(table).all():
        raise files.refuse("SH codebook holds NaN or infinite values", "shN")
    per_entry = coefficient_count(degree) - 1
    rows = min(len(picture), _PALETTE_LIMIT // _PALETTE_ROW)
    codes = picture[:rows, :, :3].reshape(-1, per_entry, 3)
    return table[codes], len(codes)


def _fill_sh(builder: CloudBuilder, palette: tuple[F32, int], labels: U8, files: SogFiles) -> None:
    """Copy the palette entry of each Gaussian."""
    values, count = palette
    for start in range(0, len(builder.bad), _BLOCK):
        block = labels[start : min(start + _BLOCK, len(builder.bad))]
        index = block[:, 0] + block[:, 1].astype(np.intp) * 256
        if (index >= count).any():
            row = int(np.argmax(index >= count))
            raise files.refuse(
                f"SH label {index[row]} of Gaussian {start + row} is not below {count}",
                "shN",
            )
        builder.put_rest(start, values[index])
