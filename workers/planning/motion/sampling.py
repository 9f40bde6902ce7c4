"""RRT-Connect in joint space between a start and one or more goals, and shortening of its path. Pure.

Two trees of free postures grow towards each other, one from the start and one from all goals (Kuffner and LaValle,
2000). Samples come from a box around start and goals that widens to the joint limits. The budget is a number of samples
and the seed is an argument. So the same problem always has the same path, at any load of the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from rtc.spatial.geometry import Array

#: (from, to) -> postures (rad) on the way, each with a free line from the one before; True: the last one is `to`
Steer = Callable[[Array, Array], tuple[list[Array], bool]]

REACH_RAD = 2.0  # maximum length of one extension, by the largest weighted joint displacement
MIN_RAD = 0.05  # a shorter extension adds no node
AROUND_RAD = 1.0  # margin of the first samples around start and goals
WIDE_AFTER = 120  # samples after which the box covers the joint limits
VAIN = 1.3  # factor of the squared distance of a node for each extension that added no node
BATCH = 32  # samples that are drawn at once
SHORTCUTS = 24  # maximum number of pairs of points of a path between which a line is tried
IN_VAIN = 10  # shortcuts in a row without a gain after which the rest are left out
GAIN = 0.95  # a shortcut must be shorter than this share of the part that it replaces


class Draw(NamedTuple):
    """How samples are drawn, and when a search that finds none ends."""

    mixed: float  # share of samples that keep some joints of an end
    keeps: float  # probability with which such a sample keeps each joint
    stuck_after: int  # samples after which the search ends if one tree has not grown at all


WIDE = Draw(0.3, 0.5, 96)
NARROW = Draw(0.9, 0.65, 288)  # two joints alone often lead out of a narrow place, as of a hand round the bar of a door


class Found(NamedTuple):
    waypoints: list[Array]  # rad; each line between two neighbours is free
    goal: int  # index of the goal reached
    samples: int
    steer: Steer  # of the trees


class _Tree:
    """Free postures with their parents; roots have the parent -1."""

    def __init__(self, roots: Sequence[Array], weights: Array) -> None:
        self._weights = weights
        self.nodes = np.empty((64 + len(roots), len(weights)))
        self._scaled = np.empty_like(self.nodes)
        self._vain = np.ones(len(self.nodes))  # factor of the squared distance: larger where the tree did not grow
        self.parents: list[int] = []
        for root in roots:
            self._add(root, -1)
        self._roots = len(roots)

    @property
    def has_grown(self) -> bool:
        return len(self.parents) > self._roots

    def add_chain(self, postures: list[Array], parent: int) -> int:
        """Add postures, each the child of the one before; the last node."""
        for q in postures:
            parent = self._add(q, parent)
        return parent

    def nearest(self, q: Array) -> int:
        off = self._scaled[: len(self.parents)] - q * self._weights
        return int((np.einsum("ij,ij->i", off, off) * self._vain[: len(off)]).argmin())

    def avoid(self, n: int) -> None:
        """Let another node be taken for the nearest one sooner: the tree could not grow from this one."""
        self._vain[n] *= VAIN

    def branch(self, n: int) -> list[Array]:
        """From this node to its root."""
        found = []
        while n >= 0:
            found.append(self.nodes[n].copy())
            n = self.parents[n]
        return found

    def root(self, n: int) -> int:
        while self.parents[n] >= 0:
            n = self.parents[n]
        return n

    def _add(self, q: Array, parent: int) -> int:
        n = len(self.parents)
        if n == len(self.nodes):
            self.nodes = np.concatenate((self.nodes, np.empty_like(self.nodes)))
            self._scaled = np.concatenate((self._scaled, np.empty_like(self._scaled)))
            self._vain = np.concatenate((self._vain, np.ones_like(self._vain)))
        self.nodes[n], self._scaled[n] = q, q * self._weights
        self.parents.append(parent)
        return n


class GrowingTrees(Protocol):
    """Two trees, one from the start and one from all goals. Each sample is for the other tree than the one before."""

    @property
    def steer(self) -> Steer:
        """The way between two postures."""

    def grow(self, samples: Array) -> tuple[int, int, list[Array]] | None:
        """Grow towards these postures [n][joints]. When the trees meet: the number of the sample, the number of the
        goal, and the way-points from the start to it."""

    def have_grown(self) -> bool:
        """Whether both trees have more than their roots."""


class Trees:
    """`GrowingTrees` for any `Steer`. `rtc/model/robot/_trees.hpp` has them compiled, for lines that boxes prove."""

    def __init__(
        self,
        start: Array,
        goals: Sequence[Array],
        steer: Steer,
        weights: Array,
        project: Callable[[Array], Array | None] = lambda q: q,
    ) -> None:
        """`weights`: of each joint in the distance between postures. `project`: projects a posture onto the
        constraints; None: it cannot."""
        self._ours, self._others = self._from_start, self._from_goals = _Tree([start], weights), _Tree(goals, weights)
        self.steer, self._weights, self._project = steer, weights, project

    def have_grown(self) -> bool:
        return self._ours.has_grown and self._others.has_grown

    def grow(self, samples: Array) -> tuple[int, int, list[Array]] | None:
        for n, q in enumerate(samples):
            ours, others = self._ours, self._others
            self._ours, self._others = others, ours
            aim = self._project(q)
            new = None if aim is None else self._extend(ours, aim)
            met = None if new is None else self._connect(others, ours.nodes[new])
            if new is not None and met is not None:
                at, to = (new, met) if ours is self._from_start else (met, new)
                way = [*reversed(self._from_start.branch(at)), *self._from_goals.branch(to)[1:]]
                return n, self._from_goals.root(to), way
        return None

    def _extend(self, tree: _Tree, q: Array) -> int | None:
        """Grow the tree towards `q` by one extension; the new node."""
        near = tree.nearest(q)
        here = tree.nodes[near]
        length = size(q - here, self._weights)
        aim = self._project(here + (q - here) * (REACH_RAD / length)) if length > REACH_RAD else q
        reached = [] if aim is None else self.steer(here, aim)[0]
        if not reached or size(reached[-1] - here, self._weights) < MIN_RAD:
            tree.avoid(near)
            return None
        return tree.add_chain(reached, near)

    def _connect(self, tree: _Tree, q: Array) -> int | None:
        """Grow the tree towards `q` as far as it is free; the node at `q` if it arrives."""
        near = tree.nearest(q)
        here = tree.nodes[near]
        reached, arrived = self.steer(here, q)
        if arrived:
            return tree.add_chain(reached, near)
        if reached and size(reached[-1] - here, self._weights) >= MIN_RAD:
            tree.add_chain(reached, near)
        else:
            tree.avoid(near)
        return None


def search(
    trees: GrowingTrees,
    ends: Array,
    lower: Array,
    upper: Array,
    *,
    seed: int,
    samples: int,
    guides: Sequence[Array] = (),
    draw: Draw = WIDE,
) -> Found | int:
    """Way-points from the start to one of the goals (rad), or the number of samples that were drawn in vain.

    `ends` [n][joints]: the start and the goals. `lower`, `upper`: joint limits (rad). `guides`: postures that are taken
    before random ones, in turn for the tree of the start and that of the goals. `draw`: of the random ones.
    """
    drawn = 0
    for rows in _samples(np.random.default_rng(seed), ends, lower, upper, guides, draw):
        rows = rows[: max(0, samples - drawn)]
        if not len(rows) or (drawn >= draw.stuck_after and not trees.have_grown()):
            return drawn
        met = trees.grow(rows)
        if met is not None:
            n, goal, way = met
            return Found(way, goal, drawn + n + 1, trees.steer)
        drawn += len(rows)
    raise AssertionError("samples are endless")


def _samples(
    rng: np.random.Generator, ends: Array, lower: Array, upper: Array, guides: Sequence[Array], draw: Draw
) -> Iterator[Array]:
    """The guides, then random postures in batches: around these ends, and farther away as their number grows."""
    least = np.maximum(ends.min(axis=0) - AROUND_RAD, lower)
    most = np.minimum(ends.max(axis=0) + AROUND_RAD, upper)
    first = len(guides)
    if first:
        yield np.array(guides)
    while True:
        wide = np.minimum(1.0, (first + np.arange(BATCH)) / WIDE_AFTER)[:, None]
        low, high = least + wide * (lower - least), most + wide * (upper - most)
        rows = low + rng.random(low.shape) * (high - low)
        kept = (rng.random((BATCH, 1)) < draw.mixed) & (rng.random(low.shape) < draw.keeps)
        yield np.where(kept, ends[rng.integers(len(ends), size=BATCH)], rows)
        first += BATCH


def size(way: Array, weights: Array) -> float:
    """The greatest weighted displacement of a joint; numpy's maximum takes longer for so few values."""
    values = (way * weights).tolist()
    return max(max(values), -min(values))


