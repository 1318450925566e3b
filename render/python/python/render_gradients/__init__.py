"""A differentiable renderer with every gradient estimator side by side.

    import render_gradients as rg

    scene = rg.room(64, 64)                                  # or rg.load("scene.xml")
    target = scene.render(spp=64)
    scene["left.reflectance.value"] = 0.5
    value, gradient = rg.value_and_gradient(scene, target, "left.reflectance.value")

Images are arrays of height x width x 3, linear RGB, row 0 at the top. The same seed gives the same bits. An image and the
gradient of a loss of it take different seeds, or it would not be the gradient of the expected loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ._instructions import native as _native
from ._native import (
    Check,
    EstimatorInfo,
    Optimizer,
    Scene,
    estimators,
    load,
    load_string,
    loss,
    read_image,
    room,
    target_features,
    write_image,
    z_limit,
)
from .comparison import Comparison, compare

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    import numpy as np

__all__ = [
    "Check",
    "Comparison",
    "EstimatorInfo",
    "Optimizer",
    "Scene",
    "compare",
    "estimators",
    "load",
    "load_string",
    "loss",
    "read_image",
    "room",
    "target_features",
    "value_and_gradient",
    "write_image",
    "z_limit",
]


def value_and_gradient(
    scene: Scene,
    target: ArrayLike,
    keys: str | Sequence[str] | None = None,
    *,
    loss: str = "l2",
    estimator: str = "mis",
    spp: int | None = None,
    seed: int = 0,
    sensor: str | int | None = None,
) -> tuple[float, dict[str, NDArray[np.float64]]]:
    """The loss between the image and a target, and its gradient in the parameters `keys`.

    One step of inverse rendering: the image is rendered with the seed `2 * seed`, and the gradient with `2 * seed + 1`, so
    that steps with different seeds are independent. The target is what `sensor` sees, if one is named.
    """
    image = scene.render(spp=spp, seed=2 * seed, sensor=sensor)
    value, adjoint = _native.loss(image, target, loss)
    return value, scene.backward(adjoint, keys, estimator=estimator, spp=spp, seed=2 * seed + 1, sensor=sensor)

