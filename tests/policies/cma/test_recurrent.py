"""The graphs of CMA and Seq2Seq: shapes, and each part against another way to compute it."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="recurrent baselines need gn0[train]")

from gn0.errors import ConfigError  # noqa: E402
from gn0.policies.cma.cma_checkpoint import build_net  # noqa: E402
from gn0.policies.cma.cma_settings import SIZES, CmaSettings  # noqa: E402
from gn0.policies.cma.recurrent import Attention, Eye, Reader, RecurrentNet, StepGru  # noqa: E402
from gn0.policies.cma.resnet import ResNet18, scale_colours, scale_depth  # noqa: E402
from gn0.sim.ego_map import EgoSquare, MapView  # noqa: E402

VIEW = MapView(squares=(EgoSquare(32, 0.24), EgoSquare(64, 0.1)))


def settings(**chosen) -> CmaSettings:
    own = {"sizes": SIZES["nano"], "vocabulary": 50, "text_length": 9, "view": VIEW}
    return CmaSettings(**({"pictures": ("near", "far")} | own | chosen))


def look_around(net: RecurrentNet, count: int, seed: int = 0) -> list:
    generator = torch.Generator().manual_seed(seed)
    return [
        torch.rand((count, *shape), generator=generator) * 5
        if name == "depth"
        else torch.randint(0, 256, (count, *shape), dtype=torch.uint8, generator=generator)
        for name, shape in net.settings.shapes.items()
    ]


def read(net: RecurrentNet, rows: list[int]):
    ids = torch.randint(0, 50, (2, 9), generator=torch.Generator().manual_seed(1))
    words = net.read(ids, torch.tensor([9, 4]))
    return None if words is None else words.pick(torch.tensor(rows))


@pytest.mark.parametrize(
    "chosen",
    [{}, {"words": False}, {"graph": "seq2seq"}, {"graph": "seq2seq", "words": False},
     {"pictures": ()}, {"pictures": ("rgb", "depth", "near")}],
    ids=["cma", "blind", "seq2seq", "seq2seq blind", "words alone", "three pictures"],
)  # fmt: skip
def test_all_graphs_give_four_actions_a_state_and_keep_a_memory(chosen) -> None:
    net = build_net(settings(**chosen), 0)
    steps, count = 2, 3
    seen = net.see(look_around(net, steps * count))
    assert [one.shape[0::2] for one in seen] == [(6, 16)] * len(net.settings.pictures)
    last = torch.tensor([[-1, 2, 0], [1, -1, 3]])
    logits, progress, memory = net(read(net, [0, 1] * 3), seen, last, net.begin(count))
    assert logits.shape == (steps, count, 4)
    assert progress.shape == (steps, count)
    assert memory.shape == (2 if net.settings.graph == "cma" else 1, count, 32)
    loss = logits.square().sum() + progress.sum()
    torch.autograd.backward(loss)
    without = [n for n, w in net.named_parameters() if w.grad is None]
    assert without == []  # every weight takes part


def test_pictures_that_there_are_not_and_nothing_to_go_by_are_refused() -> None:
    for pictures, said in ((("square_5",), "no picture"), (("near", "near"), "twice")):
        with pytest.raises(ConfigError, match=said):
            settings(pictures=pictures)
    with pytest.raises(ConfigError, match="neither pictures nor words"):
        settings(pictures=(), words=False)


def test_the_encoder_is_resnet18() -> None:
    """As many weights as the well-known one has without its last layer: 11,689,512 - 513,000."""
    net = ResNet18(3, 64)
    assert sum(weight.numel() for weight in net.parameters()) == 11_176_512
    with torch.no_grad():
        assert net(torch.zeros(1, 3, 128, 128)).shape == (1, 512, 4, 4)
        assert net(torch.zeros(1, 3, 160, 96)).shape == (1, 512, 5, 3)


def test_depth_is_told_from_nought_to_one_over_the_sensors_reach() -> None:
    metres = torch.tensor([[[0.0, 2.5], [10.0, 12.0]]])
    assert scale_depth(metres, (0.0, 10.0)).tolist() == [[[[0, 0.25], [1, 1]]]]
    assert scale_depth(metres, (0.5, 2.5)).flatten().tolist() == [0, 1, 1, 1]


def test_a_picture_tells_the_same_whoever_stands_beside_it() -> None:
    """In float64, as batches of other sizes are rounded in other ways."""
    eye = Eye("near", settings()).eval()
    pictures = torch.randint(0, 256, (5, 32, 32, 3), dtype=torch.uint8)
    with torch.no_grad():
        assert eye.summarise(eye(pictures)).shape == (5, SIZES["nano"].colour)
        encode, scaled = eye.net.double(), scale_colours(pictures).double()
        together = encode(scaled)
        alone = torch.cat([encode(scaled[k : k + 1]) for k in range(5)])
    torch.testing.assert_close(together, alone, atol=1e-10, rtol=1e-10)


def test_attention_is_softmax_of_scaled_products() -> None:
    stream = np.random.default_rng(0)
    torch.manual_seed(0)
    attention = Attention(6, 5, 4, 3)
    asked, places = (stream.normal(size=s).astype(np.float32) for s in ((2, 6), (2, 7, 5)))
    there = np.ones((2, 7), bool)
    there[1, 3:] = False
    found = attention(*map(torch.from_numpy, (asked, places, there))).detach().numpy()
    w = {name: weight.detach().numpy().astype(np.float64)
         for name, weight in attention.named_parameters()}  # fmt: skip
    for b in range(2):
        q = w["query.weight"] @ asked[b] + w["query.bias"]
        k = places[b] @ w["key.weight"].T + w["key.bias"]
        v = places[b] @ w["value.weight"].T + w["value.bias"]
        scores = np.exp(k @ q / np.sqrt(4)) * there[b]
        np.testing.assert_allclose(found[b], scores / scores.sum() @ v, atol=1e-5)


def test_texts_are_read_from_both_ends_as_packed_sequences_are() -> None:
    torch.manual_seed(0)
    reader = Reader(20, 6, 5, both=True)
    stock = torch.nn.LSTM(6, 5, batch_first=True, bidirectional=True)
    with torch.no_grad():
        for name, weight in stock.named_parameters():
            own = reader.back if name.endswith("_reverse") else reader.ahead
            weight.copy_(getattr(own, name.removesuffix("_reverse")))
    ids, counts = torch.randint(0, 20, (3, 7)), torch.tensor([7, 1, 4])
    packed = torch.nn.utils.rnn.pack_padded_sequence(
        reader.words(ids), counts, batch_first=True, enforce_sorted=False
    )
    states, (ends, _) = stock(packed)
    wanted, _ = torch.nn.utils.rnn.pad_packed_sequence(states, batch_first=True)
    found = reader(ids, counts)
    torch.testing.assert_close(found.states, wanted)
    torch.testing.assert_close(found.last, torch.cat([*ends], -1))
    assert found.there.sum(1).tolist() == [7, 1, 4]
    other = ids.clone()
    other[1, 1:] = 3  # behind the text
    torch.testing.assert_close(reader(other, counts).states, found.states)


def test_where_an_episode_begins_nothing_is_left_of_the_one_before() -> None:
    torch.manual_seed(0)
    gru = StepGru(5, 4)
    given = torch.randn(6, 2, 5)
    begins = torch.zeros(6, 2, dtype=torch.bool)
    begins[3, 0] = True
    whole, end = gru(given, begins, torch.randn(2, 4))
    fresh, _ = gru(given[3:, :1], begins[3:, :1], torch.zeros(1, 4))
    torch.testing.assert_close(whole[3:, :1], fresh)
    torch.testing.assert_close(whole[-1], end)


@pytest.mark.parametrize("graph", ["cma", "seq2seq"])
def test_stretches_one_after_the_other_are_the_walk(graph) -> None:
    net = build_net(settings(graph=graph), 3).eval()
    steps, count = 6, 2
    pictures = look_around(net, steps * count)
    last = torch.tensor([[-1, 2], [1, 1], [0, -1], [-1, 3], [1, 1], [2, 1]])
    rows = [0, 1, 0, 1, 0, 0, 1, 0, 1, 0, 1, 0]
    with torch.no_grad():
        words, seen = read(net, rows), net.see(pictures)
        whole, told, end = net(words, seen, last, net.begin(count))
        memory, logits, progress = net.begin(count), [], []
        for begin in range(0, steps, 2):
            part = torch.arange(begin * count, (begin + 2) * count)
            said, believed, memory = net(
                words.pick(part), [one[part] for one in seen], last[begin : begin + 2], memory
            )
            logits.append(said)
            progress.append(believed)
    torch.testing.assert_close(torch.cat(logits), whole)
    torch.testing.assert_close(torch.cat(progress), told)
    torch.testing.assert_close(memory, end)


def test_who_is_shown_and_told_something_else_acts_otherwise_but_for_the_blind() -> None:
    for chosen, hears in (({}, True), ({"words": False}, False)):
        net = build_net(settings(**chosen), 0)
        last = torch.tensor([[-1, -1]])
        seen = [torch.cat([one, one]) for one in net.see(look_around(net, 1))]
        logits, _, _ = net(read(net, [0, 1]), seen, last, net.begin(2))
        assert (logits[0, 0] - logits[0, 1]).abs().max().item() > 0 or not hears
        assert torch.equal(logits[0, 0], logits[0, 1]) is not hears
        other = net.see(look_around(net, 1, seed=9))
        changed, _, _ = net(read(net, [0]), other, last[:, :1], net.begin(1))
        assert not torch.equal(changed[0, 0], logits[0, 0])
    dark = build_net(settings(pictures=()), 0)  # without pictures: words and actions alone
    logits, _, _ = dark(read(dark, [0, 1]), [], torch.tensor([[-1, -1]]), dark.begin(2))
    assert not torch.equal(logits[0, 0], logits[0, 1])


def test_the_same_seed_gives_the_same_net() -> None:
    one, two, other = (build_net(settings(), seed).state_dict() for seed in (1, 1, 2))
    assert all(torch.equal(one[name], two[name]) for name in one)
    assert not torch.equal(one["join.weight"], other["join.weight"])
