from collections.abc import Sequence
from typing import Any

VERSION: int

def squared_pace(alpha: Any, beta: Any, peaks: Any, squares: Any, none: float) -> Any: ...

class Arm:
    def __init__(self, parents: Any, slides: Any, axes: Any, placements: Any, tip: Any) -> None: ...
    def turned_to(self, q: Any, goal: Any, steps: int, tolerance: float, damping: float) -> list[float] | None: ...

class Puma:
    def __init__(self, lengths: Any, base: Any, tool: Any, speeds: Any) -> None: ...
    def along(self, poses: Any, near: Any) -> Any: ...
    def line(self, begin: Any, end: Any, fractions: Any, near: Any) -> Any: ...
    def within(self, pose: Any, reference: Any, least: Any, most: Any) -> Any: ...

class Boxes:
    def __init__(
        self, parents: Any, slides: Any, axes: Any, placements: Any, pairs: Any, solids: Any, hulls: Any
    ) -> None: ...
    def place(self, boxes: Sequence[int], joint: int, owner: Any, placements: Any, levers: Any) -> None: ...
    def use(self, numbers: Any, margins: Any) -> None: ...
    def undecided(self, q: Any, slots: Any) -> list[int]: ...
    def way(self, q: Any, slots: Any, rows: Any, first: int, halvings: int, off: Any) -> tuple[int, list[int]]: ...
    def line(self, q: Any, slots: Any, start: Any, end: Any, steps: int, halvings: int) -> tuple[int, list[int]]: ...
    def space(self, q: Any, slots: Any, rows: Any, boxes: Any, step: float) -> Any: ...

class Separation:
    def __init__(
        self,
        boxes: Boxes,
        q: Any,
        pairs: Any,
        slots: Any,
        rows: Any,
        their_slots: Any,
        their_rows: Any,
        clearance: float,
    ) -> None: ...
    def open(self, known: int, first: int, last: int, their_first: int, their_last: int) -> int: ...

class Growth:
    def __init__(
        self,
        reach: float,
        least: float,
        back: float,
        vain: float,
        projected: float,
        onward: float,
        tolerance: float,
        damping: float,
        projections: int,
        halvings: int,
    ) -> None: ...

class Trees:
    def __init__(
        self,
        boxes: Boxes,
        q: Any,
        slots: Any,
        start: Any,
        goals: Any,
        limits: Any,
        weights: Any,
        growth: Growth,
        arm: Arm | None,
        attitude: Any,
    ) -> None: ...
    def ends_are_free(self) -> bool: ...
    def have_grown(self) -> bool: ...
    def grow(self, samples: Any) -> tuple[int, int, list[Any]] | None: ...
    def steer(self, here: Any, there: Any) -> tuple[list[Any], bool]: ...
