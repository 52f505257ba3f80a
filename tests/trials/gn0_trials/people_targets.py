"""Fuzz targets of what people come from: garments, banks, and the people of episode files."""

from __future__ import annotations

import io
import shutil
import tempfile
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq

from gn0.avatars.avatar import Avatar
from gn0.avatars.bank import AvatarBank, digest_avatar, load_avatar, save_avatar
from gn0.avatars.makehuman.hm08 import VERTEX_COUNT
from gn0.avatars.makehuman.mhclo import Cloth, load_mhclo
from gn0.avatars.skinning import SkinWeights
from gn0.missions.episode import Episode
from gn0.missions.episode_files import load_episodes, save_episodes
from gn0.missions.people import check_people_of, decode_people, encode_people
from gn0.people.person import EpisodePerson, PersonStop
from gn0.people.walk import walk_alone
from gn0.scenes import build_example_scene
from gn0_trials.follow_suite_small import STANDER, WALKER, follow_episode, goal_episode
from gn0_trials.fuzz import FuzzTarget
from gn0_trials.splat_targets import repair_zip

_HEAD = (
    "basemesh hm08\nname thing\nuuid 1-2-3\nobj_file thing.obj\nmax_pole 8\nz_depth 40\n"
    "x_scale 5399 11998 1.4\ny_scale 791 881 2.4\nz_scale 962 5320 2.0\n"
)
_ROWS = (
    "verts 0\nmaterial thing.mhmat\n"
    "10 11 12 0.5 0.25 0.25 0.1 0.2 0.3\n7\n9 9 9 1 0 0 0 0 0\n20 21 22 1.2 -0.1 -0.1 0 0 -0.01\n"
)
_HIDES = "delete_verts\n5 - 9 100 - 120\n400 402\n"
_MESH = (
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0.5\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    "g cloth\nf 1/1 2/2 4/3 3/4\nf 1 2 3\n"
)


def check_cloth(cloth: Cloth) -> None:
    """Raise unless a garment is sound."""
    binding, count = cloth.binding, len(cloth.binding.refs)
    for values in (binding.shares, binding.offsets, binding.units, cloth.uv):
        assert np.isfinite(values).all()
    assert count and (binding.units > 0).all()
    for vertices in (binding.refs, binding.lengths, cloth.covers):
        assert not vertices.size or 0 <= vertices.min() <= vertices.max() < VERTEX_COUNT
    assert not cloth.faces.size or 0 <= cloth.faces.min() <= cloth.faces.max() < count


def mhclo_target() -> FuzzTarget:
    """Garments of MakeHuman: the .mhclo."""
    corpus = {"plain": (_HEAD + _ROWS).encode(), "hides": (_HEAD + _ROWS + _HIDES).encode()}
    return FuzzTarget(
        "mhclo", load_mhclo, corpus, check_cloth,
        (b"verts", b"delete_verts", b"basemesh", b"obj_file", b"z_depth", b"x_scale", b"-",
         b"19157", b"19158", b"0 - 19157", b"../x"),
        ".mhclo", {"thing.obj": _MESH.encode()},
    )  # fmt: skip


def mhclo_mesh_target() -> FuzzTarget:
    """Garments of MakeHuman: the mesh beside a sound .mhclo."""

    def read(path: Path) -> Cloth:
        home = path.with_name("home")
        home.mkdir(exist_ok=True)
        (home / "thing.mhclo").write_text(_HEAD + _ROWS)
        (home / "thing.obj").write_bytes(path.read_bytes())
        return load_mhclo(home / "thing.mhclo")

    return FuzzTarget(
        "mhclo-mesh", read, {"plain": _MESH.encode()}, check_cloth,
        (b"v ", b"vt ", b"f ", b"f 1/1/1 2//2 3", b"f -1 -2 -3", b"g", b"o", b"usemtl"), ".obj",
    )  # fmt: skip


def small_avatar(count: int = 24) -> Avatar:
    """A person of few splats at random places: sound, and nobody to look at."""
    rng = np.random.default_rng(7)
    quats = rng.normal(size=(count, 4))
    joints = rng.uniform(-0.5, 1.5, (55, 3))
    return Avatar(
        name="tiny",
        points=rng.uniform(-0.5, 1.5, (count, 3)).astype(np.float32),
        normals=np.tile(np.array([0, 0, 1], np.float32), (count, 1)),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(0.005, 0.02, (count, 3)).astype(np.float32),
        opacities=rng.uniform(0.5, 1, count).astype(np.float32),
        albedo=rng.uniform(0, 1, (count, 3)).astype(np.float32),
        part=np.ones(count, np.int32),
        weights=SkinWeights(
            rng.integers(0, 55, (count, 4)).astype(np.uint8), np.full((count, 4), 0.25)
        ),
        joints=joints,
        betas=np.zeros(10),
        shape_space="gn0",
        record={"sex": "woman", "top": "tee_slim"},
        source="gn0",
        licence="CC0-1.0",
    )


def check_avatar(avatar: Avatar) -> None:
    """Raise unless an avatar is sound."""
    floats = (
        avatar.points, avatar.normals, avatar.quats, avatar.scales, avatar.opacities, avatar.albedo,
        avatar.weights.weight, avatar.joints, avatar.betas,
    )  # fmt: skip
    assert all(np.isfinite(values).all() for values in floats)
    assert (avatar.weights.joint <= 54).all() and len(avatar.points) == len(avatar.part)
    assert (avatar.scales > 0).all()


