"""Writers of the motion formats that GN0 only reads, for tests and fuzzing."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gn0.avatars.motion.standing_joints import STANDING_JOINTS
from gn0.avatars.skeleton import INDEX, JOINTS, MIXAMO, PARENTS

TICKS = 46_186_158_000
_CORE = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "left_ankle",
    "right_ankle", "left_foot", "right_foot", "neck", "head", "left_shoulder", "right_shoulder",
    "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
_CORE_PARENT = {"neck": "spine1", "left_shoulder": "spine1", "right_shoulder": "spine1"}


@dataclass(frozen=True, eq=False)
class Puppet:
    """A skeleton that moves, as a test makes it up.

    Attributes:
        names: of the joints [J]; a parent stands before its children.
        parents: their numbers [J], −1 for the root.
        places: joints at rest [J, 3].
        axes: each joint's own axes at rest, to those of its parent: Euler angles xyz [J, 3] deg,
            the x axis first.
        angles: Euler angles of each frame, in those axes [T, J, 3] deg, x first.
        hips: place of the root in each frame [T, 3].
        fps: frames a second.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    places: NDArray[np.float64]
    axes: NDArray[np.float64]
    angles: NDArray[np.float64]
    hips: NDArray[np.float64]
    fps: float = 30.0

    def rest(self) -> list[Rotation]:
        """Axes at rest to the world's, by SciPy."""
        found: list[Rotation] = []
        for k, parent in enumerate(self.parents):
            own = Rotation.from_euler("xyz", self.axes[k], degrees=True)
            found.append(own if parent < 0 else found[parent] * own)
        return found

    def offsets(self) -> NDArray[np.float64]:
        """Place of each joint in its parent's axes at rest [J, 3]."""
        rest = self.rest()
        return np.array(
            [
                self.places[k] if p < 0 else rest[p].inv().apply(self.places[k] - self.places[p])
                for k, p in enumerate(self.parents)
            ]
        )

    def moved(self) -> NDArray[np.float64]:
        """Joints of each frame [T, J, 3], by SciPy: the judge of all readers."""
        offsets, out = self.offsets(), np.empty((len(self.angles), len(self.names), 3))
        for t, angles in enumerate(self.angles):
            turns: list[Rotation] = []
            for k, parent in enumerate(self.parents):
                own = Rotation.from_euler("xyz", self.axes[k], degrees=True)
                own = own * Rotation.from_euler("xyz", angles[k], degrees=True)
                turns.append(own if parent < 0 else turns[parent] * own)
                out[t, k] = (
                    self.hips[t] if parent < 0 else out[t, parent] + turns[parent].apply(offsets[k])
                )
        return out

    def scaled(self, factor: float) -> Puppet:
        """The same in other units."""
        return replace(self, places=self.places * factor, hips=self.hips * factor)

    def z_up(self) -> Puppet:
        """The same with z up, facing −y."""
        turn = Rotation.from_euler("x", 90, degrees=True)
        first = turn * Rotation.from_euler("xyz", self.axes[0], degrees=True)
        axes = self.axes.copy()
        axes[0] = first.as_euler("xyz", degrees=True)
        return replace(self, places=turn.apply(self.places), hips=turn.apply(self.hips), axes=axes)


