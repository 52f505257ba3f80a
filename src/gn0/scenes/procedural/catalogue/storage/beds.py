"""Beds with their pillows, blankets and headboards."""

from __future__ import annotations

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.seats.legs import build_legs
from gn0.scenes.procedural.catalogue.seats.sofas import leaning
from gn0.scenes.procedural.palette import LINEN, Palette, plain
from gn0.scenes.procedural.shapes import Shape, build_box, build_rod
from gn0.scenes.procedural.shapes_soft import build_cushion, build_drape


def build_bed(rng: np.random.Generator, palette: Palette, double: bool = True) -> Item:
    """A bed with headboard, mattress, duvet, pillows and often a throw; head towards +y."""
    w = float(rng.choice([1.4, 1.6, 1.8])) if double else float(rng.choice([0.9, 1.0]))
    long = 2.0
    frame_w, frame_l = w + 0.08, long + 0.1
    wood = palette.wood(rng, 0)
    upholstered = rng.random() < 0.45
    cloth = palette.cloth(rng)
    frame = cloth if upholstered else wood
    shapes: list[Shape] = []
    z0 = 0.2
    bevel = 0.02 if upholstered else 0.006
    for sx in (-1, 1):
        shapes.append(
            build_box(
                (0.04, frame_l - 0.02, 0.16),
                frame,
                at=(sx * (frame_w / 2 - 0.02), 0, z0 - 0.04),
                bevel=bevel,
                round_steps=2,
            )
        )
    shapes.append(
        build_box(
            (frame_w, 0.04, 0.16),
            frame,
            at=(0, -frame_l / 2 + 0.02, z0 - 0.04),
            bevel=bevel,
            round_steps=2,
        )
    )
    head = float(rng.uniform(0.92, 1.15))
    back = frame_l / 2
    if upholstered:
        shapes.append(
            build_box(
                (frame_w + 0.06, 0.1, head),
                frame,
                bevel=0.04,
                round_steps=2,
                inner=2,
                puff=0.01,
                at=(0, back, 0),
            )
        )
        if rng.random() < 0.5:
            n = max(2, int(frame_w / 0.28))
            for k in range(n):
                x = -frame_w / 2 + (k + 0.5) * frame_w / n
                shapes.append(
                    build_box(
                        (frame_w / n - 0.012, 0.06, head - 0.5),
                        frame,
                        bevel=0.028,
                        round_steps=2,
                        inner=1,
                        puff=0.012,
                        at=(x, back - 0.05, 0.45),
                    )
                )
    elif rng.random() < 0.5:
        shapes.append(
            build_box(
                (frame_w, 0.04, head - 0.24), wood, bevel=0.012, round_steps=2, at=(0, back, 0.2)
            )
        )
        shapes += [
            build_box((0.06, 0.06, head), wood, bevel=0.01, at=(sx * (frame_w / 2 - 0.03), back, 0))
            for sx in (-1, 1)
        ]
    else:
        shapes += [
            build_rod(
                (sx * (frame_w / 2 - 0.03), back, 0),
                (sx * (frame_w / 2 - 0.03), back, head),
                0.026,
                wood,
                sides=10,
            )
            for sx in (-1, 1)
        ]
        shapes += [
            build_box((frame_w - 0.06, 0.026, 0.09), wood, bevel=0.008, at=(0, back, z))
            for z in (head - 0.12, head - 0.32, head - 0.52)
        ]
    shapes += build_legs(frame_w - 0.16, frame_l - 0.16, z0, wood, radius=0.03)
    sheet = LINEN
    shapes.append(
        build_box(
            (w, long, 0.2),
            sheet,
            bevel=0.05,
            round_steps=2,
            inner=1,
            puff=0.006,
            at=(0, 0, z0 + 0.04),
        )
    )
    top = z0 + 0.24
    duvet_colour = (
        palette.bright(rng, "linen")
        if rng.random() < 0.65
        else plain(
            "duvet",
            "linen",
            str(rng.choice(["#eeeae2", "#dfe2e2", "#cdd3d6", "#e6dccb"])),
            contrast=0.2,
            scale=0.01,
        )
    )
    fold = long * 0.68
    duvet = build_drape(
        w + 0.02,
        fold,
        (0.24, 0.24, 0.06, 0.0),
        duvet_colour,
        rng,
        ripple=0.025,
        lift=0.035,
        step=0.06,
    )
    shapes.append(duvet.moved(0, -long / 2 + fold / 2 + 0.01, top + 0.05))
    lip = build_box((w + 0.1, 0.34, 0.06), sheet, bevel=0.028, round_steps=2, inner=2, puff=0.008)
    shapes.append(lip.moved(0, -long / 2 + fold - 0.1, top + 0.045))
    parts: list[Placed] = []
    count = 2 if double else 1
    for k in range(count):
        x = (k - (count - 1) / 2) * w * 0.48
        case = plain(
            "pillow case",
            "linen",
            str(rng.choice(["#f2efe8", "#e6e8e8", "#ece5d8"])),
            contrast=0.2,
            scale=0.01,
        )
        pillow = Item("pillow", (build_cushion(0.66, 0.44, 0.19, case, pinch=0.06),))
        parts.append(
            Placed(
                leaning(pillow, 0.28),
                x,
                long / 2 - 0.3,
                top - 0.01,
                float(rng.uniform(-0.05, 0.05)),
            )
        )
        if rng.random() < 0.6:
            extra = Item(
                "cushion",
                (
                    build_cushion(
                        0.44,
                        0.42,
                        0.15,
                        palette.bright(rng, str(rng.choice(["fabric", "knit"]))),
                        pinch=0.1,
                    ),
                ),
            )
            parts.append(
                Placed(
                    leaning(extra, 1.0),
                    x * 0.8,
                    long / 2 - 0.56,
                    top + 0.01,
                    float(rng.uniform(-0.2, 0.2)),
                )
            )
    if rng.random() < 0.65:
        throw = build_drape(
            w + 0.09,
            0.55,
            (0.3, 0.3, 0.0, 0.0),
            palette.bright(rng, "knit"),
            rng,
            ripple=0.03,
            lift=0.04,
        )
        parts.append(
            Placed(
                Item("blanket", (throw,)),
                0,
                -long / 2 + 0.42,
                top + 0.085,
                float(rng.uniform(-0.04, 0.04)),
            )
        )
    return Item("bed", tuple(shapes), (), tuple(parts))
