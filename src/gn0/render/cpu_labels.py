"""Which label each pixel shows: the blending loop, kept only for its weights, summed by label.

Same rules and order as `cpu_raster`, without colours. A tile has room for the sums of `slots`
labels. Where it meets more, it is done again in two turns, four, eight, …: in each turn only labels
count whose mixed code falls to that turn. All splats of a label are summed in one turn, in the same
order, so a sum does not depend on how many turns there are, and neither does the winner.
"""

from __future__ import annotations

import numpy as np

from gn0.jit import njit, prange
from gn0.render.cpu_bin import sort_tile
from gn0.render.cpu_raster import BATCH, GATHERED, LOG_MIN, TILE, exponential, gather_batch
from gn0.render.renderer import ALPHA_CAP, TRANSMITTANCE_STOP

F = np.float32
SLOTS = 256  # labels that a tile has room for at a time; a power of two
_CAP, _STOP = F(ALPHA_CAP), F(TRANSMITTANCE_STOP)
_ONE, _ZERO = F(1.0), F(0.0)
_NEVER = np.int32(2**31 - 1)
_PIXELS = TILE * TILE


@njit(inline="always")
def mix_code(code):  # type: ignore[no-untyped-def]
    """Codes in another order: one to one, neighbours far apart."""
    code = np.uint32(code)
    code = np.uint32((code ^ (code >> np.uint32(16))) * np.uint32(0x7FEB352D))
    code = np.uint32((code ^ (code >> np.uint32(15))) * np.uint32(0x846CA68B))
    return np.uint32(code ^ (code >> np.uint32(16)))


@njit(error_model="numpy")
def _sum_row(row, sums, firsts, begin, qx, k0, position):  # type: ignore[no-untyped-def]
    """Blend one splat into a line of a tile, and add its weights to those of its label."""
    for j in range(TILE):
        q = begin + qx * F(j)
        p = k0 - q * q
        e = min(exponential(p), _CAP)
        e = e if p >= LOG_MIN else _ZERO
        T = row[j]
        w = e * T
        after = T - w
        keep = after > _STOP
        w = w if keep else _ZERO
        row[j] = after if keep else _ZERO
        sums[j] += w
        met = position if w > _ZERO else _NEVER
        firsts[j] = min(firsts[j], met)


@njit(error_model="numpy")
def _pass_row(row, begin, qx, k0):  # type: ignore[no-untyped-def]
    """Blend one splat whose label does not count in this turn."""
    for j in range(TILE):
        q = begin + qx * F(j)
        p = k0 - q * q
        e = min(exponential(p), _CAP)
        e = e if p >= LOG_MIN else _ZERO
        T = row[j]
        after = T - e * T
        row[j] = after if after > _STOP else _ZERO


@njit(error_model="numpy")
def _sum_tile(  # type: ignore[no-untyped-def]
    records, indices, rows, x_px, y_px, columns, lines, codes, moving, first_moving, turns, turn,
    through, sums, firsts, known, slot_of,
):  # fmt: skip
    """Sum the weights of the labels of one turn; returns how many there are, −1 for too many.

    `known` gets their codes, `sums` and `firsts` [slots, pixels] their weights and the first splat
    of each that showed; `slot_of` [2 slots] is a hash table of codes.
    """
    slots = known.shape[0]
    for r in range(TILE):
        for j in range(TILE):
            through[r * TILE + j] = _ONE if r < lines and j < columns else _ZERO
    slot_of[:] = -1
    mask = np.uint32(slot_of.shape[0] - 1)
    used, last_code, last_slot = 0, np.uint32(0), -1
    gathered = np.empty(GATHERED, np.float32)
    reach = np.empty(2 * BATCH, np.int32)
    for start in range(0, rows.shape[0], BATCH):
        size = min(BATCH, rows.shape[0] - start)
        gather_batch(records, rows[start : start + size], x_px, y_px, gathered, reach)
        for b in range(size):
            y0, y1 = reach[b], reach[BATCH + b]
            if y0 < y1:
                index = indices[rows[start + b]]
                code = codes[index] if index < first_moving else moving[index - first_moving]
                mixed = mix_code(code)
                slot = -1
                if turns == 1 or mixed % np.uint32(turns) == np.uint32(turn):
                    if last_slot >= 0 and code == last_code:
                        slot = last_slot
                    else:
                        at = (mixed >> np.uint32(9)) & mask
                        while slot_of[at] >= 0 and known[slot_of[at]] != code:
                            at = (at + np.uint32(1)) & mask
                        slot = slot_of[at]
                        if slot < 0:
                            if used == slots:
                                return -1
                            slot = used
                            used += 1
                            slot_of[at] = slot
                            known[slot] = code
                            sums[slot * _PIXELS : (slot + 1) * _PIXELS] = _ZERO
                            firsts[slot * _PIXELS : (slot + 1) * _PIXELS] = _NEVER
                        last_code, last_slot = code, slot
                dx0, dy0 = gathered[b], gathered[BATCH + b]
                qx, qy = gathered[2 * BATCH + b], gathered[3 * BATCH + b]
                qk, log_o = gathered[4 * BATCH + b], gathered[5 * BATCH + b]
                q0 = qx * dx0
                for r in range(y0, y1):
                    dy = dy0 + F(r)
                    begin = q0 + qy * dy
                    k0 = log_o - qk * dy * dy
                    row = through[r * TILE : (r + 1) * TILE]
                    if slot < 0:
                        _pass_row(row, begin, qx, k0)
                    else:
                        place = slot * _PIXELS + r * TILE
                        _sum_row(
                            row, sums[place : place + TILE], firsts[place : place + TILE],
                            begin, qx, k0, np.int32(start + b),
                        )  # fmt: skip
            if b & 15 == 15:
                open_pixels = 0
                for k in range(_PIXELS):
                    open_pixels += through[k] > _ZERO
                if open_pixels == 0:
                    return used
    return used