def make_puppet(
    seed: int = 0,
    frames: int = 6,
    *,
    core: bool = False,
    twisted: bool = True,
    joints: NDArray[np.float64] = STANDING_JOINTS,
    prefix: str = "",
) -> Puppet:
    """A person of Mixamo's joints (or of 18 alone) that moves at random, its own axes twisted."""
    rng = np.random.default_rng(seed)
    if core:
        chosen = [INDEX[name] for name in _CORE]
        above = [
            _CORE.index(_CORE_PARENT[name]) if name in _CORE_PARENT
            else (-1 if name == "pelvis" else _CORE.index(JOINTS[PARENTS[INDEX[name]]]))
            for name in _CORE
        ]  # fmt: skip
    else:
        chosen = [k for k, name in enumerate(JOINTS) if name in MIXAMO]
        above = [chosen.index(PARENTS[k]) if k else -1 for k in chosen]
    count = len(chosen)
    axes = rng.uniform(-170, 170, (count, 3)) * [1, 0.5, 1] if twisted else np.zeros((count, 3))
    angles = np.cumsum(rng.normal(0, 12, (frames, count, 3)), axis=0)
    angles[:, 0] *= 0.3
    hips = joints[0] + np.cumsum(rng.normal(0, 0.05, (frames, 3)), axis=0) + [0.3, 0.95, -0.2]
    return Puppet(
        tuple(prefix + MIXAMO[JOINTS[k]] for k in chosen),
        tuple(above),
        joints[chosen] + [0.0, 0.95, 0.0],
        axes,
        angles,
        hips,
    )


def build_bvh(puppet: Puppet, order: str = "ZXY") -> bytes:
    """A BVH; the puppet's own axes must be those of the world."""
    assert not puppet.axes.any()
    lines = ["HIERARCHY"]
    offsets = puppet.offsets()
    children: dict[int, list[int]] = {}
    for k, parent in enumerate(puppet.parents):
        children.setdefault(parent, []).append(k)
    visited: list[int] = []

    def block(k: int, depth: int) -> None:
        visited.append(k)
        pad = "\t" * depth
        turns = " ".join(f"{axis}rotation" for axis in order)
        moves = "" if depth else "Xposition Yposition Zposition "
        lines.append(f"{pad}{'JOINT' if depth else 'ROOT'} {puppet.names[k]}")
        lines.append(pad + "{")
        lines.append(f"{pad}\tOFFSET " + " ".join(f"{v:.12f}" for v in offsets[k]))
        lines.append(f"{pad}\tCHANNELS {3 if depth else 6} {moves}{turns}")
        for child in children.get(k, ()):
            block(child, depth + 1)
        if k not in children:
            lines.append(f"{pad}\tEnd Site\n{pad}\t{{\n{pad}\t\tOFFSET 0 0.1 0\n{pad}\t}}")
        lines.append(pad + "}")

    block(0, 0)
    lines += ["MOTION", f"Frames: {len(puppet.angles)}", f"Frame Time: {1 / puppet.fps:.9f}"]
    for t, angles in enumerate(puppet.angles):
        turns = Rotation.from_euler("xyz", angles, degrees=True)
        written = turns.as_euler(order, degrees=True)  # capitals: intrinsic, R = R1 R2 R3
        row = [*puppet.hips[t], *(value for k in visited for value in written[k])]
        lines.append(" ".join(f"{value:.12f}" for value in row))
    return ("\n".join(lines) + "\n").encode()


def _scalar(value: Any) -> bytes:
    if isinstance(value, bool):
        return b"C" + struct.pack("<b", value)
    if isinstance(value, int):
        return b"L" + struct.pack("<q", value)
    if isinstance(value, float):
        return b"D" + struct.pack("<d", value)
    if isinstance(value, str):
        return b"S" + struct.pack("<I", len(value.encode())) + value.encode()
    kind = {"<i8": b"l", "<f4": b"f", "<f8": b"d", "<i4": b"i"}[value.dtype.str]
    raw = value.tobytes()
    packed = zlib.compress(raw) if len(raw) > 128 else raw
    return kind + struct.pack("<III", len(value), packed is not raw, len(packed)) + packed


Record = tuple[str, list[Any], list[Any]]


def _record(record: Record, at: int, wide: bool) -> bytes:
    """One record and all below it, beginning at byte `at`."""
    name, values, children = record
    head = struct.Struct("<QQQB" if wide else "<IIIB")
    body = b"".join(_scalar(value) for value in values)
    below = b""
    begin = at + head.size + len(name) + len(body)
    for child in children:
        below += _record(child, begin + len(below), wide)
    if children:
        below += bytes(head.size)
    end = begin + len(below)
    return head.pack(end, len(values), len(body), len(name)) + name.encode() + body + below