def shorten(waypoints: list[Array], steer: Steer, weights: Array, *, seed: int) -> list[Array]:
    """The path with way-points left out and corners cut wherever a shorter way is free."""
    rng = np.random.default_rng(seed)
    steer = _remembering(steer)
    path, in_vain = _skip(waypoints, steer, weights), 0
    for _ in range(SHORTCUTS):
        if len(path) < 3 or in_vain == IN_VAIN:
            break
        in_vain += 1
        ends = _along(path, weights)
        a, b = np.sort(rng.uniform(0.0, ends[-1], 2)).tolist()
        i, j = (int(n) for n in np.searchsorted(ends, (a, b), "right") - 1)
        if i >= j:
            continue
        slopes = [(path[n + 1] - path[n]) / (ends[n + 1] - ends[n]) for n in (i, j)]
        first, last = path[i] + (a - ends[i]) * slopes[0], path[j] + (b - ends[j]) * slopes[1]
        if size(last - first, weights) >= GAIN * (b - a):
            continue
        reached, arrived = steer(first, last)
        if arrived and _along([first, *reached], weights)[-1] < GAIN * (b - a):
            path, in_vain = [*path[: i + 1], first, *reached, *path[j + 1 :]], 0
    return _skip(path, steer, weights)


def _remembering(steer: Steer) -> Steer:
    """Without checking a line twice."""
    known: dict[tuple[bytes, bytes], tuple[list[Array], bool]] = {}

    def remembered(here: Array, there: Array) -> tuple[list[Array], bool]:
        line = (here.tobytes(), there.tobytes())
        if line not in known:
            known[line] = steer(here, there)
        return known[line]

    return remembered


def _along(path: list[Array], weights: Array) -> Array:
    """The length of the path up to each way-point."""
    rows = np.array(path)
    return np.concatenate(((0.0,), np.cumsum(np.abs((rows[1:] - rows[:-1]) * weights).max(axis=1))))


def _skip(path: list[Array], steer: Steer, weights: Array) -> list[Array]:
    """Leave out way-points between two that a shorter way connects: the farthest first, then half as far."""
    kept, n = [path[0]], 0
    ends = _along(path, weights)
    while n < len(path) - 1:
        m = len(path) - 1
        while m > n + 1:
            reached, arrived = steer(path[n], path[m])
            if arrived and _along([path[n], *reached], weights)[-1] <= ends[m] - ends[n]:
                kept += reached[:-1]
                break
            m = n + (m - n) // 2 if m - n > 4 else m - 1
        kept.append(path[m])
        n = m
    return kept
