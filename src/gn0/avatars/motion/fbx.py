"""Binary FBX 7.1 to 7.7: skeleton, bind pose, and the take that has keys.

A joint is placed by T · Roff · Rp · Rpre · R · Rpost⁻¹ · Rp⁻¹ · Soff · Sp · S · Sp⁻¹ in its
parent's axes; pre- and post-rotation count where RotationActive is set. At rest it stands where its
skin cluster (TransformLink) or the bind pose says, else by its own defaults. Source: the transform
of the FBX SDK's documentation; what counts when, by files.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gn0.avatars.motion.fbx_curve import FbxCurve, decode_curve
from gn0.avatars.motion.fbx_document import REEXPORT, FbxDocument, FbxRecord
from gn0.avatars.motion.rig import (
    JOINT_LIMIT,
    RigMotion,
    check_rig,
    check_rig_size,
    local_frames,
    tidy_rate,
)
from gn0.avatars.motion.turns import about_axis, matrices_of, multiply, nearest_rotations
from gn0.geometry import F64

_ORDERS = ("xyz", "xzy", "yzx", "yxz", "zxy", "zyx", "xyz")  # the first turns first
_RATES = {
    0: 30.0, 1: 120.0, 2: 100.0, 3: 60.0, 4: 50.0, 5: 48.0, 6: 30.0, 7: 30.0, 8: 29.97, 9: 29.97,
    10: 25.0, 11: 24.0, 12: 1000.0, 13: 23.976, 15: 96.0, 16: 72.0, 17: 59.94, 18: 119.88,
}  # fmt: skip
_CUSTOM = 14
_OBJECT_LIMIT = 1 << 16  # of each kind
_KEY_LIMIT = 1 << 20  # of any file; larger files may have more
_CONTROLS = ("IKEffector", "FKEffector")  # handles of an animator, no joints
_PATHS = {"Lcl Translation": "t", "Lcl Rotation": "r", "Lcl Scaling": "s"}
_CHANNELS = {"d|X": 0, "d|Y": 1, "d|Z": 2}
_RELATIVE = 2  # InheritType: without the parent's scale

Properties = dict[str, list[Any]]


@dataclass
class _Objects:
    """What an FBX holds, by number."""

    models: dict[int, tuple[str, str, FbxRecord]] = field(default_factory=dict)
    stacks: dict[int, str] = field(default_factory=dict)
    layers: set[int] = field(default_factory=set)
    nodes: dict[int, FbxRecord] = field(default_factory=dict)
    curves: dict[int, FbxRecord] = field(default_factory=dict)
    clusters: dict[int, FbxRecord] = field(default_factory=dict)
    poses: list[FbxRecord] = field(default_factory=list)
    parent: dict[int, int] = field(default_factory=dict)  # of models
    stack_of: dict[int, int] = field(default_factory=dict)  # of layers
    layer_of: dict[int, int] = field(default_factory=dict)  # of curve nodes
    drives: dict[int, tuple[int, str]] = field(default_factory=dict)  # model, path; of curve nodes
    axis_of: dict[int, tuple[int, int]] = field(default_factory=dict)  # curve node, axis; of curves
    bone_of: dict[int, int] = field(default_factory=dict)  # model; of clusters


def decode_fbx(data: bytes, file: Path | str) -> RigMotion:
    """The skeleton of an FBX and the take that has the most keys.

    Raises:
        FormatError: text FBX, another version, damaged, no joints, a loop of joints, no keys.
    """
    document = FbxDocument(data, file)
    roots: dict[str, FbxRecord] = {}
    for record in document.roots():
        roots.setdefault(record.name, record)
    if document.version < 7000:
        raise _refuse_old(document, roots.get("Takes"))
    if "Objects" not in roots or "Connections" not in roots:
        raise document.refuse("has no Objects or no Connections: cut off", len(data))
    settings = _settings(document, roots)
    objects = _collect(document, roots["Objects"])
    _connect(document, roots["Connections"], objects)
    order = _joint_order(document, objects)
    take, chosen, notes = _choose_take(document, objects, set(order))
    curves = {place: decode_curve(document, record) for place, record in chosen.items()}
    template = _template(document, roots.get("Definitions"))
    fps, notes_of_rate = _rate(settings)
    start, count = _frames(document, curves, fps, len(order))
    times = start + np.arange(count) / fps
    parents = tuple(_number_in(order, objects.parent.get(model)) for model in order)
    turned, placed, rest = _move(document, objects, order, parents, curves, template, times)
    quats, steps = local_frames(parents, turned, placed)
    rig = RigMotion(
        names=tuple(objects.models[model][0] for model in order),
        parents=parents,
        rest_rotations=nearest_rotations(rest[:, :3, :3]),
        rest_positions=rest[:, :3, 3],
        quats=quats,
        translations=steps,
        fps=fps,
        metres=_unit(settings),
        up=_up(settings),
        name=take,
        notes=(*notes, *notes_of_rate),
    )
    return check_rig(rig, file)


def _refuse_old(document: FbxDocument, takes: FbxRecord | None) -> Exception:
    """Why a version 6 is not read: its takes are another way of keeping keys, or hold none."""
    names = []
    keys = 0
    for take in document.children(takes) if takes else ():
        if take.name == "Take":
            names += [str(name)[:60] for name in document.properties(take, 1)]
            keys += sum(1 for part in document.children(take) if part.name == "Model")
    held = f"{len(names)} take(s) {names[:3]}, " + ("with keys" if keys else "none with keys")
    return document.refuse(
        f"FBX version {document.version} keeps motion in another way, and is not read; it holds "
        f"{held}",
        23,
        field="FBXVersion",
        remedy=REEXPORT,
    )


def _collect(document: FbxDocument, record: FbxRecord) -> _Objects:
    """All objects that have to do with motion."""
    objects = _Objects()
    tables: dict[str, dict[int, FbxRecord]] = {
        "AnimationCurveNode": objects.nodes,
        "AnimationCurve": objects.curves,
    }
    for found in document.children(record):
        if found.name not in (
            "Model", "AnimationStack", "AnimationLayer", "Deformer", "Pose", *tables,
        ):  # fmt: skip
            continue
        values = document.properties(found, 3)
        if len(values) < 3 or not isinstance(values[0], int):
            raise document.refuse("an object has no number", found.at, field=found.name)
        number, kind = values[0], str(values[2])
        name = str(values[1]).split("\0", 1)[0][:200]
        if found.name == "Model":
            objects.models[number] = (name, kind, found)
        elif found.name == "AnimationStack":
            objects.stacks[number] = name
        elif found.name == "AnimationLayer":
            objects.layers.add(number)
        elif found.name == "Deformer" and kind == "Cluster":
            objects.clusters[number] = found
        elif found.name == "Pose" and kind == "BindPose":
            objects.poses.append(found)
        elif found.name in tables:
            tables[found.name][number] = found
        most = max(
            len(objects.models), len(objects.nodes), len(objects.curves), len(objects.clusters),
            len(objects.poses), len(objects.stacks), len(objects.layers),
        )  # fmt: skip
        if most > _OBJECT_LIMIT:
            raise document.refuse(
                f"more than {_OBJECT_LIMIT} objects of one kind", found.at, remedy=REEXPORT
            )
    return objects


def _connect(document: FbxDocument, record: FbxRecord, objects: _Objects) -> None:
    """Who belongs to whom."""
    for found in document.children(record):
        values = document.properties(found, 4) if found.name == "C" else []
        if len(values) < 3 or not isinstance(values[1], int) or not isinstance(values[2], int):
            continue
        child, parent = values[1], values[2]
        path = str(values[3]) if len(values) > 3 else ""
        if child in objects.models:
            if parent in objects.models and values[0] == "OO":
                objects.parent.setdefault(child, parent)
            elif parent in objects.clusters:
                objects.bone_of[parent] = child
        elif child in objects.layers and parent in objects.stacks:
            objects.stack_of[child] = parent
        elif child in objects.nodes:
            if parent in objects.layers:
                objects.layer_of[child] = parent
            elif parent in objects.models and path in _PATHS:
                objects.drives[child] = (parent, _PATHS[path])
        elif child in objects.curves and parent in objects.nodes and path in _CHANNELS:
            objects.axis_of[child] = (parent, _CHANNELS[path])


def _joint_order(document: FbxDocument, objects: _Objects) -> list[int]:
    """Joints and what they hang on, parents first.

    Raises:
        FormatError: no joints, too many, or a loop.
    """
    wanted: dict[int, None] = {}
    for model, (_, kind, _) in objects.models.items():
        if kind not in ("LimbNode", "Limb", "Root"):
            continue
        chain: list[int] = []
        above: int | None = model
        while above is not None and above not in wanted:
            if above in chain or len(chain) > JOINT_LIMIT:
                name = objects.models[above][0]
                raise document.refuse(f"joint {name!r} is its own ancestor", field="Connections")
            chain.append(above)
            above = objects.parent.get(above)
        wanted |= dict.fromkeys(reversed(chain))
        if len(wanted) > JOINT_LIMIT:
            break
    order = [model for model in wanted if objects.models[model][1] not in _CONTROLS]
    if not order:
        raise document.refuse("has no joints (LimbNode)", field="Objects", remedy=REEXPORT)
    if len(order) > JOINT_LIMIT:
        raise document.refuse(f"more than {JOINT_LIMIT} joints", field="Objects")
    return order


def _number_in(order: list[int], model: int | None) -> int:
    return order.index(model) if model is not None and model in order else -1


def _choose_take(
    document: FbxDocument, objects: _Objects, joints: set[int]
) -> tuple[str, dict[tuple[int, str, int], FbxRecord], list[str]]:
    """The take with the most keys: its name, its curves by (model, path, axis), what to say."""
    takes: dict[int, dict[tuple[int, str, int], FbxRecord]] = {}
    keys: dict[int, int] = {}
    layers: dict[int, set[int]] = {}
    for curve, (node, axis) in objects.axis_of.items():
        layer = objects.layer_of.get(node, -1)
        stack = objects.stack_of.get(layer)
        model, path = objects.drives.get(node, (-1, ""))
        if stack is None or model not in joints:
            continue
        times = document.child(objects.curves[curve], "KeyTime")
        count = document.array_length(times) if times else 0
        if count:
            takes.setdefault(stack, {}).setdefault((model, path, axis), objects.curves[curve])
            keys[stack] = keys.get(stack, 0) + count
            layers.setdefault(stack, set()).add(layer)
    if not keys:
        names = ", ".join(repr(name[:60]) for name in list(objects.stacks.values())[:4]) or "none"
        raise document.refuse(
            f"no take has keys for its joints (takes: {names})",
            field="AnimationStack",
            remedy="export with animation, baked to the joints",
        )
    best = max(keys, key=lambda stack: keys[stack])
    if keys[best] > _KEY_LIMIT + len(document.data) // 8:
        raise document.refuse(f"a take of {keys[best]} keys is not read", field="AnimationCurve")
    notes = []
    if len(objects.stacks) > 1:
        others = [name[:60] for stack, name in objects.stacks.items() if stack != best]
        notes.append(f"take {objects.stacks[best]!r} has the most keys; left: {others[:6]}")
    if len(layers[best]) > 1:
        notes.append(f"the take has {len(layers[best])} layers; the first of each curve was taken")
    return objects.stacks[best], takes[best], notes


def _settings(document: FbxDocument, roots: dict[str, FbxRecord]) -> Properties:
    record = roots.get("GlobalSettings")
    return _properties70(document, record) if record else {}


def _properties70(document: FbxDocument, record: FbxRecord) -> Properties:
    """Values of the settings of a record, by name."""
    found: Properties = {}
    held = document.child(record, "Properties70")
    for number, row in enumerate(document.children(held) if held else ()):
        if number > 1024:
            raise document.refuse("more than 1024 settings", row.at, field=record.name)
        values = document.properties(row, 8) if row.name == "P" else []
        if len(values) > 4:
            found[str(values[0])[:60]] = values[4:]
    return found


def _template(document: FbxDocument, definitions: FbxRecord | None) -> Properties:
    """Defaults of all models."""
    for kind in document.children(definitions) if definitions else ():
        if kind.name == "ObjectType" and document.properties(kind, 1)[:1] == ["Model"]:
            held = document.child(kind, "PropertyTemplate")
            return _properties70(document, held) if held else {}
    return {}


def _value(settings: Properties, name: str, default: float) -> float:
    values = settings.get(name, [])
    usable = bool(values) and isinstance(values[0], int | float)
    return float(values[0]) if usable else default


def _vector(settings: Properties, name: str, default: float = 0.0) -> F64:
    values = settings.get(name, [])
    if len(values) < 3 or not all(isinstance(value, int | float) for value in values[:3]):
        return np.full(3, default)
    return np.array(values[:3], np.float64)


def _rate(settings: Properties) -> tuple[float, list[str]]:
    """Frames a second, and what to say of them."""
    mode = int(_value(settings, "TimeMode", 0))
    custom = _value(settings, "CustomFrameRate", -1.0)
    if mode == _CUSTOM and 1.0 <= custom <= 1000.0:
        return tidy_rate(custom), []
    if mode in _RATES:
        return _RATES[mode], []
    return 30.0, [f"its time mode {mode} is not known; 30 frames a second were taken"]


def _unit(settings: Properties) -> float:
    """Metres in a unit; the file's own measure is centimetres."""
    return _value(settings, "UnitScaleFactor", 1.0) / 100.0