def avatar_target() -> FuzzTarget:
    """Avatars of a bank: NAME.npz."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.npz"
        save_avatar(path, small_avatar())
        packed = path.read_bytes()
    plain = io.BytesIO()  # not compressed, so that mutants reach the arrays
    with np.load(io.BytesIO(packed), allow_pickle=False) as arrays:
        np.savez(plain, **arrays)

    def finish(data: bytes, rng: np.random.Generator) -> bytes:
        return repair_zip(data) if rng.random() < 0.8 else data

    return FuzzTarget(
        "avatar", load_avatar, {"packed": packed, "plain": plain.getvalue()}, check_avatar,
        (b"'|O'", b"'<f8'", b"(24, 3)", b"'|S9'"), ".npz", finish=finish,
    )  # fmt: skip


def bank_target() -> FuzzTarget:
    """Banks of people: bank.json, with one avatar beside it."""
    with tempfile.TemporaryDirectory() as folder:
        avatar = save_avatar(Path(folder) / "p0000.npz", small_avatar())
        data = (Path(folder) / "p0000.npz").read_bytes()
    entry = {
        "name": "p0000", "splats": len(avatar.points), "digest": digest_avatar(avatar),
        "record": avatar.record,
    }  # fmt: skip
    made: dict[str, int | float | str] = {"seed": 1, "count": 1, "density": 0.5, "gn0": "0.1.0"}
    listed = {"layout": 1, "made": made, "avatars": [entry], "hash": "ab" * 16}

    def read(path: Path) -> AvatarBank:
        home = path.with_name("bank")
        home.mkdir(exist_ok=True)
        shutil.copyfile(path, home / "bank.json")
        bank = AvatarBank(home)
        for name in bank.names[:3]:
            bank.load(name)
        return bank

    def check(bank: AvatarBank) -> None:
        assert all(isinstance(name, str) for name in bank.names)
        assert isinstance(bank.content_hash, str)

    return FuzzTarget(
        "bank", read, {"one": msgspec.json.encode(listed)}, check,
        (b'"layout":', b'"avatars":', b'"name":', b'"digest":', b'"../p"', b'"p0000"', b"[]", b"{}",
         b"null", b"1e999"),
        ".json", {"bank/p0000.npz": data},
    )  # fmt: skip


_PEOPLE = (
    WALKER,
    msgspec.structs.replace(STANDER, path=((5.0, 3.5),)),
    EpisodePerson(
        number=1, identity="drawn:0:3:top_colour:4", path=((3.4, 2.5), (1.3, 2.5), (1.3, 1.0)),
        speed=0.8, after="back", seed=5,
        stops=(PersonStop(at=0.0, seconds=1.0), PersonStop(at=1.0, seconds=2.0, look=60.0)),
    ),
    EpisodePerson(
        number=2, identity="p0007", path=((4.0, 1.0),), behaviour="sit", yaw=1.0, seat=0.4,
        o_space=(4.0, 1.5, 0.6), bank="ab" * 16,
    ),
)  # fmt: skip


def people_target() -> FuzzTarget:
    """People of an episode, as the column `people` has them; who is read is walked."""
    corpus = {
        "all": encode_people(_PEOPLE).encode(),
        **{str(k): encode_people((person,)).encode() for k, person in enumerate(_PEOPLE)},
    }

    def read(path: Path) -> tuple[EpisodePerson, ...]:
        people = decode_people(path.read_bytes().decode("utf-8", "replace"))
        check_people_of(people, (50.0, 50.0), 0.25, "episode 'e'")
        for person in people:
            if person.behaviour == "script":
                walk_alone(person, 1.0)
        return people

    def check(people: tuple[EpisodePerson, ...]) -> None:
        assert decode_people(encode_people(people)) == people
        for person in people:
            walk = walk_alone(person, 1.0)
            assert np.isfinite(walk.place).all() and np.isfinite(walk.yaw).all()

    return FuzzTarget(
        "people", read, corpus, check,
        (b'"number":', b'"path":', b'"stops":', b'"speed":', b'"behaviour":', b'"sit"', b'"stand"',
         b'"loop"', b'"back"', b'"o_space":', b'"identity":', b'"drawn:0:1"', b"[[1,2],[1,2]]",
         b"null", b"[]", b"{}", b"1e999", b"1e-300", b"-0.0"),
        ".json",
    )  # fmt: skip


def episodes_target() -> FuzzTarget:
    """Episode files with people and missions to follow, uncompressed so that mutants reach both."""
    scene = build_example_scene(spacing=0.2)
    following = follow_episode(STANDER, actions="1120")
    sets = {
        "follow": [following],
        "goal": [goal_episode(*_PEOPLE[:2])],
    }
    corpus = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, episodes in sets.items():
            path = Path(folder) / f"{name}.parquet"
            save_episodes(path, episodes, {scene.id: scene.grid})
            stream = io.BytesIO()
            pq.write_table(pq.read_table(path), stream, compression="none", use_dictionary=False)
            corpus[name] = stream.getvalue()

    def check(episodes: list[Episode]) -> None:
        for episode in episodes:
            assert decode_people(encode_people(episode.people)) == episode.people

    return FuzzTarget(
        "episodes-people", load_episodes, corpus, check,
        (b"PAR1", b'"number":', b'"path":', b'"person":', b'"level":', b'"actions":', b"follow",
         b"people"),
        ".parquet",
    )  # fmt: skip
