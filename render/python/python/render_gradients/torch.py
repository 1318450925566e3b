"""Scenes as functions of tensors, for PyTorch, which only this module imports.

    from render_gradients import torch as rgt

    image = rgt.render(scene, {"left.reflectance.value": colour}, spp=16, seed=step)
    loss = ((image - target) ** 2).mean()
    loss.backward()                                          # colour.grad
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch

from ._native import Scene

__all__ = ["render"]


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        scene: Scene,
        keys: tuple[str, ...],
        spp: int | None,
        seed: int,
        estimator: str,
        sensor: str | int | None,
        *values: torch.Tensor,
    ) -> torch.Tensor:
        ctx.scene, ctx.keys, ctx.spp, ctx.seed = scene, keys, spp, seed
        ctx.estimator, ctx.sensor = estimator, sensor
        ctx.save_for_backward(*values)
        _set(scene, keys, values)
        image = scene.render(spp=spp, seed=2 * seed, sensor=sensor)
        return torch.from_numpy(image).to(values[0].device)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, adjoint: torch.Tensor) -> tuple[Any, ...]:
        values = ctx.saved_tensors
        # Others may have moved the scene since.
        _set(ctx.scene, ctx.keys, values)
        wanted = [key for key, needed in zip(ctx.keys, ctx.needs_input_grad[6:]) if needed]
        adjoint = adjoint.detach().cpu().numpy()
        found = ctx.scene.backward(
            adjoint, wanted, estimator=ctx.estimator, spp=ctx.spp, seed=2 * ctx.seed + 1, sensor=ctx.sensor
        )
        # In the order of the names, which may be Mitsuba's.
        found = dict(zip(wanted, found.values()))
        gradients = [
            torch.from_numpy(found[key]).reshape(value.shape).to(value) if key in found else None
            for key, value in zip(ctx.keys, values)
        ]
        return None, None, None, None, None, None, *gradients


def _set(scene: Scene, keys: Sequence[str], values: Sequence[torch.Tensor]) -> None:
    # A parameter of one number has the shape (), whatever a tensor calls that.
    arrays = {key: value.detach().cpu().numpy() for key, value in zip(keys, values)}
    scene.update({key: a.reshape(()) if a.size == 1 else a for key, a in arrays.items()})


def render(
    scene: Scene,
    params: Mapping[str, torch.Tensor],
    *,
    spp: int | None = None,
    seed: int = 0,
    estimator: str = "mis",
    sensor: str | int | None = None,
) -> torch.Tensor:
    """The image of the scene with these parameters, height x width x 3, which gradients flow back from.

    The image takes the seed `2 * seed` and the gradient `2 * seed + 1`: they are independent, or it would not be the
    gradient of the expected loss. Every step should take a seed of its own. The parameters of the scene are replaced by
    the tensors. `sensor` is what it is seen through, if not the scene's own.
    """
    if not params:
        raise ValueError("params: expected at least one parameter, found none")
    return _Render.apply(scene, tuple(params), spp, seed, estimator, sensor, *params.values())
