"""People posed by the process that draws for several workers: keys are sent, not splats."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gn0.avatars import AvatarBank
from gn0.data.step_people import StepCompany
from gn0.errors import ConfigError, DataError, EpisodeError, FormatError, RenderError, StorageError
from gn0.geometry import Pose2D, view_from_pose
from gn0.people.person import EpisodePerson
from gn0.people.poser import PeoplePoser, PosedThere
from gn0.render import Camera
from gn0.render.open import open_renderer
from gn0.render.renderer import DrawnScene
from gn0.render.share import connection
from gn0.render.share.client import RendererShared
from gn0.render.share.connection import DrawConnection
from gn0.render.share.messages import Draw
from gn0.render.share.parts import PartRows, Posed
from gn0.render.share.request import Connection, Request
from gn0.render.share.server import Server, open_listener
from gn0.scenes import build_example_scene
from gn0.sim.people_eyes import PeopleEyes
from gn0_trials.people_samples import save_bank

FLAT = build_example_scene()
CAMERA = Camera.from_hfov(48, 36, 90)
EYE = Pose2D(2.0, 2.5, 0.0)
STEPS = 6


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_bank(tmp_path_factory.mktemp("bank"))


PEOPLE = (
    EpisodePerson(number=4, identity="p0000", path=((3.2, 3.0),), behaviour="stand"),
    EpisodePerson(number=2, identity="p0001", path=((3.6, 1.8), (3.6, 2.6)), speed=1.0),
)


def walk(step: int) -> StepCompany:
    """One stands, one walks across."""
    x, y = 3.6, 1.8 + 0.1 * step
    real = np.array(
        [
            [3.2, 3.0, -1, 0, 0, -1, 0, 0, 3.2, 3.0],
            [x, y, 0, 1, 0.1 * step, 0, 1, 1.0, x, y - 0.1],
        ]
    )
    return StepCompany(PEOPLE, real, np.array([[0, 2 * step, 8], [1, 10, 8]], np.int32))


def see(drawn: DrawnScene, eyes: PeopleEyes, rounds: int = 1) -> list[bytes]:
    """The pictures of some steps, all of a call; the last round counts."""
    view = view_from_pose(EYE.x, EYE.y, 1.2, EYE.yaw)
    for _ in range(rounds):
        parts = eyes.show_many([eyes.want(walk(k), EYE, CAMERA.fx) for k in range(STEPS)])
        found = drawn.render(CAMERA, np.stack([view] * STEPS), parts=parts)
    assert found.rgb is not None and found.depth is not None
    return [rgb.tobytes() + d.tobytes() for rgb, d in zip(found.rgb, found.depth, strict=True)]


class Serving:
    """A server in threads of this process."""

    def __init__(self, renderer: Any, *, poses: bool = True) -> None:
        poser = PeoplePoser(renderer) if poses else None
        self.server = Server(renderer, lambda source: FLAT.gaussians, poser=poser)
        self.listener, self.address = open_listener()
        for work in (lambda: self.server.listen(self.listener), self.server.serve):
            threading.Thread(target=work, daemon=True).start()

    def open(self) -> DrawnScene:
        shared = RendererShared(DrawConnection(self.address), self.server._batch.name)
        return shared.add_source("flat", {})


@pytest.fixture
def serving() -> Iterator[Serving]:
    made = Serving(open_renderer("cpu"))
    yield made
    made.listener.close()


@pytest.fixture(scope="module")
def alone(bank: Path) -> list[bytes]:
    """What is drawn without such a process."""
    renderer = open_renderer("cpu")
    renderer.keep("flat", FLAT.gaussians)
    drawn = DrawnScene(renderer, "flat")
    seen = see(drawn, PeopleEyes(FLAT, drawn, bank))
    assert len(set(seen)) == STEPS
    return seen


def test_workers_see_the_bytes_that_they_would_draw_and_send_no_splats(
    bank: Path, serving: Serving, alone: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[msgspec.Struct] = []
    send = connection.send_message
    monkeypatch.setattr(
        connection, "send_message", lambda s, m, *f: (sent.append(m), send(s, m, *f))
    )
    found: dict[int, list[bytes]] = {}

    def work(number: int) -> None:
        drawn = serving.open()
        eyes = PeopleEyes(FLAT, drawn, bank)
        assert isinstance(eyes.posed, PosedThere)
        found[number] = see(drawn, eyes, 3)

    workers = [threading.Thread(target=work, args=(number,)) for number in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert found == {0: alone, 1: alone}
    kinds = [type(message).__name__ for message in sent]
    assert "Cloud" not in kinds and kinds.count("Player") == 4  # once a worker and person
    draws = [len(msgspec.msgpack.encode(message)) for message in sent if hasattr(message, "views")]
    assert max(draws) < STEPS * (128 + 2 * 300)  # views, and of each person pose, gain and key


def test_who_is_who_is_told_of_people_who_are_posed_there(bank: Path, serving: Serving) -> None:
    renderer = open_renderer("cpu")
    renderer.keep("flat", FLAT.gaussians)
    view = view_from_pose(EYE.x, EYE.y, 1.2, EYE.yaw)
    told = []
    for drawn in (DrawnScene(renderer, "flat"), serving.open()):
        eyes = PeopleEyes(FLAT, drawn, bank)
        parts = eyes.show_many([eyes.want(walk(k), EYE, CAMERA.fx) for k in range(STEPS)])
        told.append(drawn.render_who(CAMERA, np.stack([view] * STEPS), parts))
    assert isinstance(eyes.posed, PosedThere)
    assert (told[0].numbers == told[1].numbers).all() and told[0].seen == told[1].seen
    assert any(seen.box is not None for row in told[0].seen for seen in row)


@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_on_a_device_they_are_posed_there_as_by_whoever_has_it(bank: Path) -> None:
    """Not as clouds that are packed anew: both are posed by the same kernel, to the byte."""
    from gn0.device.host import DeviceHost
    from gn0.render.cuda.batch import RendererBatch

    own = RendererBatch(DeviceHost())
    own.keep("flat", FLAT.gaussians)
    drawn = DrawnScene(own, "flat")
    wanted = see(drawn, PeopleEyes(FLAT, drawn, bank))
    there = Serving(RendererBatch(DeviceHost()))
    asked = there.open()
    assert see(asked, PeopleEyes(FLAT, asked, bank), 2) == wanted
    there.listener.close()


def test_who_cannot_be_posed_there_is_sent_as_before(bank: Path, alone: list[bytes]) -> None:
    old = Serving(open_renderer("cpu"), poses=False)
    drawn = old.open()
    assert see(drawn, PeopleEyes(FLAT, drawn, bank)) == alone
    name = drawn.renderer.name_posed({}, ("walk", 0))  # type: ignore[attr-defined]
    with pytest.raises(RenderError, match="nobody poses people here"):
        render_one(drawn, name)
    old.listener.close()


def render_one(drawn: DrawnScene, name: str) -> None:
    from gn0.render.instance import Instance

    view = view_from_pose(EYE.x, EYE.y, 1.2, 0.0)
    drawn.render(CAMERA, view, parts=[Instance(name, np.eye(4))])


def test_another_bank_or_none_there_is_named(bank: Path, serving: Serving, tmp_path: Path) -> None:
    """The bank is opened over there, by its folder and hash; who was refused may go on."""
    copy = tmp_path / "copy"
    shutil.copytree(bank, copy)
    drawn = serving.open()
    eyes = PeopleEyes(FLAT, drawn, copy)
    listed = json.loads((copy / "bank.json").read_text())
    (copy / "bank.json").write_text(json.dumps({**listed, "hash": "another"}))
    with pytest.raises(EpisodeError, match=f"is of bank {listed['hash']}, this is another") as told:
        see(drawn, eyes)
    assert told.value.where == str(copy) and "bank" in told.value.remedy
    shutil.rmtree(copy)
    with pytest.raises(StorageError, match="there is no such bank of people") as gone:
        see(drawn, eyes)
    assert gone.value.where == str(copy)
    good = PeopleEyes(FLAT, drawn, bank)
    assert len(see(drawn, good)) == STEPS
    other = eyes.cast.find("p0000")
    whom = {"identity": "p0000", "avatar": "0" * 32, "bank": str(bank)}
    whom["hash"] = AvatarBank(bank).content_hash
    how = ("idle", 0, "", 0, 4, 0, 2, 0.0, 0)
    name_posed = drawn.renderer.name_posed  # type: ignore[attr-defined]
    with pytest.raises(EpisodeError, match=f"its avatar is {other.digest}"):
        render_one(drawn, name_posed(whom, how))
    with pytest.raises(FormatError, match="is nobody"):
        render_one(drawn, name_posed({"who": 1}, how))
    whom["avatar"] = other.digest
    for wrong in (how[:3], (*how[:8], 9), ("no such clip", *how[1:])):
        with pytest.raises((DataError, FormatError), match=r"pose|level|clip"):
            render_one(drawn, name_posed(whom, wrong))


def test_drawn_people_need_no_bank(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    from gn0.avatars.person import build_person
    from gn0.people import cast

    def of_few_splats(who: Any) -> Any:
        return build_person(who, density=0.03)

    monkeypatch.setattr(cast, "build_person", of_few_splats)
    poser = serving.server._poser
    assert poser is not None
    actor = cast.Cast().find("drawn:1:0")
    whom = {"identity": "drawn:1:0", "avatar": actor.digest}
    poser.prepare(whom)
    with pytest.raises(EpisodeError):
        poser.prepare({**whom, "identity": "drawn:1:x"})


DRAW = Draw(
    1, "flat", {}, CAMERA, b"", ("rgb",), None, 1,
    parts=PartRows((), b"", b"", b"", b"", (Posed(1, ("a",)), Posed(1, ("b",)))),
)  # fmt: skip


def test_requests_are_cut_where_their_people_do_not_fit_into_a_call(
    bank: Path, serving: Serving, alone: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    poser = serving.server._poser
    assert poser is not None
    poser.at_once = 3
    calls: list[int] = []
    pose = poser.pose
    monkeypatch.setattr(poser, "pose", lambda wanted: (calls.append(len(wanted)), pose(wanted))[1])
    drawn = serving.open()
    eyes = PeopleEyes(FLAT, drawn, bank)
    assert see(drawn, eyes) == alone and calls == [10]  # never within one
    requests = [Request(Connection(None), sent) for sent in [DRAW] * 3]  # type: ignore[arg-type]
    assert [len(some) for some in serving.server._cut(requests)] == [1, 1, 1]
    poser.at_once = 4
    assert [len(some) for some in serving.server._cut(requests)] == [2, 1]
    poser._posed.budget = 1000  # type: ignore[attr-defined]
    poser._posed._held.clear()  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match="need more than 1,000 bytes"):
        see(drawn, eyes)


def test_a_person_of_whom_nobody_told_is_refused(serving: Serving) -> None:
    drawn = serving.open()
    renderer = drawn.renderer
    assert isinstance(renderer, RendererShared)
    renderer._posed["x"] = Posed(7, ("walk", 0))
    with pytest.raises(RenderError, match="of whom nobody told"):
        render_one(drawn, "x")
