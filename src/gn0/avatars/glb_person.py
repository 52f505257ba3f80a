"""A person from a glTF with a humanoid skin: its triangles become discs, its textures albedo.

The skeleton is matched by names and rest pose as motions are. Its bones keep their lengths: the
avatar at rest is the file's own figure, its limbs turned into our T-pose.
"""

from __future__ import annotations

import binascii
import io
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

import msgspec
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gn0.avatars.avatar import Avatar
from gn0.avatars.body_file import load_body
from gn0.avatars.cover import THICKNESS, disc_axes
from gn0.avatars.layer import PARTS, smooth_normals
from gn0.avatars.motion.glb_skin import GltfRest, open_gltf_rest
from gn0.avatars.motion.name_maps import JointMap, map_joints, rest_axes
from gn0.avatars.motion.retarget import bone_ends, rest_offsets
from gn0.avatars.motion.standing_joints import hip_height_of
from gn0.avatars.sampling import SheetPoints, spread_points
from gn0.avatars.skeleton import INDEX, JOINT_COUNT, PARENTS
from gn0.avatars.skinning import pack_weights, unskin_points
from gn0.avatars.surfels import blended_turns
from gn0.errors import FormatError
from gn0.gaussians.film import decode_srgb
from gn0.gaussians.gltf_document import find_rows
from gn0.geometry import F64, quaternion_from_rotation
from gn0.seeds import random_stream
from gn0.storage import plain_path, read_bytes, safe_join

COUNT = 32_000  # discs
_TALL = (0.5, 2.6)  # m; others are made as tall as the next
_HEIGHT = 1.75  # m
_FILE_MOST = 1 << 28  # bytes
_ROWS_MOST = 2_000_000  # vertices or corners
_PIXELS_MOST = 1 << 26
_SEEN = 0.5  # opacity from which there is something
_FINEST, _COARSEST = 0.003, 0.014  # distance of discs on a person of `_HEIGHT` [m]


class _Texture(msgspec.Struct, frozen=True):
    index: int
    texCoord: int = 0  # noqa: N815 (the format's names, here and below)


class _Surface(msgspec.Struct, frozen=True):
    baseColorFactor: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)  # noqa: N815
    baseColorTexture: _Texture | None = None  # noqa: N815


class _Material(msgspec.Struct, frozen=True):
    pbrMetallicRoughness: _Surface = _Surface()  # noqa: N815
    alphaMode: str = "OPAQUE"  # noqa: N815


class _Source(msgspec.Struct, frozen=True):
    source: int | None = None


class _Image(msgspec.Struct, frozen=True):
    uri: str | None = None
    bufferView: int | None = None  # noqa: N815


class _Primitive(msgspec.Struct, frozen=True):
    attributes: dict[str, int] = {}
    indices: int | None = None
    material: int | None = None
    mode: int = 4


class _Mesh(msgspec.Struct, frozen=True):
    primitives: list[_Primitive] = []


class _Node(msgspec.Struct, frozen=True):
    mesh: int | None = None
    skin: int | None = None


class _Figure(msgspec.Struct, frozen=True):
    nodes: list[_Node] = []
    meshes: list[_Mesh] = []
    materials: list[_Material] = []
    textures: list[_Source] = []
    images: list[_Image] = []


@dataclass(frozen=True, eq=False)
class _Piece:
    """Triangles of one material.

    Attributes:
        vertices: in the scene, as they were bound [V, 3].
        triangles: [T, 3].
        weights: of the rig's joints [V, J].
        uv: texture coordinates [V, 2].
        colours: with opacity [V, 4].
        material: what they are made of.
    """

    vertices: F64
    triangles: NDArray[np.int64]
    weights: F64
    uv: F64
    colours: F64
    material: _Material