def _up(settings: Properties) -> str:
    axis = int(_value(settings, "UpAxis", 1))
    sign = "-" if _value(settings, "UpAxisSign", 1) < 0 else ""
    return sign + "xyz"[axis] if axis in (0, 1, 2) else ""


def _frames(
    document: FbxDocument,
    curves: dict[tuple[int, str, int], FbxCurve],
    fps: float,
    joints: int,
) -> tuple[float, int]:
    """First time [s] of the take, and how many frames it has."""
    start = min(float(curve.times[0]) for curve in curves.values())
    stop = max(float(curve.times[-1]) for curve in curves.values())
    count = int((stop - start) * fps + 1e-4) + 1
    check_rig_size(joints, count, len(document.data), document.file)
    return start, count


def _move(
    document: FbxDocument,
    objects: _Objects,
    order: list[int],
    parents: tuple[int, ...],
    curves: dict[tuple[int, str, int], FbxCurve],
    template: Properties,
    times: F64,
) -> tuple[F64, F64, F64]:
    """Rotations [T, J, 3, 3] and places [T, J, 3] of the joints, and rest matrices [J, 4, 4]."""
    turned = np.empty((len(times), len(order), 3, 3))
    placed = np.empty((len(times), len(order), 3))
    rest = np.empty((len(order), 4, 4))
    bound = _bind_matrices(document, objects)
    waiting = {parent: k for k, parent in enumerate(parents)}  # last joint that needs a parent
    full: dict[int, F64] = {}
    for k, model in enumerate(order):
        settings = template | _properties70(document, objects.models[model][2])
        moving = {
            (path, axis): curves[model, path, axis]
            for path in "trs"
            for axis in range(3)
            if (model, path, axis) in curves
        }
        with np.errstate(all="ignore"):  # what is not finite is named by its frame
            local = _local_matrices(settings, moving, times)
            default = _local_matrices(settings, {}, times[:1])[0]
            matrix = local
            if parents[k] >= 0:
                above, above_rest = full[parents[k]], rest[parents[k]]
                if _value(settings, "InheritType", 0) == _RELATIVE:
                    local[:, :3, :3] /= _scale_of(above)[:, :, None]
                    default[:3, :3] /= _scale_of(above_rest[None])[0][:, None]
                matrix, default = above @ local, above_rest @ default
            rest[k] = bound.get(model, default)
            full[k] = matrix
            sound = np.asarray(np.isfinite(matrix).all(axis=(1, 2)))
            turn = nearest_rotations(np.where(sound[:, None, None], matrix[:, :3, :3], np.eye(3)))
        turned[:, k] = np.where(sound[:, None, None], turn, np.nan)
        placed[:, k] = np.where(sound[:, None], matrix[:, :3, 3], np.nan)
        for done in [j for j in full if waiting.get(j, -1) <= k]:
            del full[done]
    if not np.isfinite(rest).all():
        raise document.refuse("the rest pose is not finite", field="TransformLink")
    return turned, placed, rest


