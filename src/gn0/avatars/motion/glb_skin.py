"""Skins and animations of glTF (.glb, or .gltf with its buffers inside or beside it).

At rest a joint stands where its inverse bind matrix says, in the frame of the skinned mesh. glTF is
in metres with y up. Source: the glTF 2.0 specification, sections 3.7.3 (skins), 3.11 (animations)
and appendix C (interpolation).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from gn0.avatars.file_source import FileSource, open_source
from gn0.avatars.motion.rig import (
    JOINT_LIMIT,
    RigMotion,
    check_rig,
    check_rig_size,
    local_frames,
    tidy_rate,
)
from gn0.avatars.motion.turns import as_numbers, matrices_of, nearest_rotations, slerp
from gn0.gaussians.cloud_source import REFETCH, little
from gn0.gaussians.gltf_buffers import FileBuffer, GltfBuffer, open_buffer
from gn0.gaussians.gltf_document import GltfDocument, find_rows
from gn0.geometry import F64

_T = TypeVar("_T")
MAGIC = b"glTF"
_ENTRIES = 1 << 16  # objects and lists in the JSON; each costs a hundred times its bytes
_COMMAS = 1 << 19
_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_STANDARD_FPS = 30.0
_THERE = 0.999  # of the way to a key: times are float32, and frames are not quite on them
_LONGEST = 1e6  # s
_MOST_FPS = 120.0
_RATIO = 1 << 22  # values of one accessor; 4 million numbers are a day of one joint


class _Node(msgspec.Struct, frozen=True):
    """A place in the scene, perhaps a joint."""

    name: str = ""
    children: list[int] = []
    skin: int | None = None
    matrix: list[float] | None = None
    translation: list[float] | None = None
    rotation: list[float] | None = None
    scale: list[float] | None = None


class _Skin(msgspec.Struct, frozen=True):
    """The joints that a mesh hangs on."""

    joints: list[int]
    inverseBindMatrices: int | None = None  # noqa: N815 (the format's names, here and below)


class _Target(msgspec.Struct, frozen=True):
    """What a channel moves."""

    path: str
    node: int | None = None


class _Channel(msgspec.Struct, frozen=True):
    """A sampler and what it moves."""

    sampler: int
    target: _Target


class _Sampler(msgspec.Struct, frozen=True):
    """Keys in time."""

    input: int
    output: int
    interpolation: str = "LINEAR"


class _Animation(msgspec.Struct, frozen=True):
    """A clip."""

    channels: list[_Channel]
    samplers: list[_Sampler]
    name: str = ""


class _Rig(msgspec.Struct, frozen=True):
    """What of a glTF has to do with motion."""

    nodes: list[_Node] = []
    skins: list[_Skin] = []
    animations: list[_Animation] = []


@dataclass(frozen=True, eq=False)
class _Keys:
    """Keys of one property of one node: times [K] s, values [K, 1 or 3, width]."""

    times: F64
    values: F64
    kind: str

    def at(self, times: F64, turns: bool) -> F64:
        """Values [N, width] at `times` [N] s; held before the first key and after the last."""
        middle = self.values[:, -2] if self.kind == "CUBICSPLINE" else self.values[:, 0]
        if len(self.times) == 1:
            return np.repeat(middle, len(times), axis=0)
        k = np.clip(np.searchsorted(self.times, times, "right") - 1, 0, len(self.times) - 2)
        span = self.times[k + 1] - self.times[k]
        u = np.clip((times - self.times[k]) / np.where(span > 0, span, 1.0), 0.0, 1.0)[:, None]
        first, last = middle[k], middle[k + 1]
        if self.kind == "STEP":
            return np.where(u >= _THERE, last, first)
        if self.kind == "CUBICSPLINE":
            out, back = self.values[k, 2] * span[:, None], self.values[k + 1, 0] * span[:, None]
            return (
                first * (1 + 2 * u) * (1 - u) ** 2
                + last * u**2 * (3 - 2 * u)
                + out * u * (1 - u) ** 2
                - back * u**2 * (1 - u)
            )
        if turns:
            return slerp(first, last, u[:, 0])  # the order of the four is all the same to it
        return first + (last - first) * u


@dataclass(frozen=True, eq=False)
class GltfRest:
    """A glTF as its largest skin was bound.

    Attributes:
        rig: the joints of it and all nodes above them, still, in one frame.
        nodes: node of each joint of the rig [J].
        frames: matrices of those joints to the scene [J, 4, 4], as they were bound.
        above: parent of each node that has one.
        locals: matrix of every node in its parent's axes [M, 4, 4].
        skins: node of each joint of each skin, and number of its inverse bind matrices.
        document, buffers, source, text: the file: its tables, its bytes, itself, its JSON.
    """

    rig: RigMotion
    nodes: tuple[int, ...]
    frames: F64
    above: dict[int, int]
    locals: F64
    skins: tuple[tuple[tuple[int, ...], int | None], ...]
    document: GltfDocument
    buffers: list[GltfBuffer]
    source: FileSource
    text: bytes


def open_gltf_rest(data: bytes, file: Path | str, stack: ExitStack) -> GltfRest:
    """A glTF as it was bound, whether it has clips or not.

    Args:
        data: the bytes of a .glb or .gltf.
        file: its name; buffers beside it are found from there.
        stack: closes its buffers.

    Raises:
        FormatError: damaged, no skin, joints in a loop, or more than it can hold.
    """
    source = open_source(data, file)
    text, binary = _chunks(source)
    _check_text(text, source)
    document, rig = _decode(text, GltfDocument, source), _decode(text, _Rig, source)
    if not rig.skins:
        raise source.refuse(
            "has no skin that says which joints carry it", None, field="skins",
            remedy="bind it to a humanoid skeleton, and export it with its skin",
        )  # fmt: skip
    buffers = _open_buffers(document, source, binary, stack)

    rows, skin = _row_reader(document, buffers, source), _largest_skin(rig, source)
    order, above = _joint_order(rig, skin, source)
    still = np.zeros(1)
    local = np.concatenate([_matrices(rig, k, {}, still, source) for k in range(len(rig.nodes))])
    at_rest: dict[int, F64] = {}
    for node in order:
        higher = at_rest[above[node]] if node in above else np.eye(4)[None]
        at_rest[node] = higher @ local[node][None]
    frames, notes = _rest(rig, skin, order, at_rest, rows, source)
    parents = tuple(order.index(above[node]) if node in above else -1 for node in order)
    turns = nearest_rotations(frames[:, :3, :3])
    quats, steps = local_frames(parents, turns[None], frames[None, :, :3, 3])
    found = RigMotion(
        names=tuple(rig.nodes[node].name[:200] or f"node {node}" for node in order),
        parents=parents, rest_rotations=turns, rest_positions=frames[:, :3, 3], quats=quats,
        translations=steps, fps=_STANDARD_FPS, metres=1.0, up="y", notes=tuple(notes),
    )  # fmt: skip
    skins = tuple((tuple(one.joints), one.inverseBindMatrices) for one in rig.skins)
    return GltfRest(
        found, tuple(order), frames, above, local, skins, document, buffers, source, text
    )


def decode_gltf_motion(
    data: bytes, file: Path | str, clip: str | None = None
) -> tuple[RigMotion, tuple[str, ...]]:
    """One clip of a glTF as a moving skeleton, and the names of all its clips.

    Args:
        data: the bytes of a .glb or .gltf.
        file: its name; buffers beside it are found from there.
        clip: name of the clip; the first by default.

    Raises:
        FormatError: damaged, no skin, no clip, joints in a loop, or more than it can hold.
    """
    source = open_source(data, file)
    text, binary = _chunks(source)
    _check_text(text, source)
    document, rig = _decode(text, GltfDocument, source), _decode(text, _Rig, source)
    if not rig.skins or not rig.animations:
        what = "skin" if not rig.skins else "animation"
        raise source.refuse(
            f"has no {what}", None, field=f"{what}s", remedy="export with skin and animation"
        )
    names = tuple(found.name or f"clip {k}" for k, found in enumerate(rig.animations))
    if clip is not None and clip not in names:
        raise source.refuse(f"has no clip {clip!r}; its clips are {', '.join(names[:40])}", None)
    chosen = names.index(clip) if clip is not None else 0
    with ExitStack() as stack:
        buffers = _open_buffers(document, source, binary, stack)
        return _read(rig, chosen, names, document, buffers, source), names


def _chunks(source: FileSource) -> tuple[bytes, FileBuffer | None]:
    """The JSON, and the binary chunk of a .glb."""
    if source.read(0, min(4, source.size), "the first bytes") != MAGIC:
        return source.read(0, source.size, "the JSON"), None
    header = source.read(0, 20, "the glTF header")
    version, total, length = little(header, 4, 4), little(header, 8, 4), little(header, 12, 4)
    if version != 2:
        raise source.refuse(f"binary glTF version {version} is not read (2 is)", 4)
    if total > source.size or header[16:20] != b"JSON":
        raise source.refuse(
            f"is cut off or damaged: it should have {total} bytes and has {source.size}",
            8,
            remedy=REFETCH,
        )
    text = source.read(20, length, "the JSON chunk")
    at = 20 + length
    if at + 8 <= total:
        chunk = source.read(at, 8, "a chunk header")
        held = little(chunk, 0, 4)
        if chunk[4:8] == b"BIN\0":
            if at + 8 + held > source.size:
                raise source.refuse("the binary chunk runs past the file", at, remedy=REFETCH)
            return text, FileBuffer(source, at + 8, held)
    return text, None


def _check_text(text: bytes, source: FileSource) -> None:
    entries, values = text.count(b"{") + text.count(b"["), text.count(b",")
    if entries > _ENTRIES or values > _COMMAS:
        raise source.refuse(
            f"its JSON has {entries} objects and lists and {values} values, more than any person "
            "needs",
            remedy="export the skeleton of one person",
        )


def _decode(text: bytes, kind: type[_T], source: FileSource) -> _T:
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, OverflowError) as error:
        raise source.refuse(f"its JSON is not what it should be: {error}", remedy=REFETCH) from None


def _open_buffers(
    document: GltfDocument, source: FileSource, binary: FileBuffer | None, stack: ExitStack
) -> list[GltfBuffer]:
    buffers: list[GltfBuffer] = []
    for number, entry in enumerate(document.buffers):
        if bytes(memoryview(entry.uri)[:5]) not in (b"", b"null"):
            buffers.append(open_buffer(source, entry.uri, max(entry.byteLength, 0), stack)[0])
        elif binary is not None and number == 0 and 0 <= entry.byteLength <= binary.length:
            buffers.append(FileBuffer(source, binary.start, entry.byteLength))
        else:
            held = binary.length if binary is not None and number == 0 else 0
            raise source.refuse(
                f"buffer {number} should have {entry.byteLength} bytes, and {held} are there",
                None,
                field="buffers",
                remedy=REFETCH,
            )
    return buffers


def _row_reader(
    document: GltfDocument, buffers: list[GltfBuffer], source: FileSource
) -> Callable[[int, int, str], F64]:
    """Reads an accessor by number, width and the field that names it."""

    def rows(number: int, width: int, field: str) -> F64:
        found = find_rows(document, buffers, number, (width,), field, source)
        if found.count * width > _RATIO:
            raise source.refuse(f"accessor {number} of {found.count} rows is not read", field=field)
        return as_numbers(found.read(0, found.count))

    return rows


def _largest_skin(rig: _Rig, source: FileSource) -> _Skin:
    skin = max(rig.skins, key=lambda skin: len(skin.joints))
    if not 1 <= len(skin.joints) <= JOINT_LIMIT:
        raise source.refuse(
            f"a skin of {len(skin.joints)} joints is not read (1 to {JOINT_LIMIT} are)",
            None,
            field="skins.joints",
            remedy="export the skeleton of one person",
        )
    return skin


def _read(
    rig: _Rig,
    chosen: int,
    names: tuple[str, ...],
    document: GltfDocument,
    buffers: list[GltfBuffer],
    source: FileSource,
) -> RigMotion:
    rows, skin = _row_reader(document, buffers, source), _largest_skin(rig, source)
    order, above = _joint_order(rig, skin, source)
    animation = rig.animations[chosen]
    keys = _read_keys(animation, set(order), rows, source)
    start, fps, count = _frames(keys, len(order), source)
    times = start + np.arange(count) / fps
    parents = tuple(order.index(above[node]) if node in above else -1 for node in order)
    still = {node: _matrices(rig, node, {}, times[:1], source) for node in order}
    turned = np.empty((count, len(order), 3, 3))
    placed = np.empty((count, len(order), 3))
    full: dict[int, F64] = {}
    at_rest: dict[int, F64] = {}
    needed = {parent: k for k, parent in enumerate(parents)}
    for k, node in enumerate(order):
        with np.errstate(all="ignore"):  # what is not finite is named by its frame
            matrix = _matrices(rig, node, keys, times, source)
            default = still[node]
            if parents[k] >= 0:
                matrix = full[parents[k]] @ matrix
                default = at_rest[order[parents[k]]] @ default
        full[k], at_rest[node] = matrix, default
        sound = np.asarray(np.isfinite(matrix).all(axis=(1, 2)))[:, None]
        turn = nearest_rotations(np.where(sound[..., None], matrix[:, :3, :3], np.eye(3)))
        turned[:, k] = np.where(sound[..., None], turn, np.nan)
        placed[:, k] = np.where(sound, matrix[:, :3, 3], np.nan)
        for done in [j for j in full if needed.get(j, -1) <= k]:
            del full[done]
    rest, notes = _rest(rig, skin, order, at_rest, rows, source)
    quats, steps = local_frames(parents, turned, placed)
    if len(names) > 1:
        notes.append(f"{len(names)} clips: {', '.join(names[:40])}; took {names[chosen]!r}")
    result = RigMotion(
        names=tuple(rig.nodes[node].name[:200] or f"node {node}" for node in order),
        parents=parents,
        rest_rotations=nearest_rotations(rest[:, :3, :3]),
        rest_positions=rest[:, :3, 3],
        quats=quats,
        translations=steps,
        fps=fps,
        metres=1.0,
        up="y",
        name=names[chosen],
        notes=tuple(notes),
    )
    return check_rig(result, source.file)


def _joint_order(rig: _Rig, skin: _Skin, source: FileSource) -> tuple[list[int], dict[int, int]]:
    """Joints of a skin and all nodes above them, parents first, and the parent of each node."""
    above: dict[int, int] = {}
    for holder, entry in enumerate(rig.nodes):
        for child in entry.children:
            if not 0 <= child < len(rig.nodes) or child in above:
                raise source.refuse(
                    f"node {child} is missing, or hangs on two others", None, field="nodes.children"
                )
            above[child] = holder
    order: dict[int, None] = {}
    for joint in skin.joints:
        if not 0 <= joint < len(rig.nodes):
            raise source.refuse(f"there is no node {joint}", None, field="skins.joints")
        chain: dict[int, None] = {}
        node: int | None = joint
        while node is not None and node not in order:
            if node in chain:
                raise source.refuse(
                    f"node {node} is its own ancestor: the skeleton is a loop",
                    None,
                    field="nodes.children",
                    remedy="export the skeleton again",
                )
            chain[node] = None
            if len(chain) > JOINT_LIMIT:
                raise source.refuse("the skeleton is too deep", None, field="nodes.children")
            node = above.get(node)
        order |= dict.fromkeys(reversed(list(chain)))
    return list(order), above


def _read_keys(
    animation: _Animation,
    wanted: set[int],
    rows: Callable[[int, int, str], F64],
    source: FileSource,
) -> dict[tuple[int, str], _Keys]:
    """Keys by (node, path)."""
    keys: dict[tuple[int, str], _Keys] = {}
    for channel in animation.channels:
        node, path = channel.target.node, channel.target.path
        if node not in wanted or path not in _WIDTHS or (node, path) in keys:
            continue
        if not 0 <= channel.sampler < len(animation.samplers):
            raise source.refuse(f"there is no sampler {channel.sampler}", None, field="samplers")
        sampler = animation.samplers[channel.sampler]
        if sampler.interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
            raise source.refuse(
                f"interpolation {sampler.interpolation[:40]!r} is not known", None, field="samplers"
            )
        times = rows(sampler.input, 1, "samplers.input")[:, 0]
        values = rows(sampler.output, _WIDTHS[path], "samplers.output")
        each = 3 if sampler.interpolation == "CUBICSPLINE" else 1
        if len(values) != each * len(times):
            raise source.refuse(
                f"{len(times)} keys have {len(values)} values, not {each} each",
                None,
                field="samplers.output",
            )
        sound = np.isfinite(times).all() and np.isfinite(values).all()
        if not sound or (np.diff(times) < 0).any() or np.abs(times).max() > _LONGEST:
            raise source.refuse(
                f"keys of node {node} are not finite, fall in time, or are beyond {_LONGEST:g} s",
                None,
                field="samplers",
                remedy="cut what the capture lost, and export again",
            )
        values = values.reshape(len(times), each, -1)
        if path == "rotation":
            middle = values[:, each // 2]
            size = np.linalg.norm(middle, axis=1, keepdims=True)
            if not (size > 1e-6).all():
                raise source.refuse(
                    f"a rotation of node {node} has no length", None, field="samplers"
                )
            values[:, each // 2] = middle / size if each == 1 else middle
        keys[node, path] = _Keys(times, values, sampler.interpolation)
    if not keys:
        raise source.refuse(
            f"clip {animation.name[:60]!r} moves no joint of the skin",
            None,
            field="animations",
            remedy="choose another clip",
        )
    return keys


def _frames(
    keys: dict[tuple[int, str], _Keys], joints: int, source: FileSource
) -> tuple[float, float, int]:
    """First time [s], frames a second by the closest keys, number of frames."""
    start = min(float(held.times[0]) for held in keys.values())
    stop = max(float(held.times[-1]) for held in keys.values())
    densest = max(keys.values(), key=lambda held: len(held.times))
    gaps = np.diff(densest.times)
    gaps = gaps[gaps > 1e-6]
    fps = _STANDARD_FPS
    if len(gaps) > 1:
        fps = tidy_rate(1.0 / float(np.median(gaps)))
        nearest = round(fps)
        # keys are float32: the rate is only as exact as they are
        fps = float(nearest) if nearest and abs(fps - nearest) < 0.01 * fps else fps
        if not 10.0 <= fps <= _MOST_FPS:
            fps = _STANDARD_FPS if fps < 10.0 else _MOST_FPS
    count = int((stop - start) * fps + 1e-3) + 1
    check_rig_size(joints, count, source.size, source.file)
    return start, fps, count


def _matrices(
    rig: _Rig,
    node: int,
    keys: dict[tuple[int, str], _Keys],
    times: F64,
    source: FileSource,
) -> F64:
    """Matrices [N, 4, 4] of a node in its parent's axes."""
    entry = rig.nodes[node]

    def values(name: str, count: int, default: list[float]) -> F64:
        given = getattr(entry, name)
        given = default if given is None else given
        if len(given) != count:
            raise source.refuse(
                f"node {node} has {len(given)} values, not {count}", None, field=f"nodes.{name}"
            )
        return np.array(given, np.float64)

    if entry.matrix is not None:
        return np.tile(values("matrix", 16, []).reshape(4, 4).T, (len(times), 1, 1))

    def channel(path: str, default: list[float]) -> F64:
        if (node, path) in keys:
            return keys[node, path].at(times, path == "rotation")
        return np.tile(values(path, _WIDTHS[path], default), (len(times), 1))

    turn = channel("rotation", [0.0, 0.0, 0.0, 1.0])
    turn = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    matrix = np.zeros((len(times), 4, 4))
    matrix[:, :3, :3] = matrices_of(turn[:, [3, 0, 1, 2]])
    matrix[:, :3, :3] *= channel("scale", [1.0, 1.0, 1.0])[:, None, :]
    matrix[:, :3, 3] = channel("translation", [0.0, 0.0, 0.0])
    matrix[:, 3, 3] = 1.0
    return matrix


