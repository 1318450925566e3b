"""The native half of `render_gradients`; a test compares these stubs with it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from typing import Any, Literal, final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Progress = Callable[[float], object]

__all__: list[str]
target_features: str

@final
class Check:
    @property
    def verdict(self) -> Literal["right", "cannot tell", "wrong"]: ...
    @property
    def z_limit(self) -> float: ...
    @property
    def params(self) -> dict[str, list[dict[str, Any]]]: ...
    def __bool__(self) -> bool: ...

@final
class EstimatorInfo:
    @property
    def name(self) -> str: ...
    @property
    def summary(self) -> str: ...
    @property
    def capabilities(self) -> str: ...
    @property
    def refuses(self) -> list[str]: ...
    @property
    def biased(self) -> bool: ...

@final
class Optimizer:
    def __new__(
        cls,
        scene: Scene,
        keys: str | Sequence[str],
        rate: float | None = None,
        method: Literal["adam", "sgd"] = "adam",
        rates: dict[str, float] | None = None,
    ) -> Optimizer: ...
    def step(self, gradient: dict[str, Any]) -> None: ...
    @property
    def keys(self) -> list[str]: ...
    @property
    def steps(self) -> int: ...

@final
class Scene:
    def keys(self) -> list[str]: ...
    def __iter__(self) -> Iterator[str]: ...
    def __len__(self) -> int: ...
    def __contains__(self, key: str, /) -> bool: ...
    def __getitem__(self, key: str, /) -> NDArray[np.float32]: ...
    def __setitem__(self, key: str, value: ArrayLike, /) -> None: ...
    def __delitem__(self, key: str, /) -> None: ...
    def update(self, values: dict[str, Any]) -> None: ...
    def info(self, key: str) -> dict[str, Any]: ...
    def refusal(self, estimator: str, keys: str | Sequence[str] | None = None) -> str | None: ...
    def movables(self) -> list[str]: ...
    def make_movable(self, keys: str | Sequence[str]) -> None: ...
    @property
    def sensors(self) -> list[str]: ...
    def save(self, path: str | PathLike[str]) -> list[Any]: ...
    @property
    def warnings(self) -> list[str]: ...
    @property
    def files(self) -> list[Any]: ...
    @property
    def size(self) -> tuple[int, int]: ...
    @property
    def spp(self) -> int: ...
    @spp.setter
    def spp(self, spp: int) -> None: ...
    @property
    def max_depth(self) -> int: ...
    @max_depth.setter
    def max_depth(self, depth: int) -> None: ...
    @property
    def hide_emitters(self) -> bool: ...
    @hide_emitters.setter
    def hide_emitters(self, hide: bool) -> None: ...
    @property
    def sampler(self) -> str: ...
    @sampler.setter
    def sampler(self, name: str) -> None: ...
    @property
    def lights(self) -> str: ...
    @lights.setter
    def lights(self, name: str) -> None: ...
    @overload
    def render(
        self,
        spp: int | None = None,
        seed: int = 0,
        sensor: str | int | None = None,
        *,
        estimator: str = "mis",
        double: Literal[False] = False,
        progress: _Progress | None = None,
    ) -> NDArray[np.float32]: ...
    @overload
    def render(
        self,
        spp: int | None = None,
        seed: int = 0,
        sensor: str | int | None = None,
        *,
        estimator: str = "mis",
        double: Literal[True],
        progress: _Progress | None = None,
    ) -> NDArray[np.float64]: ...
    def alpha(
        self, spp: int | None = None, seed: int = 0, sensor: str | int | None = None
    ) -> NDArray[np.float32]: ...
    def backward(
        self,
        adjoint: ArrayLike,
        keys: str | Sequence[str] | None = None,
        estimator: str = "mis",
        spp: int | None = None,
        seed: int = 1,
        sensor: str | int | None = None,
        *,
        progress: _Progress | None = None,
    ) -> dict[str, NDArray[np.float64]]: ...
    def forward(
        self,
        directions: str | Sequence[str] | Mapping[str, ArrayLike],
        estimator: str = "mis",
        spp: int | None = None,
        seed: int = 1,
        sensor: str | int | None = None,
        *,
        progress: _Progress | None = None,
    ) -> NDArray[np.float32]: ...
    def check(
        self,
        keys: str | Sequence[str] | None = None,
        estimator: str = "mis",
        *,
        adjoint: ArrayLike | None = None,
        spp: int | None = None,
        repeats: int = 32,
        tolerance: float = 0.1,
        significance: float = 0.001,
        seed: int = 0,
        sensor: str | int | None = None,
        progress: _Progress | None = None,
    ) -> Check: ...

def has_x86_64_v3() -> bool: ...
def load(
    path: str | PathLike[str],
    *,
    defines: dict[str, Any] | None = None,
    allow_missing: bool = False,
    sensor: str | int | None = None,
) -> Scene: ...
def load_string(
    text: str,
    *,
    base: str | PathLike[str] | None = None,
    defines: dict[str, Any] | None = None,
    allow_missing: bool = False,
    sensor: str | int | None = None,
) -> Scene: ...
def room(width: int = 128, height: int = 128) -> Scene: ...
def estimators() -> list[EstimatorInfo]: ...
def loss(image: ArrayLike, target: ArrayLike, name: str = "l2") -> tuple[float, NDArray[np.float32]]: ...
def z_limit(tests: int, runs: int, significance: float = 0.001) -> float: ...