def load_glb_person(path: Path | str, *, count: int = COUNT) -> Avatar:
    """A person from a `.glb` or `.gltf` with a humanoid skin.

    Args:
        path: the file; meshes that hang on its joints without a skin come along.
        count: about how many splats.

    Raises:
        StorageError: the file cannot be read.
        FormatError: damaged, no skin, no skeleton of a person, or no triangles on it.
    """
    file = plain_path(path)
    with ExitStack() as stack:
        rest = open_gltf_rest(read_bytes(file, _FILE_MOST), file, stack)
        try:
            figure = msgspec.json.decode(rest.text, type=_Figure)
        except (msgspec.DecodeError, RecursionError) as error:
            raise rest.source.refuse(f"its JSON is not what it should be: {error}") from None
        known = map_joints(rest.rig, file)
        pieces = list(_pieces(figure, rest))
        if not pieces:
            raise rest.source.refuse(
                "no triangles hang on its skin", None, field="meshes",
                remedy="export the mesh with its skeleton",
            )  # fmt: skip
        textures = _Textures(figure, rest)
        return _dress(file, rest, known, pieces, textures, count)


def _dress(
    file: Path,
    rest: GltfRest,
    known: JointMap,
    pieces: list[_Piece],
    textures: _Textures,
    count: int,
) -> Avatar:
    to_body, _ = rest_axes(rest.rig, known, file)
    points = np.concatenate([piece.vertices for piece in pieces]) @ to_body.T
    tall = float(np.ptp(points[:, 1]))
    if not tall > 1e-6:
        raise FormatError("it has no height", file=file, field="meshes")
    scale = 1.0 if _TALL[0] <= tall <= _TALL[1] else _HEIGHT / tall
    pelvis = to_body @ rest.rig.rest_positions[known["pelvis"]]
    shift = np.array([pelvis[0], float(points[:, 1].min()), pelvis[2]])

    def place(values: F64) -> F64:
        return (values @ to_body.T - shift) * scale

    joints, transforms = _skeleton(rest, known, to_body, place(rest.rig.rest_positions))
    owner = _owners(rest, known)
    area = sum(_area(place(piece.vertices), piece.triangles) for piece in pieces)
    size = scale * tall / _HEIGHT
    apart = float(np.clip(np.sqrt(area / count), _FINEST * size, _COARSEST * size))
    stream = random_stream(0, "glb person")
    found: list[tuple[F64, ...]] = []
    for piece in pieces:
        vertices = place(piece.vertices)
        sheet = spread_points(
            vertices, piece.triangles, np.full(len(piece.triangles), apart), stream
        )
        colour, opacity = textures.paint(piece, sheet)
        sheet, colour = sheet.select(opacity >= _SEEN), colour[opacity >= _SEEN]
        if not len(sheet.triangle):
            continue
        assert sheet.cell is not None
        normal = sheet.blend(smooth_normals(vertices, piece.triangles), piece.triangles)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        along, wide = disc_axes(normal, sheet.cell)
        dense = np.zeros((len(vertices), JOINT_COUNT))
        for joint, ours in enumerate(owner):
            dense[:, ours] += piece.weights[:, joint]
        found.append((
            sheet.blend(vertices, piece.triangles), normal, along, wide, colour,
            sheet.blend(dense, piece.triangles),
        ))  # fmt: skip
    if not found:
        raise FormatError("all of it is transparent", file=file, field="materials")
    bound, normal, along, wide, colour, dense = (
        np.concatenate(column) for column in zip(*found, strict=True)
    )
    weights = pack_weights(dense, 4)
    back = blended_turns(weights, transforms).transpose(0, 2, 1)
    axes = np.stack([along, np.cross(normal, along), normal], axis=2)
    return Avatar(
        name=file.stem,
        points=unskin_points(bound, weights, transforms).astype(np.float32),
        normals=np.einsum("nab,nb->na", back, normal).astype(np.float32),
        quats=quaternion_from_rotation(back @ axes).astype(np.float32),
        scales=np.column_stack([wide, np.full(len(wide), THICKNESS)]).astype(np.float32),
        opacities=np.full(len(bound), 0.995, np.float32),
        albedo=colour.astype(np.float32),
        part=np.full(len(bound), PARTS.index("person"), np.int32),
        weights=weights,
        joints=joints,
        betas=np.zeros(0),
        record={"scaled": f"{scale:.3g}"} if scale != 1.0 else {},
        source=file.name,
        licence="unknown",
    )


