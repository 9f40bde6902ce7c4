"""Linear cost models of measured times: non-negative least squares, and the ratios of measured to fitted. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from statistics import median
from typing import Any

import numpy as np

QUANTILES = 100  # a distribution is kept as this many values, the middles of equal shares of the sorted samples


def fitted(features: Sequence[Sequence[float]], times: Sequence[float]) -> list[float]:
    """Cost per unit of each feature, none negative, that minimizes the relative errors.

    `features`: one row per sample. Raises ValueError without samples.
    """
    if not times:
        raise ValueError("no samples")
    x, y = np.asarray(features, float), np.asarray(times, float)
    x, y = x / y[:, None], np.ones_like(y)
    kept = list(range(x.shape[1]))
    while True:
        costs = np.linalg.lstsq(x[:, kept], y, rcond=None)[0]
        if (costs >= 0).all():
            break
        kept.pop(int(np.argmin(costs)))
    found = np.zeros(x.shape[1])
    found[kept] = costs
    return [float(cost) for cost in found]


Row = tuple[float, ...]


def medians(features: Sequence[Row], times: Sequence[float]) -> tuple[list[Row], list[float]]:
    """Distinct rows and the median time of each, so that a disturbed sample does not move the fit."""
    groups: dict[Row, list[float]] = {}
    for row, time in zip(features, times, strict=True):
        groups.setdefault(row, []).append(time)
    return list(groups), [median(group) for group in groups.values()]


def ratios(features: Sequence[Sequence[float]], times: Sequence[float], costs: Sequence[float]) -> list[float]:
    """QUANTILES values of (measured time / fitted time)."""
    return quantiles(np.asarray(times) / (np.asarray(features, float) @ np.asarray(costs)))


def quantiles(samples: Sequence[float] | np.ndarray) -> list[float]:
    """The distribution of samples as QUANTILES values of equal probability; their mean is that of the samples."""
    ranked = np.sort(np.asarray(samples, float))
    if len(ranked) < QUANTILES:
        return [float(value) for value in ranked]
    edges = np.linspace(0, len(ranked), QUANTILES + 1).astype(int)
    return [float(ranked[low:high].mean()) for low, high in pairwise(edges)]


def middle(rounds: Sequence[Any]) -> Any:
    """The median of each number in data of the same form: dictionaries, lists, numbers. Text is that of the first.

    Lists of unequal length are shortened to the shortest one."""
    first = rounds[0]
    if isinstance(first, dict):
        return {name: middle([each[name] for each in rounds]) for name in first}
    if isinstance(first, (list, tuple)):
        return [middle(some) for some in zip(*rounds, strict=False)]
    return first if isinstance(first, str) else median(rounds)
