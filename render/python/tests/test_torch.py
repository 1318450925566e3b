"""Scenes as functions of tensors, where PyTorch is present."""

import subprocess
import sys

import numpy as np
import pytest

import render_gradients as rg

WALL, BALL = "left.reflectance.value", "sphere.alpha.value"


def test_torch_is_imported_on_use_only() -> None:
    code = "import sys, render_gradients; sys.exit('torch' in sys.modules or 'matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_gradients_flow_back_with_seeds_of_their_own(room: rg.Scene) -> None:
    torch = pytest.importorskip("torch")
    from render_gradients import torch as rgt

    wall = torch.tensor([0.3, 0.4, 0.5], requires_grad=True)
    ball = torch.tensor([0.3], dtype=torch.float64, requires_grad=True)
    fixed = torch.tensor([9.0, 8.0, 7.0])
    image = rgt.render(room, {WALL: wall, BALL: ball, "light.emitter.radiance.value": fixed}, spp=4, seed=5)
    np.testing.assert_array_equal(image.detach().numpy(), room.render(spp=4, seed=10))
    assert room["light.emitter.radiance.value"][0] == 9.0
    loss = (image**2).mean()
    # What happens to the scene in between does not matter.
    room[WALL] = 0.9
    loss.backward()
    np.testing.assert_allclose(room[WALL], [0.3, 0.4, 0.5])
    value, adjoint = rg.loss(image.detach().numpy(), np.zeros((*room.size, 3)))
    assert float(loss) == pytest.approx(value, rel=1e-5)
    expected = room.backward(adjoint, [WALL, BALL], spp=4, seed=11)
    np.testing.assert_allclose(wall.grad.numpy(), expected[WALL], rtol=1e-4)
    np.testing.assert_allclose(ball.grad.numpy(), expected[BALL].reshape(1), rtol=1e-4)
    assert ball.grad.dtype == torch.float64 and fixed.grad is None
    with pytest.raises(ValueError, match="params"):
        rgt.render(room, {})