def _skeleton(rest: GltfRest, known: JointMap, to_body: F64, place: F64) -> tuple[F64, F64]:
    """Our joints in T-pose with the bones of a rig [55, 3] m, and what takes them to its rest.

    `place` [J, 3]: its joints at rest, in the body's frame.
    """
    ours = load_body().joints
    turns = rest_offsets(rest.rig, known, ours, to_body, bone_ends(known))
    size = float(np.linalg.norm(place[known["left_knee"]] - place[known["left_hip"]]))
    size /= float(np.linalg.norm(ours[INDEX["left_knee"]] - ours[INDEX["left_hip"]]))
    turned = np.empty((JOINT_COUNT, 3, 3))
    there, joints = np.empty((JOINT_COUNT, 3)), np.empty((JOINT_COUNT, 3))
    for k, parent in enumerate(PARENTS):
        if k in known.joint:
            turned[k], there[k] = turns.get(k, np.eye(3)), place[known.joint[k]]
        else:
            turned[k] = turned[parent]
            there[k] = there[parent] + size * turned[parent] @ (ours[k] - ours[parent])
        joints[k] = (
            there[k] if parent < 0
            else joints[parent] + turned[parent].T @ (there[k] - there[parent])
        )  # fmt: skip
    moved = there - np.einsum("kab,kb->ka", turned, joints)
    lowest = joints[[INDEX["left_foot"], INDEX["right_foot"]], 1].min()
    if not hip_height_of(joints) > 0 or not np.isfinite(lowest):
        raise FormatError("its hips lie below its feet", file=rest.source.file, field="skins")
    return joints, np.concatenate([turned, moved[:, :, None]], axis=2)


def _owners(rest: GltfRest, known: JointMap) -> list[int]:
    """Which joint of ours carries what each joint of a rig carries [J]."""
    ours = {rig: number for number, rig in known.joint.items()}
    owners = []
    for joint in range(len(rest.rig.names)):
        at = joint
        while at >= 0 and at not in ours:
            at = rest.rig.parents[at]
        owners.append(ours.get(at, INDEX["pelvis"]))
    return owners


def _pieces(figure: _Figure, rest: GltfRest) -> Iterator[_Piece]:
    """All triangles that joints carry."""
    joint_of = {node: k for k, node in enumerate(rest.nodes)}
    for number, node in enumerate(figure.nodes):
        if node.mesh is None:
            continue
        if not 0 <= node.mesh < len(figure.meshes):
            raise rest.source.refuse(f"there is no mesh {node.mesh}", None, field="nodes.mesh")
        hangs, matrix = number, np.eye(4)
        while node.skin is None and hangs not in joint_of and hangs in rest.above:
            matrix, hangs = rest.locals[hangs] @ matrix, rest.above[hangs]
        if node.skin is None and hangs not in joint_of:
            continue  # a lamp, a floor
        for primitive in figure.meshes[node.mesh].primitives:
            if primitive.mode != 4 or "POSITION" not in primitive.attributes:
                continue
            vertices = _rows(rest, primitive.attributes["POSITION"], (3,), "POSITION")
            if node.skin is None:
                joint = joint_of[hangs]
                whole = rest.frames[joint] @ matrix
                weights = np.zeros((len(vertices), len(rest.nodes)))
                weights[:, joint] = 1.0
                bound = vertices @ whole[:3, :3].T + whole[:3, 3]
            else:
                bound, weights = _bind(primitive, vertices, node.skin, joint_of, rest)
            yield _finish(figure, primitive, bound, weights, rest)


