from collections.abc import Sequence
from typing import Any

class Arm:
    def __init__(self, parents: Any, slides: Any, axes: Any, placements: Any, tip: Any) -> None: ...
    def turned_to(self, q: Any, goal: Any, steps: int, tolerance: float, damping: float) -> list[float] | None: ...

class Boxes:
    def __init__(
        self, parents: Any, slides: Any, axes: Any, placements: Any, pairs: Any, solids: Any, hulls: Any
    ) -> None: ...
    def place(self, box: int, joint: int, placement: Sequence[float], levers: Any) -> None: ...
    def use(self, numbers: Any, margins: Any) -> None: ...
    def undecided(self, q: Any, slots: Any) -> list[int]: ...
    def way(self, q: Any, slots: Any, rows: Any, first: int, halvings: int, off: Any) -> tuple[int, list[int]]: ...
    def line(self, q: Any, slots: Any, start: Any, end: Any, steps: int, halvings: int) -> tuple[int, list[int]]: ...
    def space(self, q: Any, slots: Any, rows: Any, boxes: Any, step: float) -> Any: ...

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