def _scale_of(matrices: F64) -> F64:
    size = np.linalg.norm(matrices[:, :3, :3], axis=1)
    return np.where(size > 1e-12, size, 1.0)


def _euler(degrees: F64, order: str) -> F64:
    """Rotations [N, 3, 3] of angles [N, 3]; the first axis of `order` turns first."""
    if not degrees.any():
        return np.tile(np.eye(3), (len(degrees), 1, 1))
    angles = np.deg2rad(np.where(np.abs(degrees) < 1e9, degrees, np.nan))
    turn = np.array([1.0, 0.0, 0.0, 0.0])
    for axis in order:
        turn = multiply(about_axis(axis, angles[:, "xyz".index(axis)]), turn)
    return matrices_of(turn)


def _local_matrices(
    settings: Properties, moving: dict[tuple[str, int], FbxCurve], times: F64
) -> F64:
    """Matrices [N, 4, 4] of a joint in its parent's axes."""

    def channel(path: str, name: str, default: float) -> F64:
        values = np.tile(_vector(settings, name, default), (len(times), 1))
        for axis in range(3):
            if (path, axis) in moving:
                values[:, axis] = moving[path, axis].at(times)
        return values

    active = bool(_value(settings, "RotationActive", 0))
    order = int(_value(settings, "RotationOrder", 0)) if active else 0
    turn = _euler(channel("r", "Lcl Rotation", 0.0), _ORDERS[order if 0 <= order < 7 else 0])
    if active:
        before, after = (
            _euler(_vector(settings, name)[None], "xyz")[0]
            for name in ("PreRotation", "PostRotation")
        )
        turn = before @ turn @ after.T
    size = channel("s", "Lcl Scaling", 1.0)
    pivot, pivot_of_size = _vector(settings, "RotationPivot"), _vector(settings, "ScalingPivot")
    inner = -pivot + _vector(settings, "ScalingOffset") + pivot_of_size - size * pivot_of_size
    matrix = np.zeros((len(times), 4, 4))
    matrix[:, :3, :3] = turn * size[:, None, :]
    matrix[:, :3, 3] = (
        channel("t", "Lcl Translation", 0.0)
        + _vector(settings, "RotationOffset")
        + pivot
        + np.einsum("tab,tb->ta", turn, inner)
    )
    matrix[:, 3, 3] = 1.0
    return matrix


def _bind_matrices(document: FbxDocument, objects: _Objects) -> dict[int, F64]:
    """Where joints stood when the skin was bound [4, 4], by model."""
    found: dict[int, F64] = {}

    def put(model: Any, record: FbxRecord | None) -> None:
        values = document.array(record, "d")
        if values is None or model not in objects.models:
            return
        if values.shape != (16,) or not (np.abs(values) < 1e9).all():
            raise document.refuse(
                "a bind matrix is not a finite 4 × 4 matrix", field="TransformLink"
            )
        found.setdefault(model, values.reshape(4, 4).T.astype(np.float64))

    for cluster, record in objects.clusters.items():
        if cluster in objects.bone_of:
            put(objects.bone_of[cluster], document.child(record, "TransformLink"))
    for pose in objects.poses[:64]:
        for node in document.children(pose):
            if node.name == "PoseNode":
                number = document.child(node, "Node")
                values = document.properties(number, 1) if number else []
                if values and isinstance(values[0], int):
                    put(values[0], document.child(node, "Matrix"))
    return found
