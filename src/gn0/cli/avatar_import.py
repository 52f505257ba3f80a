"""Bring a person: splats of the T-pose, as LHM writes them, or a `.glb` with a humanoid skin.

Triangles of a `.glb` become splats, its textures albedo, its joints ours. Beside splats lies a
`binding.npz`. It says which of the 55 joints carry each splat (`weights_idx`, `weights`), and where
the joints are (`joints`, or `betas` and whose they are). docs/avatars.md has the fields.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 avatar import lhm/person.ply --out out/person.npz
  gn0 avatar import person.glb --out out/person.npz
  gn0 avatar import person.glb --in-bank --out out/mine/robot.npz
  gn0 avatar import lhm/person.ply --body SMPLX_NEUTRAL.npz --out out/person.npz"""


class Args(Config, frozen=True):
    """The person, and where the avatar goes.

    Attributes:
        source: splats of a person in T-pose, or a .glb or .gltf with a skin.
        out: the avatar's file.
        in_bank: list the person in bank.json beside --out, by the file's name, so that episodes
            can name it: the folder is a bank of your own people.
        body: a SMPL-X body, where the binding names a shape of it and no joints.
    """

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PERSON")]
    out: str
    in_bank: bool = False
    body: str = ""


def run(args: Args) -> int:
    """Read, write, say what it is."""
    from gn0.avatars.bank import load_avatar, save_avatar
    from gn0.avatars.bank_build import join_bank
    from gn0.avatars.body_file import load_smplx_body
    from gn0.avatars.glb_person import load_glb_person
    from gn0.avatars.splat_person import load_splat_person
    from gn0.errors import ConfigError
    from gn0.storage import check_writable

    if Path(args.out).suffix.lower() != ".npz":
        raise ConfigError(
            f"cannot write {args.out[:80]!r}", where="--out",
            remedy="end it with .npz: by that an avatar's file is known",
        )  # fmt: skip
    check_writable(args.out)
    if Path(args.source).suffix.lower() in (".glb", ".gltf"):
        found = load_glb_person(args.source)
    else:
        body = load_smplx_body(args.body) if args.body else None
        found = load_splat_person(args.source, body=body)
    if args.in_bank:
        listed = join_bank(args.out, found)
        avatar = load_avatar(args.out)
    else:
        listed, avatar = None, save_avatar(args.out, found)
    print(f"{len(avatar):,} splats on a body of {avatar.shape_space}, licence {avatar.licence}")
    print(f"written to {args.out}; look at it: gn0 avatar show {Path(args.out)}")
    if listed is not None:
        named = ", ".join(entry.name for entry in listed.avatars[:6])
        more = " …" if len(listed.avatars) > 6 else ""
        print(f"bank {Path(args.out).parent}: {named}{more}; hash {listed.hash}")
    return 0