def _bind(
    primitive: _Primitive, vertices: F64, skin: int, joint_of: dict[int, int], rest: GltfRest
) -> tuple[F64, F64]:
    """Vertices [V, 3] in the scene as they were bound, and their weights [V, J]."""
    if not 0 <= skin < len(rest.skins):
        raise rest.source.refuse(f"there is no skin {skin}", None, field="nodes.skin")
    if not {"JOINTS_0", "WEIGHTS_0"} <= primitive.attributes.keys():
        raise rest.source.refuse("a skinned mesh has no weights", None, field="JOINTS_0")
    nodes, inverse_at = rest.skins[skin]
    index = _rows(rest, primitive.attributes["JOINTS_0"], (4,), "JOINTS_0").astype(np.int64)
    share = _rows(rest, primitive.attributes["WEIGHTS_0"], (4,), "WEIGHTS_0")
    if len(index) != len(vertices) or len(share) != len(vertices) or not share.size:
        raise rest.source.refuse("weights and vertices differ in number", None, field="WEIGHTS_0")
    if index.max() >= len(nodes) or not (share.sum(axis=1) > 0).all() or share.min() < 0:
        raise rest.source.refuse(
            "a vertex hangs on no joint of its skin", None, field="JOINTS_0, WEIGHTS_0"
        )
    inverse = np.tile(np.eye(4), (len(nodes), 1, 1))
    if inverse_at is not None:
        rows = _rows(rest, inverse_at, (16,), "inverseBindMatrices")[: len(nodes)]
        if len(rows) < len(nodes):
            raise rest.source.refuse("matrices are missing", None, field="inverseBindMatrices")
        inverse = np.swapaxes(rows.reshape(-1, 4, 4), 1, 2)
    if not set(nodes) <= joint_of.keys():
        raise rest.source.refuse(
            "its skins hang on several skeletons", None, field="skins",
            remedy="export one person alone",
        )  # fmt: skip
    number = np.array([joint_of[node] for node in nodes])
    taken = rest.frames[number] @ inverse
    share = share / share.sum(axis=1, keepdims=True)
    moved = np.einsum("nk,nkab->nab", share, taken[index])
    bound = np.einsum("nab,nb->na", moved[:, :3, :3], vertices) + moved[:, :3, 3]
    weights = np.zeros((len(vertices), len(rest.nodes)))
    np.add.at(weights, (np.arange(len(vertices))[:, None], number[index]), share)
    return bound, weights


