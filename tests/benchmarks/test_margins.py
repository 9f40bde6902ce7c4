"""The room between a threshold and what is met on either side, and which sides are compared."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.margins.met import Met
from benchmarks.margins.runs import MarginRun, joined
from benchmarks.margins.table import of_thresholds, room


@pytest.mark.parametrize(
    ("limit", "good", "bad", "enough"),
    [
        (20.0, [1.0, 10.0], [30.0, 40.0], True),  # below
        (13.0, [1.0, 10.0], [30.0, 40.0], False),
        (26.0, [1.0, 10.0], [30.0, 40.0], False),
        (20.0, [30.0, 40.0], [1.0, 10.0], True),  # above
        (20.0, [1.0, 21.0], [30.0, 40.0], False),  # a success beyond it
        (20.0, [1.0, 2.0, 31.0], [30.0, 40.0], False),  # no limit divides them
    ],
)
def test_a_third_of_the_way_between_both_sides_is_room_enough(limit, good, bad, enough):
    assert room(limit, good, bad).enough is enough


def test_a_tug_is_felt_by_its_force_or_by_its_torque():
    def run(number: int, caught: tuple[float, float], free: tuple[float, float]) -> MarginRun:
        met = [Met(f"tug, {how}: {unit}", limit, value) for how, both in (("caught", caught), ("free", free))
               for unit, limit, value in zip(("N", "N.m"), (4.0, 0.5), both, strict=True)]  # fmt: skip
        return MarginRun("PLACE A ON B", "mass 0.9", number, True, "", met)

    [line] = of_thresholds([run(0, (8.0, 0.1), (1.0, 0.2)), run(1, (1.0, 0.9), (0.5, 0.3))], [])
    assert "successes to 1.8 (n 2), failures from 0.6 (n 2)" in line
    assert "TOO LITTLE" not in line


def test_runs_of_files_are_joined_and_the_last_one_of_a_kind_counts(tmp_path: Path):
    first, again = (
        MarginRun("LIFT A", "mass 0.9", 0, done, "", [Met("lower: peak N", 30.0, 2.0)]) for done in (False, True)
    )
    other = first._replace(number=1)
    (tmp_path / "a").write_text(json.dumps(first) + "\n" + json.dumps(other) + "\n")
    (tmp_path / "b").write_text(json.dumps(again) + "\n")
    assert joined([tmp_path / "a", tmp_path / "b", tmp_path / "absent"]) == [again, other]
