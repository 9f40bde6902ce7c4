"""Check that each command ran once and that its reported outcome is true, by the journal and the MCM's log.

The outcomes that clients received are compared with three independent records. These are the broker's journal (all its
events), the MCM's log (all primitives that its processes started), and the list of killed processes.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.load.errands import Errand
from broker.decisions.events import Event, PrimitiveEnded
from broker.persistence.journal import Journal, read_events
from rtc.protocol.outcomes import OutcomeKind, RefusalReason, StopReason
from rtc.runtime.chaos import Strike

GOAL_RAD = 0.01
FOUND_S = 0.5  # limit until the broker and a new MCM are connected
NOT_WHERE = "does not start where"  # an MCM refuses a trajectory that does not start at its position


class JournalReader:
    """The events of a journal, read while its broker writes it."""

    def __init__(self, run_dir: Path) -> None:
        self._db = Journal.read_only(run_dir / "journal.db").db
        self._last = 0
        self.events: list[Event] = []

    def read(self) -> list[Event]:
        """The events since the last call. Call it often: a snapshot of the broker deletes earlier events."""
        new: list[Event] = []
        for n, events in self._db.execute("SELECT n, events FROM turns WHERE n > ? ORDER BY n", (self._last,)):
            new += read_events(events)
            self._last = n
        self.events += new
        return new

    def close(self) -> None:
        self._db.close()


@dataclass
class Verdict:
    lost: list[str] = field(default_factory=list)  # commands without an outcome
    repeated: list[str] = field(default_factory=list)  # executed or accepted twice
    wrong: list[str] = field(default_factory=list)  # outcomes that are not true
    outcomes: Counter[str] = field(default_factory=Counter)

    def print_faults(self) -> None:
        for word, cases in (("LOST", self.lost), ("REPEATED", self.repeated), ("WRONG", self.wrong)):
            for case in cases[:10]:
                print(f"  {word}: {case}")


def judge(errands: Sequence[Errand], events: Sequence[Event], run_dir: Path, strikes: Iterable[Strike]) -> Verdict:
    """`strikes`: the killed processes. Commands may end only because of a death of the MCM."""
    verdict = Verdict()
    ended = {e.report.primitive: e.report for e in events if isinstance(e, PrimitiveEnded)}
    begun = Counter(re.findall(r"begins (C-\S+)", _mcm_log(run_dir)))
    verdict.repeated += [f"{primitive} was begun {n} times" for primitive, n in begun.items() if n > 1]
    taken = Counter(errand.command for errand in errands if errand.command)
    verdict.repeated += [f"{command} is the outcome of {n} sentences" for command, n in taken.items() if n > 1]
    away = [(s.at_s, s.at_s + (s.back_s or 0.0) + FOUND_S) for s in strikes if s.name == "MCM"]
    known_s: dict[str, float] = {}  # arm -> time since which the world knows its position
    for errand in sorted(errands, key=lambda e: e.sent_at_s):
        if errand.outcome is None:
            verdict.lost.append(f"{errand.text}, sent at {errand.sent_at_s:.3f}")
            continue
        kind = errand.outcome.kind
        verdict.outcomes[kind.value] += 1
        primitives = [primitive for primitive in begun if primitive.startswith(f"{errand.command}.")]
        report = ended.get(max(primitives, key=_number, default=""))
        if not errand.arm:
            true = kind is OutcomeKind.REFUSED and _refused_for(errand, RefusalReason.SENTENCE, RefusalReason.NAME)
        elif kind is OutcomeKind.SUCCEEDED:
            there = report is not None and report.reason is StopReason.GOAL and _at(report.joints, errand.goal_rad)
            true = there and all(begun[primitive] == 1 for primitive in primitives)
        elif kind is OutcomeKind.LOST_SUBSYSTEM:
            true = any(gone <= errand.ended_at_s and back >= errand.sent_at_s for gone, back in away)
        elif kind is OutcomeKind.FAILED:
            unknown = any(back > known_s.get(errand.arm, 0.0) for _, back in away)
            true = NOT_WHERE in errand.outcome.message and unknown and not primitives
        else:
            true = False
        if not true:
            verdict.wrong.append(f"{errand.command} {errand.text}: {kind.value} {errand.outcome.message}")
        if errand.arm and kind in (OutcomeKind.SUCCEEDED, OutcomeKind.FAILED):
            known_s[errand.arm] = errand.ended_at_s
    return verdict


def _number(primitive: str) -> int:
    """The number of a primitive: 2 of C-7.2."""
    return int(primitive.partition(".")[2].partition("@")[0])


def _refused_for(errand: Errand, *reasons: RefusalReason) -> bool:
    assert errand.outcome is not None
    return errand.outcome.refusal is not None and errand.outcome.refusal.reason in reasons


def _at(joints: Sequence[float], goal: Sequence[float]) -> bool:
    return all(abs(a - b) <= GOAL_RAD for a, b in zip(joints, goal, strict=True))


def _mcm_log(run_dir: Path) -> str:
    log = run_dir / "logs" / "MCM.log"
    before = log.with_suffix(".log.1")
    return (before.read_text() if before.exists() else "") + log.read_text()