def _finish(
    figure: _Figure, primitive: _Primitive, bound: F64, weights: F64, rest: GltfRest
) -> _Piece:
    count = len(bound)
    if primitive.indices is None:
        corners = np.arange(count // 3 * 3)
    else:
        corners = _rows(rest, primitive.indices, (1,), "indices")[:, 0].astype(np.int64)
    if len(corners) % 3 or (len(corners) and corners.max() >= count):
        raise rest.source.refuse("corners of triangles are not there", None, field="indices")
    if not np.isfinite(bound).all():
        raise rest.source.refuse("vertices are not finite", None, field="POSITION")
    material = _Material()
    if primitive.material is not None:
        if not 0 <= primitive.material < len(figure.materials):
            raise rest.source.refuse(
                f"there is no material {primitive.material}", None, field="material"
            )
        material = figure.materials[primitive.material]
    texture = material.pbrMetallicRoughness.baseColorTexture
    uv, name = np.zeros((count, 2)), f"TEXCOORD_{texture.texCoord if texture else 0}"
    if texture is not None and name in primitive.attributes:
        uv = _fraction(rest, primitive.attributes[name], (2,), name)
    colours = np.ones((count, 4))
    if "COLOR_0" in primitive.attributes:
        given = _fraction(rest, primitive.attributes["COLOR_0"], (3, 4), "COLOR_0")
        colours[:, : given.shape[1]] = given
    if len(uv) != count or len(colours) != count:
        raise rest.source.refuse("attributes and vertices differ in number", None, field=name)
    return _Piece(bound, corners.reshape(-1, 3), weights, uv, colours, material)


def _rows(rest: GltfRest, number: int, widths: tuple[int, ...], name: str) -> F64:
    found = find_rows(rest.document, rest.buffers, number, widths, name, rest.source)
    if found.count > _ROWS_MOST:
        raise rest.source.refuse(f"{found.count} rows are not read", None, field=name)
    values = np.asarray(found.read(0, found.count), np.float64)
    if not np.isfinite(values).all():
        raise rest.source.refuse("not all of it is finite", None, field=name)
    return values


def _fraction(rest: GltfRest, number: int, widths: tuple[int, ...], name: str) -> F64:
    """Rows that may be stored as whole numbers of 0 to 1."""
    values = _rows(rest, number, widths, name)
    most = {5121: 255.0, 5123: 65_535.0}.get(rest.document.accessors[number].componentType)
    return values / most if most and values.max(initial=0.0) > 1.0 else values


def _area(vertices: F64, triangles: NDArray[np.int64]) -> float:
    p = vertices[triangles]
    across = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return float(np.linalg.norm(across, axis=1).sum() / 2)


class _Textures:
    """Pictures of a file, each opened when it is first painted with."""

    def __init__(self, figure: _Figure, rest: GltfRest) -> None:
        self.figure, self.rest = figure, rest
        self._known: dict[int, F64] = {}

    def paint(self, piece: _Piece, at: SheetPoints) -> tuple[F64, F64]:
        """Linear albedo [N, 3] and opacity [N] of places on a piece."""
        surface = piece.material.pbrMetallicRoughness
        factor = np.ones(4)
        given = surface.baseColorFactor[:4]
        factor[: len(given)] = given
        colour = at.blend(piece.colours, piece.triangles) * factor
        if surface.baseColorTexture is not None:
            picture = self._open(surface.baseColorTexture.index)
            colour *= _look_up(picture, at.blend(piece.uv, piece.triangles))
        opacity = colour[:, 3] if piece.material.alphaMode != "OPAQUE" else np.ones(len(colour))
        return np.clip(colour[:, :3], 0.0, 1.0), opacity

    def _open(self, texture: int) -> F64:
        """Linear colours and opacity [H, W, 4] of a texture."""
        figure, rest = self.figure, self.rest
        source = figure.textures[texture].source if 0 <= texture < len(figure.textures) else None
        if source is None or not 0 <= source < len(figure.images):
            raise rest.source.refuse(f"texture {texture} has no picture", None, field="textures")
        if source not in self._known:
            data = self._bytes(figure.images[source], source)
            try:
                with Image.open(io.BytesIO(data)) as picture:
                    if picture.width * picture.height > _PIXELS_MOST:
                        raise rest.source.refuse(
                            f"picture {source} is too large", None, field="images"
                        )
                    pixels = np.asarray(picture.convert("RGBA"), np.float32) / 255.0
            except (OSError, ValueError, Image.DecompressionBombError) as error:
                raise rest.source.refuse(
                    f"picture {source} cannot be read: {error}", None, field="images"
                ) from None
            pixels[..., :3] = decode_srgb(pixels[..., :3])
            self._known[source] = pixels.astype(np.float64)
        return self._known[source]

    def _bytes(self, image: _Image, number: int) -> bytes:
        rest = self.rest
        if image.bufferView is not None:
            views = rest.document.bufferViews
            if not 0 <= image.bufferView < len(views):
                raise rest.source.refuse(f"picture {number} is not there", None, field="images")
            view = views[image.bufferView]
            if not 0 <= view.buffer < len(rest.buffers):
                raise rest.source.refuse(f"there is no buffer {view.buffer}", None, field="images")
            return bytes(rest.buffers[view.buffer].read(view.byteOffset, view.byteLength))
        uri = image.uri or ""
        if uri[:5].lower() == "data:":
            head, _, body = uri.partition(",")
            try:
                return binascii.a2b_base64(body) if ";base64" in head.lower() else b""
            except binascii.Error:
                return b""
        if not uri or "://" in uri:
            raise rest.source.refuse(
                f"picture {number} is a web address, or nowhere", None, field="images.uri",
                remedy="put it beside the file, and its file name there",
            )  # fmt: skip
        return read_bytes(safe_join(rest.source.file.parent, unquote(uri)), _FILE_MOST)


def _look_up(picture: F64, uv: F64) -> F64:
    """Pixels [N, 4] at texture coordinates [N, 2], blended between neighbours; it repeats."""
    height, width = picture.shape[:2]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    u, v = (x - i)[:, None], (y - j)[:, None]
    rows, columns = (j % height, (j + 1) % height), (i % width, (i + 1) % width)
    top = picture[rows[0], columns[0]] * (1 - u) + picture[rows[0], columns[1]] * u
    low = picture[rows[1], columns[0]] * (1 - u) + picture[rows[1], columns[1]] * u
    blended: F64 = top * (1 - v) + low * v
    return blended
