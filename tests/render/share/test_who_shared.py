"""Who is who by the drawing process: what its renderer says, for as many views as are asked."""

from __future__ import annotations

import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceError, DeviceMemoryError, RenderError
from gn0.geometry import view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.host import RendererHost
from gn0.render.instance import Instance
from gn0.render.open import open_renderer
from gn0.render.share.client import VIEWS, RendererShared
from gn0.render.share.connection import DrawConnection
from gn0.render.share.messages import Draw, Drawn, DrawnBy
from gn0.render.share.server import Server, open_listener
from gn0.render.who import WhoPictures
from gn0.scenes.parts import build_ball
from gn0.testing.renderer_check import random_cloud

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="Unix sockets"),
    pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++"),
]
CAMERA = Camera.from_hfov(48, 36, 90.0)
SCENES = {f"scene {n}": random_cloud(60, seed=n, sh_degree=0) for n in (1, 2)}
BALL = build_ball(0.3, spacing=0.03)


def stand(x: float, y: float = 0.0) -> Instance:
    pose = np.eye(4)
    pose[:3, 3] = x, y, 0.5
    return Instance("ball", pose)


def looks(count: int) -> np.ndarray:
    return np.stack([view_from_pose(-2.0, 0.1 * k, 0.5, 0.02 * k, 0.0) for k in range(count)])


# one behind the other, side by side, alone, nobody, and one whom no view shows
PARTS = [(stand(0.0), stand(1.0, 0.1)), (stand(0.5, -0.6), stand(0.5, 0.7)), (stand(0.3),), (),
         (stand(-9.0),)]  # fmt: skip


class Cramped(RendererHost):
    """As the CPU's, with memory for so many views a call."""

    def __init__(self, limit: int) -> None:
        super().__init__("cpu", open_renderer("cpu")._build)  # type: ignore[attr-defined]
        self.limit, self.calls = limit, []  # type: ignore[var-annotated]

    def render_who(self, camera: Camera, views: Any, *args: Any, **more: Any) -> WhoPictures:
        self.calls.append(len(views))
        if len(views) > self.limit:
            raise DeviceMemoryError("not so much")
        return super().render_who(camera, views, *args, **more)


@pytest.fixture
def share() -> Iterator[Callable[[Any], RendererShared]]:
    """A shared renderer in front of one, drawn for by threads of this process."""
    made: list[Any] = []

    def start(renderer: Any) -> RendererShared:
        server = Server(renderer, lambda source: SCENES[source["key"]])
        listener, address = open_listener()
        for work in (lambda: server.listen(listener), server.serve):
            threading.Thread(target=work, daemon=True).start()
        made.extend((listener, connection := DrawConnection(address)))
        shared = RendererShared(connection, "cpu")
        for key in SCENES:
            shared.add_source(key, {"key": key})
        shared.name_cloud("ball", BALL)
        return shared

    yield start
    for each in made:
        each.close()


def alone(renderer: Any) -> Any:
    for key, cloud in SCENES.items():
        renderer.keep(key, cloud)
    renderer.name_cloud("ball", BALL)
    return renderer


def expect_same(one: WhoPictures, other: WhoPictures) -> None:
    assert one.numbers.dtype == np.uint32
    np.testing.assert_array_equal(one.numbers, other.numbers)
    assert one.seen == other.seen
    assert {type(seen.share) for row in one.seen for seen in row} <= {float}


@pytest.mark.parametrize("drawn_by", ["cpu", "cuda"])
def test_it_says_what_its_renderer_says(share, drawn_by: str) -> None:
    opened = RendererBatch(DeviceHost()) if drawn_by == "cuda" else open_renderer("cpu")
    shared, own = share(opened), alone(open_renderer("cpu"))
    assert shared._connection.drawn_by.tells
    views, parts = looks(5), PARTS
    keys = ["scene 1", "scene 1", "scene 2", "scene 2", "scene 1"]
    found = shared.render_who(CAMERA, views, keys, parts=parts)
    expect_same(found, own.render_who(CAMERA, views, keys, parts=parts))
    (front, back), *_, (unseen,) = found.seen
    assert front.box is not None and front.share > 0.5 > back.share
    assert unseen.box is None and not found.numbers[3:].any()
    once = shared.add_source("scene 1", {"key": "scene 1"}).render_who(CAMERA, views[0], [PARTS[0]])
    assert once.seen == found.seen[:1]
    picture = shared.render(CAMERA, views[0], "scene 1", parts=[PARTS[0]])  # goes on as before
    expected = alone(opened).render(CAMERA, views[0], "scene 1", parts=[PARTS[0]])
    assert (picture.rgb == expected.rgb).all()


