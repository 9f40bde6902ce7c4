"""Failures that the thresholds are for, provoked on purpose: something is changed, unknown to the arm, before the
sentence of a verb."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from benchmarks.margins.met import Watched
from benchmarks.margins.runs import SCENES_OF_MARGINS, MarginTrial
from rtc.protocol import primitive as p
from rtc.spatial import geometry
from tests.campaigns.door import rub_hinge

STUCK_NM = 100.0  # of a hinge: more than an arm exerts
Change = Callable[[Watched, random.Random], Any]


class Provocation(NamedTuple):
    verb: str
    change: Change
    without: tuple[type, ...] = ()  # conditions of F that are left out, to see what would be met


def _seat_aside(least_m: float, most_m: float) -> Change:
    """The bay is not where it is believed to be: across its way in, to any side."""

    def change(arms: Watched, rng: random.Random) -> None:
        far, angle = rng.uniform(least_m, most_m), rng.uniform(0.0, 2.0 * math.pi)
        seat = arms._cell.seat("BAY-2")
        side = _sides(geometry.rotate(seat.frame.pose, seat.way_out).tolist())
        offset = [far * (math.cos(angle) * a + math.sin(angle) * b) for a, b in zip(*side, strict=True)]
        assert not arms.sim.displace("BAY-2", [*offset, 0.0, 0.0, 0.0])

    return change


def _sides(axis: Sequence[float]) -> tuple[list[float], list[float]]:
    """Two unit vectors across an axis."""
    x, y, z = axis
    one = [0.0, z, -y] if abs(x) < 0.9 else [-z, 0.0, x]
    size = math.hypot(*one)
    one = [n / size for n in one]
    two = [y * one[2] - z * one[1], z * one[0] - x * one[2], x * one[1] - y * one[0]]
    return one, two


def _stuck_hinge(arms: Watched, rng: random.Random) -> None:
    rub_hinge(arms.world, "DOOR-2", STUCK_NM)


def _stops_short(arms: Watched, rng: random.Random) -> None:
    """Something holds the door open by 5 to 10 degrees."""
    angle, step = math.radians(rng.uniform(5.0, 10.0)), arms.world.step

    def held() -> None:
        step()
        if arms.world.angle("DOOR-2") < angle:
            _stuck_hinge(arms, rng)

    arms.world.step = held  # type: ignore[method-assign]


JAMS = (p.NoProgress,)

PROVOKED: dict[str, Provocation] = {
    "bay 6 to 14 mm aside, PLACE": Provocation("PLACE", _seat_aside(0.006, 0.014)),
    "bay 6 to 14 mm aside, INSERT": Provocation("INSERT", _seat_aside(0.006, 0.014), JAMS),
    "jammed in its rack": Provocation("EXTRACT", lambda arms, rng: arms.sim.jam("RACK-1", True), JAMS),
    "stripped thread": Provocation("LOOSEN", lambda arms, rng: arms.sim.strip("BOLT-1")),
    "stuck hinge, OPEN": Provocation("OPEN", _stuck_hinge),
    "held open by 5 to 10 deg": Provocation("CLOSE", _stops_short),
    "hinge of 1.5 N.m": Provocation(
        "CLOSE", lambda arms, rng: rub_hinge(arms.world, "DOOR-2", 1.5)
    ),  # still to succeed
    "hinge of 3 N.m": Provocation("CLOSE", lambda arms, rng: rub_hinge(arms.world, "DOOR-2", 3.0)),
    "stuck hinge, CLOSE": Provocation("CLOSE", _stuck_hinge),
}


class ProvokedTrial(MarginTrial):
    """`under` a provocation, which happens before the last sentence."""

    def _done(self, sentence: str) -> bool:
        made = PROVOKED[self.variant]
        if sentence == SCENES_OF_MARGINS[made.verb].sentences[-1]:
            self.subsystem.without = made.without
            made.change(self.subsystem, random.Random(f"{self.variant}/{self.run.number}"))
        return super()._done(sentence)

    def _vary(self) -> None:
        """Nothing differs before."""