def fbx_bytes(records: list[Record], version: int) -> bytes:
    """A binary FBX of records."""
    wide = version >= 7500
    data = b"Kaydara FBX Binary  \0\x1a\0" + struct.pack("<I", version)
    for record in records:
        data += _record(record, len(data), wide)
    return data + bytes(25 if wide else 13) + bytes(160)


def build_fbx(
    puppet: Puppet,
    version: int = 7400,
    *,
    empty_take: bool = True,
    keys: bool = True,
    unit: float = 100.0,
    up: int = 1,
    still: bool = False,
) -> bytes:
    """A binary FBX with bind pose and, at will, an empty first take before the one with keys."""
    offsets, rest = puppet.offsets(), puppet.rest()
    objects: list[Record] = []
    links: list[Record] = []

    def setting(name: str, *values: Any) -> Record:
        return ("P", [name, "", "", "A", *values], [])

    def link(kind: str, child: int, parent: int, *path: str) -> None:
        links.append(("C", [kind, child, parent, *path], []))

    times = np.rint(np.arange(len(puppet.angles)) / puppet.fps * TICKS).astype("<i8")
    for k, name in enumerate(puppet.names):
        start = [float(v) for v in (puppet.hips[0] if k == 0 else offsets[k])]
        settings = [
            setting("RotationActive", 1),
            setting("PreRotation", *map(float, puppet.axes[k])),
            setting("Lcl Translation", *start),
            setting("Lcl Rotation", *map(float, puppet.angles[0, k])),
        ]
        if still:
            settings = [*settings[:2], setting("Lcl Translation", *map(float, offsets[k]))]
        model: Record = ("Model", [1000 + k, f"{name}\0\x01Model", "LimbNode"],
                 [("Properties70", [], settings)])  # fmt: skip
        objects.append(model)
        parent = puppet.parents[k]
        link("OO", 1000 + k, 1000 + parent if parent >= 0 else 0)
        bind = np.eye(4)
        bind[:3, :3], bind[:3, 3] = rest[k].as_matrix(), puppet.places[k]
        matrix = np.ascontiguousarray(bind.T).reshape(-1).astype("<f8")
        objects.append(
            ("Deformer", [3000 + k, "\0\x01SubDeformer", "Cluster"],
             [("TransformLink", [matrix], [])])
        )  # fmt: skip
        link("OO", 1000 + k, 3000 + k)
    takes = ([("Take 001", 1)] if empty_take else []) + ([("mixamo.com", 2)] if keys else [])
    for name, number in takes:
        objects.append(("AnimationStack", [number, f"{name}\0\x01AnimStack", ""], []))
        objects.append(("AnimationLayer", [10 + number, "\0\x01AnimLayer", ""], []))
        link("OO", 10 + number, number)
    for k in range(len(puppet.names)) if keys else ():
        tracks = [("Lcl Rotation", 4000 + k, puppet.angles[:, k])]
        tracks += [("Lcl Translation", 5000, puppet.hips)] if k == 0 else []
        for path, node, values in tracks:
            objects.append(("AnimationCurveNode", [node, "\0\x01AnimCurveNode", ""], []))
            link("OO", node, 12)
            link("OP", node, 1000 + k, path)
            for axis in range(3):
                curve = node * 10 + axis
                row: list[Record] = [
                    ("KeyTime", [times], []),
                    ("KeyValueFloat", [values[:, axis].astype("<f8")], []),
                    ("KeyAttrFlags", [np.array([0x404], "<i4")], []),
                    ("KeyAttrDataFloat", [np.zeros(4, "<f4")], []),
                    ("KeyAttrRefCount", [np.array([len(times)], "<i4")], []),
                ]
                objects.append(("AnimationCurve", [curve, "\0\x01AnimCurve", ""], row))
                link("OP", curve, node, f"d|{'XYZ'[axis]}")
    settings = [
        setting("UpAxis", up), setting("UpAxisSign", 1), setting("UnitScaleFactor", unit),
        setting("TimeMode", 14), setting("CustomFrameRate", float(puppet.fps)),
    ]  # fmt: skip
    return fbx_bytes(
        [
            ("GlobalSettings", [], [("Properties70", [], settings)]),
            ("Objects", [], objects),
            ("Connections", [], links),
        ],
        version,
    )


