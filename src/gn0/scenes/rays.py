"""Rays against triangles: our own bounding volume hierarchy, the same bytes for any thread count.

A binned surface-area-heuristic tree (Wald 2007) over single-precision boxes, and the watertight
ray–triangle test of Woop, Benthin and Wald (JCGT 2013) in double precision, so that a ray never
slips through a shared edge.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.geometry import F32
from gn0.jit import njit, prange
from gn0.scenes.mesh import SceneMesh

STACK = 96  # deeper than any tree that the builder makes
_BINS = 16
_LEAF = 4
_CHUNK = 128  # rays a work item: one stack each


class RayCaster:
    """Nearest hits and occlusion on a mesh; both sides of a triangle count.

    Args:
        mesh: the surfaces; degenerate triangles are never hit.

    Attributes:
        boxes: [M, 6] float32 lower and upper corner of each node's box [m].
        links: [M, 3] int32 (right child or −1, first triangle, triangle count); the left child
            of node i is i + 1.
        corners: [F, 9] float32 triangle corners in tree order [m].
        order: [F] int32 face index of each triangle in tree order.
    """

    def __init__(self, mesh: SceneMesh) -> None:
        corners = np.ascontiguousarray(mesh.corners(), np.float32).reshape(-1, 9)
        if not len(corners):
            raise SceneError("the mesh has no faces to cast rays at", remedy="add surfaces")
        if not np.isfinite(corners).all():
            raise SceneError("the mesh has vertices that are not finite", remedy="drop them")
        triangles = corners.reshape(-1, 3, 3)
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        lower = np.minimum(np.minimum(a, b), c)
        upper = np.maximum(np.maximum(a, b), c)
        boxes, links, order, used = _build_tree(lower, upper)
        self.boxes = np.ascontiguousarray(boxes[:used])
        self.links = np.ascontiguousarray(links[:used])
        self.order = order
        self.corners = np.ascontiguousarray(corners[order])

    def cast(
        self,
        origins: NDArray[np.floating],
        directions: NDArray[np.floating],
        t_max: NDArray[np.floating] | float | None = None,
    ) -> tuple[NDArray[np.int32], F32, F32]:
        """Nearest hit of each ray.

        Args:
            origins: ray origins [N, 3] m.
            directions: ray directions [N, 3], of any length but zero.
            t_max: hits beyond are ignored, in units of the direction's length; [N] or one number.

        Returns:
            face [N] (−1 for a miss), t [N] in units of the direction's length (+inf for a miss),
            and (u, v) [N, 2]: the weights of the face's second and third corner.
        """
        origin, direction, limit = _ray_arrays(origins, directions, t_max)
        return _cast_rays(
            self.boxes, self.links, self.order, self.corners, origin, direction, limit
        )

    def occluded(
        self,
        origins: NDArray[np.floating],
        directions: NDArray[np.floating],
        t_max: NDArray[np.floating] | float | None = None,
    ) -> NDArray[np.bool_]:
        """Whether anything lies between each origin and `t_max` along its direction [N]."""
        origin, direction, limit = _ray_arrays(origins, directions, t_max)
        return _occlude_rays(self.boxes, self.links, self.corners, origin, direction, limit)


_known: WeakKeyDictionary[SceneMesh, RayCaster] = WeakKeyDictionary()


def caster_of(mesh: SceneMesh) -> RayCaster:
    """The ray caster of a mesh, built once for as long as somebody holds the mesh.

    Raises:
        SceneError: the mesh has no faces, or vertices that are not finite.
    """
    found = _known.get(mesh)
    if found is None:
        found = _known[mesh] = RayCaster(mesh)
    return found


def _ray_arrays(
    origins: NDArray[np.floating],
    directions: NDArray[np.floating],
    t_max: NDArray[np.floating] | float | None,
) -> tuple[F32, F32, F32]:
    origin = np.ascontiguousarray(origins, np.float32).reshape(-1, 3)
    direction = np.ascontiguousarray(directions, np.float32).reshape(-1, 3)
    limit = np.full(len(origin), np.inf, np.float32)
    if t_max is not None:
        limit[:] = t_max
    return origin, direction, limit


@njit
def _half_area(lo, hi):  # type: ignore[no-untyped-def]
    dx, dy, dz = hi[0] - lo[0], hi[1] - lo[1], hi[2] - lo[2]
    return dx * dy + dy * dz + dz * dx


@njit
def _build_tree(lower, upper):  # type: ignore[no-untyped-def]
    """Binned SAH tree in depth-first order, built without recursion."""
    n = len(lower)
    order = np.arange(n).astype(np.int32)
    centre = (lower + upper) * np.float32(0.5)
    boxes = np.empty((2 * n, 6), np.float32)
    links = np.empty((2 * n, 3), np.int32)
    stack = np.empty((STACK + 4, 4), np.int64)  # first, count, parent to patch, depth
    stack[0] = (0, n, -1, 0)
    top, used = 1, 0
    bin_lo = np.empty((_BINS, 3), np.float32)
    bin_hi = np.empty((_BINS, 3), np.float32)
    bin_n = np.empty(_BINS, np.int64)
    right_cost = np.empty(_BINS, np.float64)
    lo = np.empty(3, np.float32)
    hi = np.empty(3, np.float32)
    clo = np.empty(3, np.float32)
    chi = np.empty(3, np.float32)
    while top > 0:
        top -= 1
        first, count, parent, depth = stack[top]
        node = used
        used += 1
        if parent >= 0:
            links[parent, 0] = node
        lo[:], hi[:], clo[:], chi[:] = np.inf, -np.inf, np.inf, -np.inf
        for i in range(first, first + count):
            f = order[i]
            for k in range(3):
                lo[k], hi[k] = min(lo[k], lower[f, k]), max(hi[k], upper[f, k])
                clo[k], chi[k] = min(clo[k], centre[f, k]), max(chi[k], centre[f, k])
        for k in range(3):  # by a loop: assigning arrays takes seconds to compile
            boxes[node, k], boxes[node, 3 + k] = lo[k], hi[k]
        links[node] = (-1, first, count)
        if count <= _LEAF:
            continue
        best, best_axis, best_bin = np.inf, -1, 0
        for axis in range(3):
            extent = chi[axis] - clo[axis]
            if extent <= 0.0:
                continue
            scale = _BINS * (1.0 - 1e-6) / extent
            bin_n[:] = 0
            bin_lo[:], bin_hi[:] = np.inf, -np.inf
            for i in range(first, first + count):
                f = order[i]
                b = min(_BINS - 1, int((centre[f, axis] - clo[axis]) * scale))
                bin_n[b] += 1
                for k in range(3):
                    bin_lo[b, k] = min(bin_lo[b, k], lower[f, k])
                    bin_hi[b, k] = max(bin_hi[b, k], upper[f, k])
            lo[:], hi[:] = np.inf, -np.inf
            total = 0
            for b in range(_BINS - 1, 0, -1):
                total += bin_n[b]
                for k in range(3):
                    lo[k], hi[k] = min(lo[k], bin_lo[b, k]), max(hi[k], bin_hi[b, k])
                right_cost[b] = total * _half_area(lo, hi) if total else 0.0
            lo[:], hi[:] = np.inf, -np.inf
            total = 0
            for b in range(_BINS - 1):
                total += bin_n[b]
                for k in range(3):
                    lo[k], hi[k] = min(lo[k], bin_lo[b, k]), max(hi[k], bin_hi[b, k])
                if total == 0 or total == count:
                    continue
                cost = total * _half_area(lo, hi) + right_cost[b + 1]
                if cost < best:
                    best, best_axis, best_bin = cost, axis, b
        middle = first
        # past a sane depth only halving keeps the traversal stack bounded
        if best_axis >= 0 and depth < STACK - 40:
            scale = _BINS * (1.0 - 1e-6) / (chi[best_axis] - clo[best_axis])
            i, j = first, first + count - 1
            while i <= j:
                f = order[i]
                b = min(_BINS - 1, int((centre[f, best_axis] - clo[best_axis]) * scale))
                if b <= best_bin:
                    i += 1
                else:
                    order[i], order[j] = order[j], f
                    j -= 1
            middle = i
        if middle == first or middle == first + count:
            middle = first + count // 2
        stack[top] = (middle, first + count - middle, node, depth + 1)
        stack[top + 1] = (first, middle - first, -1, depth + 1)
        top += 2
    return boxes, links, order, used


@njit(error_model="numpy")
def closest_hit(boxes, links, corners, ox, oy, oz, dx, dy, dz, t_max, any_hit, stack):  # type: ignore[no-untyped-def]
    """Nearest triangle of one ray: (index in tree order or −1, t, u, v).

    With `any_hit` the first triangle found will do. `stack` is scratch [STACK] int32.
    """
    # the largest axis becomes z: shear and scale constants of the watertight test
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax > ay and ax > az:
        kz, ozz, dzz, dxx, dyy = 0, ox, dx, dy, dz
        oxx, oyy = oy, oz
    elif ay > az:
        kz, ozz, dzz, dxx, dyy = 1, oy, dy, dz, dx
        oxx, oyy = oz, ox
    else:
        kz, ozz, dzz, dxx, dyy = 2, oz, dz, dx, dy
        oxx, oyy = ox, oy
    best, t_best, u_best, v_best = -1, t_max, 0.0, 0.0
    if dzz == 0.0 or dzz != dzz:
        return best, t_best, u_best, v_best
    sx, sy, sz = dxx / dzz, dyy / dzz, 1.0 / dzz
    i0 = (kz + 1) % 3
    i1 = (kz + 2) % 3
    tiny = 1e-30
    ix = 1.0 / (dx if ax > tiny else (tiny if dx >= 0 else -tiny))
    iy = 1.0 / (dy if ay > tiny else (tiny if dy >= 0 else -tiny))
    iz = 1.0 / (dz if az > tiny else (tiny if dz >= 0 else -tiny))
    top, node = 0, 0
    while True:
        if links[node, 0] < 0:
            first = links[node, 1]
            for i in range(first, first + links[node, 2]):
                a_z = corners[i, kz] - ozz
                b_z = corners[i, 3 + kz] - ozz
                c_z = corners[i, 6 + kz] - ozz
                a_x = corners[i, i0] - oxx - sx * a_z
                a_y = corners[i, i1] - oyy - sy * a_z
                b_x = corners[i, 3 + i0] - oxx - sx * b_z
                b_y = corners[i, 3 + i1] - oyy - sy * b_z
                c_x = corners[i, 6 + i0] - oxx - sx * c_z
                c_y = corners[i, 6 + i1] - oyy - sy * c_z
                u = c_x * b_y - c_y * b_x
                v = a_x * c_y - a_y * c_x
                w = b_x * a_y - b_y * a_x
                if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
                    continue
                det = u + v + w
                if det == 0.0:
                    continue
                t = sz * (u * a_z + v * b_z + w * c_z) / det
                if t > 0.0 and t < t_best:
                    best, t_best, u_best, v_best = i, t, v / det, w / det
                    if any_hit:
                        return best, t_best, u_best, v_best
            if top == 0:
                break
            top -= 1
            node = stack[top]
            continue
        left, right = node + 1, links[node, 0]
        x0, x1 = (boxes[left, 0] - ox) * ix, (boxes[left, 3] - ox) * ix
        y0, y1 = (boxes[left, 1] - oy) * iy, (boxes[left, 4] - oy) * iy
        z0, z1 = (boxes[left, 2] - oz) * iz, (boxes[left, 5] - oz) * iz
        near_l = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), 0.0))
        far_l = min(min(max(x0, x1), max(y0, y1)), min(max(z0, z1), t_best)) * 1.0000004
        x0, x1 = (boxes[right, 0] - ox) * ix, (boxes[right, 3] - ox) * ix
        y0, y1 = (boxes[right, 1] - oy) * iy, (boxes[right, 4] - oy) * iy
        z0, z1 = (boxes[right, 2] - oz) * iz, (boxes[right, 5] - oz) * iz
        near_r = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), 0.0))
        far_r = min(min(max(x0, x1), max(y0, y1)), min(max(z0, z1), t_best)) * 1.0000004
        hit_l, hit_r = near_l <= far_l, near_r <= far_r
        if hit_l and hit_r:
            if near_l <= near_r:
                node, stack[top] = left, right
            else:
                node, stack[top] = right, left
            top += 1
        elif hit_l:
            node = left
        elif hit_r:
            node = right
        elif top > 0:
            top -= 1
            node = stack[top]
        else:
            break
    return best, t_best, u_best, v_best


@njit(parallel=True, error_model="numpy")
def _cast_rays(boxes, links, order, corners, origin, direction, limit):  # type: ignore[no-untyped-def]
    n = len(origin)
    face = np.full(n, -1, np.int32)
    t = np.full(n, np.inf, np.float32)
    uv = np.zeros((n, 2), np.float32)
    for chunk in prange((n + _CHUNK - 1) // _CHUNK):
        stack = np.empty(STACK, np.int32)
        for r in range(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK)):
            best, tb, u, v = closest_hit(
                boxes, links, corners,
                float(origin[r, 0]), float(origin[r, 1]), float(origin[r, 2]),
                float(direction[r, 0]), float(direction[r, 1]), float(direction[r, 2]),
                float(limit[r]), np.bool_(False), stack,
            )  # fmt: skip
            if best >= 0:
                face[r] = order[best]
                t[r] = tb
                uv[r, 0] = u
                uv[r, 1] = v
    return face, t, uv


@njit(parallel=True, error_model="numpy")
def _occlude_rays(boxes, links, corners, origin, direction, limit):  # type: ignore[no-untyped-def]
    n = len(origin)
    hit = np.zeros(n, np.bool_)
    for chunk in prange((n + _CHUNK - 1) // _CHUNK):
        stack = np.empty(STACK, np.int32)
        for r in range(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK)):
            best, _, _, _ = closest_hit(
                boxes, links, corners,
                float(origin[r, 0]), float(origin[r, 1]), float(origin[r, 2]),
                float(direction[r, 0]), float(direction[r, 1]), float(direction[r, 2]),
                float(limit[r]), np.bool_(True), stack,
            )  # fmt: skip
            hit[r] = best >= 0
    return hit
