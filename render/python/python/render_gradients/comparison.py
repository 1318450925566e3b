"""Estimators of one derivative against each other: bias, variance, time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ._native import Scene, estimators as all_estimators, z_limit

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

#: Blocks of the image per side.
BLOCKS = 4
#: Repeats of the reference, and of a second look, for one of an estimator.
MORE = 4


@dataclass(frozen=True)
class Comparison:
    """What was found about one estimator."""

    #: Its name.
    estimator: str
    #: Why it is refused here; nothing else is known then.
    refused: str | None = None
    #: Mean of the derivative image over pixels and channels, and its standard error.
    mean: float = float("nan")
    std_error: float = float("nan")
    #: Largest difference to the reference of a block of the image, in standard errors.
    z: float = float("nan")
    #: right; biased: it differs beyond chance, and does so again with four times the samples; unresolved: it does not do
    #: so again, or sees nothing there; refused.
    finding: str = "refused"
    #: Variance of one sample of one pixel, mean over pixels and channels.
    variance: float = float("nan")
    #: Wall time of one sample of one pixel.
    seconds: float = float("nan")
    #: Error against time: seconds so far and root mean square difference to the reference, for 1, 2, 4, .. repeats.
    ladder: list[tuple[float, float]] = field(default_factory=list)

    @property
    def efficiency(self) -> float:
        """1 / (variance x time); zero where nothing was seen."""
        cost = self.variance * self.seconds
        return 1.0 / cost if cost > 0.0 else 0.0


class _Series:
    """Independent derivative images."""

    def __init__(self, images: list[NDArray[np.float64]], seconds: list[float]) -> None:
        self.images = np.stack(images)
        self.seconds = np.array(seconds)
        height, width = self.images.shape[1:3]
        # The blocks of small images are single pixels.
        rows, columns = (np.arange(n) * min(BLOCKS, n) // n for n in (height, width))
        rows, columns = (np.flatnonzero(np.diff(edges, prepend=-1)) for edges in (rows, columns))
        counts = np.outer(np.diff(rows, append=height), np.diff(columns, append=width))
        sums = np.add.reduceat(np.add.reduceat(self.images.mean(axis=3), rows, axis=1), columns, axis=2)
        self.blocks = (sums / counts).reshape(len(images), -1)

    def mean(self) -> NDArray[np.float64]:
        return np.asarray(self.images.mean(axis=0))

    def z(self, truth: _Series) -> NDArray[np.float64]:
        """Difference of every block to that of another series, in standard errors."""
        difference = self.blocks.mean(axis=0) - truth.blocks.mean(axis=0)
        variance = sum(s.blocks.var(axis=0, ddof=1) / len(s.blocks) for s in (self, truth))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(difference == 0.0, 0.0, difference / np.sqrt(variance))

    def ladder(self, truth: NDArray[np.float64]) -> list[tuple[float, float]]:
        def error(n: int) -> float:
            return float(np.sqrt(np.mean((self.images[:n].mean(axis=0) - truth) ** 2)))

        steps = [2**k for k in range(len(self.images).bit_length())]
        return [(float(self.seconds[:n].sum()), error(n)) for n in steps]


def compare(
    scene: Scene,
    directions: str | Sequence[str] | Mapping[str, ArrayLike],
    estimators: str | Sequence[str] | None = None,
    *,
    reference: str = "mis",
    spp: int | None = None,
    repeats: int = 16,
    seed: int = 0,
    significance: float = 1e-3,
    progress: Callable[[float], object] | None = None,
) -> list[Comparison]:
    """Compares estimators of the derivative image along `directions`, as for `Scene.forward`.

    Every estimator makes `repeats` independent images of `spp` samples per pixel, the reference four times as many. One
    that differs from the reference beyond chance in any block of the image, out of 4 x 4, gets a second look with four
    times the samples. Without `estimators`: all of them. Those that are refused say why.
    """
    if repeats < 4:
        raise ValueError(f"repeats: expected at least 4, found {repeats}")
    if estimators is None:
        estimators = [e.name for e in all_estimators()]
    names = [estimators] if isinstance(estimators, str) else list(estimators)
    keys = list(directions) if not isinstance(directions, str) else [directions]
    refusals = {name: scene.refusal(name, keys) for name in [reference, *names]}
    if refusals[reference] is not None:
        raise ValueError(f"reference: {refusals[reference]}")
    able = [name for name in names if refusals[name] is None]
    total = MORE + len(able)
    done = 0.0

    def series(name: str, stream: int, count: int, weight: float) -> _Series:
        nonlocal done
        images, seconds = [], []
        for k in range(count):
            own_seed = int(np.random.SeedSequence([seed, stream, k]).generate_state(1, np.uint64)[0])
            start = time.perf_counter()
            images.append(scene.forward(directions, estimator=name, spp=spp, seed=own_seed).astype(np.float64))
            seconds.append(time.perf_counter() - start)
            done += weight / count
            if progress is not None:
                progress(min(done / total, 1.0))
        return _Series(images, seconds)

    # An estimator's numbers do not depend on which others are asked for.
    streams = {e.name: 2 + place for place, e in enumerate(all_estimators())}
    again = len(streams)
    truth = series(reference, 1, MORE * repeats, MORE)
    limit = z_limit(BLOCKS * BLOCKS * max(len(able), 1), repeats, significance)
    samples = scene.spp if spp is None else spp
    found = []
    for name in names:
        if refusals[name] is not None:
            found.append(Comparison(name, refused=refusals[name]))
            continue
        own = series(name, streams[name], repeats, 1.0)
        z = own.z(truth)
        worst = int(np.argmax(np.abs(z)))
        finding = "right"
        if abs(z[worst]) > limit:
            more = series(name, streams[name] + again, MORE * repeats, 0.0)
            second = more.z(truth)[worst]
            confirmed = abs(second) > limit and second * z[worst] > 0.0 and np.ptp(more.blocks[:, worst]) > 0.0
            finding = "biased" if confirmed else "unresolved"
        means = own.images.mean(axis=(1, 2, 3))
        found.append(
            Comparison(
                name,
                mean=float(means.mean()),
                std_error=float(means.std(ddof=1) / np.sqrt(repeats)),
                z=float(z[worst]),
                finding=finding,
                variance=float(own.images.var(axis=0, ddof=1).mean() * samples),
                seconds=float(np.median(own.seconds) / (samples * scene.size[0] * scene.size[1])),
                ladder=own.ladder(truth.mean()),
            )
        )
    return found
