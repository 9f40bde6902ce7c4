"""Tables of what was met: each threshold with both distributions and the room between. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from benchmarks.grasp import wilson
from benchmarks.margins.met import Met
from benchmarks.margins.runs import MarginRun

THIRD = 1.0 / 3.0


class Threshold(NamedTuple):
    """A limit with the rows of what is met on either side of it."""

    what: str
    good: str  # row of `Met`, in sentences that succeeded
    bad: str  # row of `Met`, in the failures that it is for
    provoked: str = ""  # those of this provocation alone; empty: of all runs


class Room(NamedTuple):
    """`good`, `bad`: the value of each side that is nearest to the limit. The rooms are shares of what is between them;
    a negative one is on the wrong side."""

    limit: float
    good: float
    bad: float

    @property
    def rooms(self) -> tuple[float, float]:
        between = self.bad - self.good
        if between == 0.0:
            return 0.0, 0.0
        return (self.limit - self.good) / between, (self.bad - self.limit) / between

    @property
    def enough(self) -> bool:
        return min(self.rooms) >= THIRD


def room(limit: float, good: Sequence[float], bad: Sequence[float]) -> Room:
    """Of a limit between two distributions; their medians say on which side each one is."""
    middle = sorted(good)[len(good) // 2], sorted(bad)[len(bad) // 2]
    if middle[0] <= middle[1]:
        return Room(limit, max(good), min(bad))
    return Room(limit, min(good), max(bad))


#: those that two sets of runs show; docs/physics.md has the others
THRESHOLDS = (
    Threshold("tug: a caught object, a free one (share)", "tug, caught: share", "tug, free: share"),
    Threshold("lower: force of the blow (N)", "lower: peak N", "lower: peak N", "bay 6 to 14 mm aside, PLACE"),
    Threshold("insert: force (N)", "insert: force_limit N", "insert: force_limit N", "bay 6 to 14 mm aside, INSERT"),
    Threshold("insert: behind the command (m)", "insert: force_limit m behind", "insert: force_limit m behind",
              "bay 6 to 14 mm aside, INSERT"),
    Threshold("pull: behind the command (m)", "pull: force_limit m behind", "pull: force_limit m behind",
              "jammed in its rack"),
    Threshold("torque of a thread (N.m)", "turn: slip N.m fallen", "turn_to_torque: contact N.m", "stripped thread"),
)  # fmt: skip


def metrics_of(done: Sequence[MarginRun]) -> tuple[dict[str, float | None], list[tuple[str, str]]]:
    """The metrics, and a row for each sentence: its rate with the Wilson interval of 95 %, and what failed."""
    rows, rates = [], []
    for sentence in dict.fromkeys(run.sentence for run in done):
        ones = [run for run in done if run.sentence == sentence]
        successes = sum(run.succeeded for run in ones)
        low, high = wilson(successes, len(ones))
        rates.append(successes / len(ones))
        failed = Counter(f"{run.variant}: {run.cause[:90]}" for run in ones if not run.succeeded)
        words = "".join(f"; {count} x {cause}" for cause, count in failed.most_common(4))
        rows.append((sentence, f"{successes} of {len(ones)} ({low:.0%} to {high:.0%}){words}"))
    return {"runs": float(len(done)), "lowest_rate": min(rates, default=None)}, rows


def shares_of_tugs(met: Iterable[Met]) -> list[Met]:
    """A tug is felt by its force or by its torque: the greater share of the two counts."""
    found: dict[str, list[float]] = {}
    for one in met:
        if one.row.startswith("tug, "):
            found.setdefault(one.row.partition(":")[0], []).append(one.share)
    return [Met(f"{how}: share", 1.0, max(shares)) for how, shares in found.items()]


def met_by(done: Iterable[MarginRun], row: str) -> list[Met]:
    return [one for run in done for one in [*run.met, *shares_of_tugs(run.met)] if one.row == row]


def of_thresholds(done: Sequence[MarginRun], provoked: Sequence[MarginRun]) -> list[str]:
    """A line for each threshold whose both sides were met."""
    lines = []
    for one in THRESHOLDS:
        good = met_by([run for run in done if run.succeeded], one.good)
        failures = [run for run in provoked if run.variant == one.provoked] if one.provoked else done
        bad = met_by(failures, one.bad)
        if good and bad:
            found = room(good[0].limit or bad[0].limit, [met.value for met in good], [met.value for met in bad])
            rooms = " and ".join(f"{share:.0%}" for share in found.rooms)
            lines.append(
                f"{one.what}: limit {found.limit:.4g}; successes to {found.good:.4g} (n {len(good)}), "
                f"failures from {found.bad:.4g} (n {len(bad)}); room {rooms}{'' if found.enough else ', TOO LITTLE'}"
            )
    return lines


def extremes(done: Sequence[MarginRun]) -> list[str]:
    """A line for each row of `Met` in sentences that succeeded: the value that is nearest to its limit."""
    rows: dict[str, list[Met]] = {}
    for run in done:
        for one in run.met if run.succeeded else ():
            rows.setdefault(one.row, []).append(one)
    lines = []
    for row, ones in sorted(rows.items()):
        values = sorted(one.value for one in ones)
        limits = sorted({one.limit for one in ones})
        shown = f"{limits[0]:.4g}" + (f" to {limits[-1]:.4g}" if len(limits) > 1 else "")
        lines.append(f"{row}: {values[0]:.4g} to {values[-1]:.4g}, limit {shown} (n {len(ones)})")
    return lines