@njit(parallel=True)
def label_tiles(  # type: ignore[no-untyped-def]
    records, indices, ordered, starts, tile_rows, tile_keys, spare_rows, spare_keys, row_order,
    tiles_x, width, height, is_sorted, codes, moving, first_moving, slots, out,
):  # fmt: skip
    """Fill `out` [H, W] with the code that each pixel shows; 0 where nothing does.

    `codes` are those of the scene's splats, `moving` of what follows from index `first_moving` on.
    `is_sorted`: the lists have been sorted by `raster_tiles`. `slots`: labels of a turn.
    """
    for step in prange(row_order.shape[0] * tiles_x):
        tile_y, tile_x = row_order[step // tiles_x], step % tiles_x
        t = tile_y * tiles_x + tile_x
        x_px, y_px = tile_x * TILE, tile_y * TILE
        columns, lines = min(TILE, width - x_px), min(TILE, height - y_px)
        rows, keys = tile_rows[starts[t] : starts[t + 1]], tile_keys[starts[t] : starts[t + 1]]
        if not is_sorted:
            more_rows = spare_rows[starts[t] : starts[t + 1]]
            more_keys = spare_keys[starts[t] : starts[t + 1]]
            sort_tile(keys, rows, more_keys, more_rows, indices, records, ordered)
        through = np.empty(_PIXELS, np.float32)
        sums = np.empty(slots * _PIXELS, np.float32)
        firsts = np.empty(slots * _PIXELS, np.int32)
        known = np.empty(slots, np.uint32)
        slot_of = np.empty(2 * slots, np.int32)
        best = np.zeros(_PIXELS, np.float32)
        met = np.full(_PIXELS, _NEVER, np.int32)
        shown = np.zeros(_PIXELS, np.uint32)
        turns, turn = np.int64(1), np.int64(0)  # no literals, which are types of their own
        while turn < turns:
            used = _sum_tile(
                records, indices, rows, x_px, y_px, columns, lines, codes, moving, first_moving,
                turns, turn, through, sums, firsts, known, slot_of,
            )  # fmt: skip
            if used < 0:  # too many labels: from the beginning, fewer a turn
                turns, turn = 2 * turns, np.int64(0)
                best[:] = _ZERO
                met[:] = _NEVER
                shown[:] = 0
                continue
            for slot in range(used):
                for k in range(_PIXELS):
                    total, first = sums[slot * _PIXELS + k], firsts[slot * _PIXELS + k]
                    wins = total > best[k] or (total == best[k] and first < met[k])
                    best[k] = total if wins else best[k]
                    met[k] = first if wins else met[k]
                    shown[k] = known[slot] if wins else shown[k]
            turn += 1
        for r in range(lines):
            for j in range(columns):
                out[y_px + r, x_px + j] = shown[r * TILE + j]