def _rest(
    rig: _Rig,
    skin: _Skin,
    order: list[int],
    at_rest: dict[int, F64],
    rows: Callable[[int, int, str], F64],
    source: FileSource,
) -> tuple[F64, list[str]]:
    """Matrices at rest [J, 4, 4] in the scene's axes, and what to say of them.

    The bind pose is known up to where the mesh stood. Where the nodes stand as they were bound, all
    joints agree on that; else it is where the mesh's own node stands.
    """
    rest = np.concatenate([at_rest[node] for node in order])
    if not np.isfinite(rest).all():
        raise source.refuse("the nodes are placed by no finite matrices", None, field="nodes")
    if skin.inverseBindMatrices is None:
        return rest, ["no inverse bind matrices: its nodes as they stand are the rest pose"]
    rows_of = rows(skin.inverseBindMatrices, 16, "inverseBindMatrices")
    if len(rows_of) < len(skin.joints):
        raise source.refuse(
            f"{len(rows_of)} inverse bind matrices for {len(skin.joints)} joints",
            None,
            field="inverseBindMatrices",
        )
    inverse = np.swapaxes(rows_of[: len(skin.joints)].reshape(-1, 4, 4), 1, 2)
    if not np.isfinite(inverse).all() or (np.abs(np.linalg.det(inverse)) < 1e-12).any():
        raise source.refuse(
            "an inverse bind matrix has no inverse", None, field="inverseBindMatrices"
        )
    stands = np.stack([at_rest[node][0] for node in skin.joints]) @ inverse
    middle = np.median(stands, axis=0)
    agree = np.abs(stands - middle).max() <= 1e-3 * max(1e-9, float(np.abs(middle).max()))
    notes = []
    if not agree:
        meshes = [k for k, node in enumerate(rig.nodes) if node.skin is not None]
        shown = [k for k in meshes if rig.nodes[k].skin == rig.skins.index(skin)]
        middle = _placed(rig, shown[0], source) if shown else np.eye(4)
        notes.append("its nodes stand in another pose than the skin was bound in")
    bound = middle @ np.linalg.inv(inverse)
    for joint, matrix in zip(skin.joints, bound, strict=True):
        rest[order.index(joint)] = matrix
    if not np.isfinite(rest).all():
        raise source.refuse("the bind pose is not finite", None, field="inverseBindMatrices")
    return rest, notes


def _placed(rig: _Rig, node: int, source: FileSource) -> F64:
    """Matrix [4, 4] of a node to the scene."""
    above = {child: parent for parent, entry in enumerate(rig.nodes) for child in entry.children}
    matrix = np.eye(4)
    for _ in range(JOINT_LIMIT):
        matrix = _matrices(rig, node, {}, np.zeros(1), source)[0] @ matrix
        if node not in above:
            break
        node = above[node]
    return matrix
