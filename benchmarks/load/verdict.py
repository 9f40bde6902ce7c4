"""Check that each command ran once and that its reported outcome is true, by the journal and the MCM's log.

The outcomes that clients received are compared with three independent records. These are the broker's journal (all its
events), the MCM's log (all primitives that its processes started), and the list of killed processes. An outcome that
cannot be compared, because the reader missed a part of the journal, is not seen: it is neither true nor wrong.
"""

from __future__ import annotations

import re
import threading
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.load.errands import Errand
from broker.decisions.events import Event, PrimitiveEnded
from broker.persistence.journal import Journal, read_events
from rtc.protocol.outcomes import OutcomeKind, RefusalReason, StopReason
from tests.campaigns.chaos import Strike

GOAL_RAD = 0.01
FOUND_S = 0.5  # limit until the broker and a new MCM are connected
NOT_WHERE = "does not start where"  # an MCM refuses a trajectory that does not start at its position
FOLLOW_S = 0.02  # period of reading; the broker deletes batches no earlier than 0.1 s after a periodic snapshot


class JournalReader:
    """The events of a journal, read while its broker writes it.

    A snapshot of the broker makes earlier batches unnecessary, and they are deleted. `follow` reads all the time.
    Batches have consecutive numbers, so `missed` counts those that were deleted before they were read.
    """

    def __init__(self, run_dir: Path) -> None:
        self._db = Journal.read_only(run_dir / "journal.db", one_thread=False).db
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._follower: threading.Thread | None = None
        self._last: int | None = None  # the number of the last batch
        self._returned = 0  # events
        self.events: list[Event] = []
        self.missed = 0  # batches

    def follow(self) -> None:
        """Read in a thread of its own until `close`."""
        self._follower = threading.Thread(target=self._follow, daemon=True)
        self._follower.start()

    def read(self) -> list[Event]:
        """The events since the last call."""
        with self._lock:
            self._read()
            new = self.events[self._returned :]
            self._returned = len(self.events)
        return new

    def close(self) -> None:
        """Read the rest and close the journal; the events stay."""
        self.read()
        self._over.set()
        if self._follower is not None:
            self._follower.join()
        self._db.close()

    def _follow(self) -> None:
        while not self._over.wait(FOLLOW_S):
            with self._lock:
                self._read()

    def _read(self) -> None:
        for n, events in self._db.execute("SELECT n, events FROM turns WHERE n > ? ORDER BY n", (self._last or 0,)):
            self.missed += n - self._last - 1 if self._last is not None else 0
            self.events += read_events(events)
            self._last = n


@dataclass
class Verdict:
    lost: list[str] = field(default_factory=list)  # commands without an outcome
    repeated: list[str] = field(default_factory=list)  # executed or accepted twice
    wrong: list[str] = field(default_factory=list)  # outcomes that are not true
    not_seen: list[str] = field(default_factory=list)  # outcomes whose report may be in a missed part of the journal
    missed: int = 0  # batches of the journal that were deleted before they were read
    outcomes: Counter[str] = field(default_factory=Counter)

    @property
    def faultless(self) -> bool:
        """Every outcome was compared, and is true."""
        return not (self.lost or self.repeated or self.wrong or self.not_seen)

    def print_faults(self) -> None:
        found = (("LOST", self.lost), ("REPEATED", self.repeated), ("WRONG", self.wrong), ("NOT SEEN", self.not_seen))
        for word, cases in found:
            for case in cases[:10]:
                print(f"  {word}: {case}")
        if self.not_seen:
            print(f"  NOT JUDGED: {self.missed} batches of the journal were deleted before they were read")


def judge(errands: Sequence[Errand], journal: JournalReader, run_dir: Path, strikes: Iterable[Strike]) -> Verdict:
    """`strikes`: the killed processes. Commands may end only because of a death of the MCM."""
    events = journal.events
    verdict = Verdict(missed=journal.missed)
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
            unseen = kind is OutcomeKind.SUCCEEDED and report is None and journal.missed > 0
            case = f"{errand.command} {errand.text}: {kind.value} {errand.outcome.message}"
            (verdict.not_seen if unseen else verdict.wrong).append(case)
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