def build_glb(puppet: Puppet, kind: str = "LINEAR", clip: str = "Walk") -> bytes:
    """A .glb with a skin and one clip; numbers are float32."""
    offsets, rest = puppet.offsets(), puppet.rest()
    blob = b""
    views: list[dict[str, int]] = []
    accessors: list[dict[str, Any]] = []

    def put(values: NDArray[np.float64], shape: str) -> int:
        nonlocal blob
        raw = np.ascontiguousarray(values, "<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(raw)})
        accessors.append({
            "bufferView": len(views) - 1, "componentType": 5126, "count": len(values),
            "type": shape,
        })  # fmt: skip
        blob += raw
        return len(accessors) - 1

    nodes: list[dict[str, Any]] = []
    inverse = np.empty((len(puppet.names), 4, 4))
    for k, name in enumerate(puppet.names):
        own = Rotation.from_euler("xyz", puppet.axes[k], degrees=True)
        node = {
            "name": name,
            "translation": list(map(float, offsets[k])),
            "rotation": list(map(float, own.as_quat())),
        }
        below = [j for j, parent in enumerate(puppet.parents) if parent == k]
        nodes.append(node | ({"children": below} if below else {}))
        bind = np.eye(4)
        bind[:3, :3], bind[:3, 3] = rest[k].as_matrix(), puppet.places[k]
        inverse[k] = np.linalg.inv(bind)
    skin = {
        "joints": list(range(len(nodes))),
        "inverseBindMatrices": put(np.swapaxes(inverse, 1, 2).reshape(-1, 16), "MAT4"),
    }
    times = put(np.arange(len(puppet.angles))[:, None] / puppet.fps, "SCALAR")

    def track(values: NDArray[np.float64]) -> NDArray[np.float64]:
        if kind != "CUBICSPLINE":
            return values
        zero = np.zeros_like(values)
        return np.stack([zero, values, zero], 1).reshape(-1, values.shape[1])

    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    for k in range(len(nodes)):
        own = Rotation.from_euler("xyz", puppet.axes[k], degrees=True)
        turns = (own * Rotation.from_euler("xyz", puppet.angles[:, k], degrees=True)).as_quat()
        tracks = [("rotation", turns, "VEC4")]
        tracks += [("translation", puppet.hips, "VEC3")] if k == 0 else []
        for path, values, shape in tracks:
            channels.append({"sampler": len(samplers), "target": {"node": k, "path": path}})
            output = put(track(values), shape)
            samplers.append({"input": times, "output": output, "interpolation": kind})
    document = {
        "asset": {"version": "2.0"},
        "nodes": nodes,
        "skins": [skin],
        "animations": [{"name": clip, "channels": channels, "samplers": samplers}],
        "buffers": [{"byteLength": len(blob)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return glb_bytes(document, blob)


def glb_bytes(document: dict[str, Any], blob: bytes) -> bytes:
    """A .glb of its two chunks."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    blob += bytes(-len(blob) % 4)
    size = 12 + 8 + len(text) + 8 + len(blob)
    return (
        b"glTF" + struct.pack("<II", 2, size) + struct.pack("<I", len(text)) + b"JSON" + text
        + struct.pack("<I", len(blob)) + b"BIN\0" + blob
    )  # fmt: skip
