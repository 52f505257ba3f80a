"""Splats moved by joints: into the arrays of a cloud, or into the rows that a renderer keeps.

Centres move by linear blend skinning, orientations by the sign-fixed blend of the joints'
quaternions. Both ways give the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.posture import Posture
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.geometry import F32
from gn0.jit import njit, prange
from gn0.render.cpu_pack import CHUNK, POSED_FIELDS
from gn0.render.cpu_posed import PosedPacked, RestPacked, pack_posed, pack_rest
from gn0.render.renderer import ALPHA_MIN

_ALONE = 16  # chunks that one thread poses before others are awake


@dataclass(frozen=True, eq=False)
class SkinRows:
    """Splats at rest and the joints that carry them.

    Attributes:
        points, normals: centres and unit normals [N, 3] m, body frame; quats (w, x, y, z) [N, 4].
        joint, weight: numbers of joints [N, K] and their shares [N, K].
    """

    points: F32
    normals: F32
    quats: F32
    joint: NDArray[np.uint8]
    weight: F32

    @property
    def arrays(self) -> tuple[NDArray[np.generic], ...]:
        """As kernels take them."""
        return self.points, self.normals, self.quats, self.joint, self.weight


@dataclass(frozen=True, eq=False)
class RestRows:
    """A person at a level of detail as it is posed into packed rows.

    Attributes:
        points, joint, weight: as in `SkinRows`, of splats that can show, in packed order; those on
            the floor are not among them.
        faces: turn and normal of all lanes [C, 7 * CHUNK], lane by lane.
        rest: what no pose changes.
    """

    points: F32
    joint: NDArray[np.uint8]
    weight: F32
    faces: F32
    rest: RestPacked


def pack_skin(skin: SkinRows, cloud: GaussianCloud, lying: int) -> RestRows:
    """Splats at rest in packed order.

    Args:
        skin: of all splats but those on the floor.
        cloud: all of them in some pose, `lying` of them on the floor after all others.
        lying: how many.

    Raises:
        RenderError: an array holds a value that is not finite, or a scale or opacity out of range.
    """
    body = len(skin.points)
    near = morton_order(skin.points)
    near = near[np.argsort(cloud.opacities[near] < np.float32(ALPHA_MIN), kind="stable")]
    # of a chunk those side by side that hang on as many joints: a loop that ends alike is quicker
    many = (skin.weight[near] > 0).sum(axis=1)
    near = near[np.lexsort((skin.joint[near, 0], many, np.arange(body) // CHUNK))]
    rest = pack_rest(cloud, np.concatenate([near, np.arange(body, body + lying)]), lying)
    shown = rest.order[: rest.alive - lying]
    faces = np.zeros((rest.chunks * CHUNK, 7), np.float32)
    faces[: len(shown), :4], faces[: len(shown), 4:] = skin.quats[shown], skin.normals[shown]
    faces[len(shown) : rest.alive, (0, 6)] = 1.0
    lanes = faces.reshape(-1, CHUNK, 7).transpose(0, 2, 1)
    return RestRows(
        points=skin.points[shown],
        joint=skin.joint[shown],
        weight=skin.weight[shown],
        faces=np.ascontiguousarray(lanes).reshape(rest.chunks, -1),
        rest=rest,
    )


def pose_packed(rows: RestRows, posture: Posture, floor: F32) -> PosedPacked:
    """A person in a pose, ready to be drawn.

    Args:
        rows: itself at rest.
        posture: what the pose does to its joints.
        floor: places [m] and opacities of what lies on the floor [lying, 4].
    """
    chunks = rows.rest.chunks
    packed = np.empty((chunks, POSED_FIELDS * CHUNK), np.float32)
    boxes = np.empty((chunks, 7), np.float32)
    wanted = (
        *(rows.points, rows.joint, rows.weight, rows.faces),
        *(posture.transforms, posture.turns, floor, rows.rest.still),
    )
    if chunks <= _ALONE:
        _pose_chunks(0, chunks, *wanted, packed, boxes)
    else:
        _pose_rows(*wanted, packed, boxes)
    return pack_posed(rows.rest, packed, boxes, floor[:, 3])


@njit(parallel=True, error_model="numpy")
def pose_splats(points, normals, quats, joint, weight, world, turns, out, turned, faced):  # type: ignore[no-untyped-def]
    """Write centres, turns and normals of splats that joints carry; see `SkinRows`."""
    for n in prange(points.shape[0]):
        p, q = _blend(n, points, joint, weight, world, turns)
        out[n, 0], out[n, 1], out[n, 2] = p
        q, f = _turn(
            *q, quats[n, 0], quats[n, 1], quats[n, 2], quats[n, 3],
            normals[n, 0], normals[n, 1], normals[n, 2],
        )  # fmt: skip
        turned[n, 0], turned[n, 1], turned[n, 2], turned[n, 3] = q
        faced[n, 0], faced[n, 1], faced[n, 2] = f


@njit(parallel=True, error_model="numpy")
def _pose_rows(points, joint, weight, faces, world, turns, floor, still, rows, boxes):  # type: ignore[no-untyped-def]
    for c in prange(rows.shape[0]):
        _pose_chunks(
            c, c + 1, points, joint, weight, faces, world, turns, floor, still, rows, boxes
        )


@njit(error_model="numpy")
def _pose_chunks(  # type: ignore[no-untyped-def]
    begin, end, points, joint, weight, faces, world, turns, floor, still, rows, boxes
):
    """Pose the splats of chunks into rows; see `gn0.render.cpu_posed.pack_posed`."""
    body = points.shape[0]
    alive = body + floor.shape[0]
    blend = np.empty(4 * CHUNK)
    for c in range(begin, end):
        row, face, box = rows[c], faces[c], boxes[c]
        for k in range(CHUNK):
            n = c * CHUNK + k
            x, y, z = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            q = (1.0, 0.0, 0.0, 0.0)
            if n < body:
                p, q = _blend(n, points, joint, weight, world, turns)
                x, y, z = np.float32(p[0]), np.float32(p[1]), np.float32(p[2])
            elif n < alive:
                x, y, z = floor[n - body, 0], floor[n - body, 1], floor[n - body, 2]
            row[k], row[CHUNK + k], row[2 * CHUNK + k] = x, y, z
            blend[k], blend[CHUNK + k], blend[2 * CHUNK + k], blend[3 * CHUNK + k] = q
        for k in range(CHUNK):
            q, f = _turn(
                blend[k], blend[CHUNK + k], blend[2 * CHUNK + k], blend[3 * CHUNK + k],
                face[k], face[CHUNK + k], face[2 * CHUNK + k], face[3 * CHUNK + k],
                face[4 * CHUNK + k], face[5 * CHUNK + k], face[6 * CHUNK + k],
            )  # fmt: skip
            row[3 * CHUNK + k], row[4 * CHUNK + k] = q[0], q[1]
            row[5 * CHUNK + k], row[6 * CHUNK + k] = q[2], q[3]
            row[7 * CHUNK + k], row[8 * CHUNK + k], row[9 * CHUNK + k] = f
        # what does not show on the floor only makes the box larger
        count = min(CHUNK, alive - c * CHUNK)
        for a in range(3):
            low, high = row[a * CHUNK], row[a * CHUNK]
            for k in range(count):
                low, high = min(low, row[a * CHUNK + k]), max(high, row[a * CHUNK + k])
            box[a], box[3 + a] = low, high
        reach = np.float32(0.0)
        for k in range(count):
            reach = max(reach, still[c, 3 * CHUNK + k])
        box[6] = reach


@njit(error_model="numpy", forceinline=True)
def _blend(n, points, joint, weight, world, turns):  # type: ignore[no-untyped-def]
    """Centre of splat `n` and the blend of what turns it (w, x, y, z), not yet of length 1."""
    first = joint[n, 0]
    r0, r1, r2, r3 = turns[first, 0], turns[first, 1], turns[first, 2], turns[first, 3]
    w = x = y = z = 0.0
    p0 = p1 = p2 = 0.0
    a, b, c = points[n, 0], points[n, 1], points[n, 2]
    for k in range(joint.shape[1]):
        share = weight[n, k]
        if share <= 0.0:
            continue
        j = joint[n, k]
        # no views of rows: references to arrays are counted, and threads wait for each other
        p0 += share * (
            world[j, 0, 0] * a + world[j, 0, 1] * b + world[j, 0, 2] * c + world[j, 0, 3]
        )
        p1 += share * (
            world[j, 1, 0] * a + world[j, 1, 1] * b + world[j, 1, 2] * c + world[j, 1, 3]
        )
        p2 += share * (
            world[j, 2, 0] * a + world[j, 2, 1] * b + world[j, 2, 2] * c + world[j, 2, 3]
        )
        q0, q1, q2, q3 = turns[j, 0], turns[j, 1], turns[j, 2], turns[j, 3]
        # of the two quaternions of a turn, the one on the side of the heaviest joint's
        if q0 * r0 + q1 * r1 + q2 * r2 + q3 * r3 < 0.0:
            share = -share
        w += share * q0
        x += share * q1
        y += share * q2
        z += share * q3
    return (p0, p1, p2), (w, x, y, z)


@njit(error_model="numpy", forceinline=True)
def _turn(w, x, y, z, qw, qx, qy, qz, a, b, c):  # type: ignore[no-untyped-def]
    """A blend, made of length 1, times the quaternion at rest, and the normal (a, b, c) turned."""
    length = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / length, x / length, y / length, z / length
    turned = (
        w * qw - x * qx - y * qy - z * qz,
        w * qx + x * qw + y * qz - z * qy,
        w * qy - x * qz + y * qw + z * qx,
        w * qz + x * qy - y * qx + z * qw,
    )
    # v + 2 q × (q × v + w v)
    e = y * c - z * b + w * a
    f = z * a - x * c + w * b
    g = x * b - y * a + w * c
    faced = (a + 2.0 * (y * g - z * f), b + 2.0 * (z * e - x * g), c + 2.0 * (x * f - y * e))
    return turned, faced
