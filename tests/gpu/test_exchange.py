"""Pictures on the device are tensors of other libraries without a copy."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cuda.renderer import RendererCuda
from gn0.testing.renderer_check import random_cloud


@pytest.fixture(scope="module")
def pictures(device):
    renderer = RendererCuda(random_cloud(200, seed=1), device=device)
    views = np.stack([view_from_pose(-3, 0, 0, 0.1 * k) for k in range(2)])
    return renderer.render_device(Camera.from_hfov(24, 18, 90), views)


def test_numpy(device, pictures) -> None:
    result = pictures.numpy()
    assert result.rgb.shape == (2, 18, 24, 3)
    assert result.rgb.any()
    if device.kind == "host":
        assert (np.from_dlpack(pictures.depth) == result.depth).all()


@pytest.mark.filterwarnings("ignore")
def test_torch(card, pictures) -> None:
    torch = pytest.importorskip("torch")
    result = pictures.numpy()
    for name in ("rgb", "depth", "alpha"):
        array = getattr(pictures, name)
        tensor = torch.from_dlpack(array)
        assert tensor.is_cuda
        assert tensor.data_ptr() == array.pointer
        assert (tensor.cpu().numpy() == getattr(result, name)).all()
        seen = torch.as_tensor(array, device="cuda")  # __cuda_array_interface__
        assert seen.data_ptr() == array.pointer
    tensor = torch.from_dlpack(pictures.rgb)
    assert int(tensor.long().sum()) == int(result.rgb.astype(np.int64).sum())


@pytest.mark.filterwarnings("ignore")
def test_cupy(card, pictures) -> None:
    cupy = pytest.importorskip("cupy")
    result = pictures.numpy()
    assert (cupy.asnumpy(cupy.from_dlpack(pictures.depth)) == result.depth).all()
    assert (cupy.asnumpy(cupy.asarray(pictures.rgb)) == result.rgb).all()