def test_many_views_go_in_several_requests_and_smaller_calls(share) -> None:
    cramped, count = Cramped(5), VIEWS + 8
    shared, own = share(cramped), alone(open_renderer("cpu"))
    parts = (PARTS * count)[:count]
    found = shared.render_who(CAMERA, looks(count), "scene 1", parts=parts)
    expect_same(found, own.render_who(CAMERA, looks(count), "scene 1", parts=parts))
    assert max(cramped.calls[:1]) == VIEWS and cramped.calls[-1] <= 5
    none = shared.render_who(CAMERA, looks(1)[:0], "scene 1", parts=())
    assert none.numbers.shape == (0, 36, 48) and none.seen == []


def test_it_is_of_the_whole_scene_where_pictures_are_of_visible_sets(share) -> None:
    shared, own = share(open_renderer("cpu")), alone(open_renderer("cpu"))
    floor = OccupancyGrid(np.full((40, 40), 1, np.uint8), 0.1, (-2.5, -2.0))
    for renderer in (shared, own):
        renderer.limit_to_visible("scene 1", SCENES["scene 1"].content_hash, floor, 0.5)
    found = shared.render_who(CAMERA, looks(5), "scene 1", parts=PARTS, visible=True)
    expect_same(found, own.render_who(CAMERA, looks(5), "scene 1", parts=PARTS, visible=True))


def test_one_that_cannot_tell_and_what_makes_no_sense_are_named(share) -> None:
    class Plain:
        def __init__(self) -> None:
            self._renderer = open_renderer("cpu")

        def __getattr__(self, name: str) -> Any:
            if name == "render_who":
                raise AttributeError(name)
            return getattr(self._renderer, name)

    shared = share(Plain())
    assert not shared._connection.drawn_by.tells
    with pytest.raises(RenderError, match="cannot tell who is who") as raised:
        shared.render_who(CAMERA, looks(1), "scene 1", parts=[PARTS[0]])
    assert raised.value.remedy == "use backend 'cpu' or 'cuda'"
    shared = share(open_renderer("cpu"))
    with pytest.raises(RenderError, match="no scene 'scene 3'"):
        shared.render_who(CAMERA, looks(1), "scene 3", parts=[PARTS[0]])
    with pytest.raises(RenderError, match="2 keys for 1 views"):
        shared.render_who(CAMERA, looks(1), ["scene 1", "scene 2"], parts=[PARTS[0]])
    connection = shared._connection
    odd = Draw(
        1, "scene 1", {"key": "scene 1"}, CAMERA, looks(1).tobytes(), ("rgb",), None, 0, who=True
    )
    with pytest.raises(RenderError, match="without pictures"):
        connection._ask(connection._prepare(odd, None, None)[0])
    assert shared.render_who(CAMERA, looks(1), "scene 1", parts=[PARTS[2]]).seen[0]


def test_messages_of_before_say_that_nobody_is_told_of() -> None:
    """What is new has defaults: a message without it means what it meant."""
    old = {"type": "drawn by", "name": "cpu", "labels": True, "poses": False}
    assert not msgspec.convert(old, DrawnBy).tells
    assert msgspec.convert({"type": "drawn", "number": 3}, Drawn).seen == ()


def test_an_answer_that_is_no_picture_is_refused_alike_by_both_questions(
    share, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection = share(open_renderer("cpu"))._connection
    asked = ("scene 1", {"key": "scene 1"}, CAMERA, looks(1))
    for answer in (DrawnBy("somebody"), Drawn(1)):  # the second one saw no view
        monkeypatch.setattr(connection, "_ask", lambda _, answer=answer: answer)
        with pytest.raises(DeviceError, match=f"unexpected answer: {type(answer).__name__}"):
            connection.tell_who(*asked, None)
    monkeypatch.setattr(connection, "_ask", lambda _: DrawnBy("somebody"))
    with pytest.raises(DeviceError, match="unexpected answer: DrawnBy"):
        connection.draw(*asked, ("rgb",), None)
