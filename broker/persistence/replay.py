"""Replay: rebuild the broker state from a journal by repeating all decisions.

`python -m rtc broker.persistence.replay JOURNAL` replays a journal twice. It checks that both replays make the same
decisions, and that
they agree with the stored command records.
"""

from __future__ import annotations

import sqlite3
import sys
import time
from pathlib import Path

from broker.decisions.decide import decide
from broker.decisions.effects import ReportEnd
from broker.decisions.state import State
from broker.persistence.journal import Journal
from rtc.protocol import wire
from rtc.protocol.messages import CommandRecord
from rtc.protocol.outcomes import WireError


def replay(journal: Journal) -> tuple[State, dict[str, CommandRecord]]:
    """The state at the end of the journal, and the records of the commands that ended on the way. Effects are not
    executed: they were executed before, or a restart repeats them."""
    after, state = journal.last_snapshot()
    ended = {}
    for batch in journal.batches(after):
        for event in batch:
            for effect in decide(state, event):
                if isinstance(effect, ReportEnd):
                    ended[effect.record.command] = effect.record
    return state, ended


def main(argv: list[str]) -> int:
    if len(argv) != 1 or argv[0] in ("-h", "--help"):
        print(
            "usage: python -m rtc broker.persistence.replay JOURNAL\n\n"
            "example: python -m rtc broker.persistence.replay /tmp/rtc-1000/journal.db"
        )
        return 0 if argv and argv[0] in ("-h", "--help") else 2
    path = Path(argv[0])
    if not path.exists():
        print(f"no journal at {path}")
        return 2
    journal = Journal.read_only(path)
    began = time.perf_counter()
    try:
        (first, ended), (second, _) = replay(journal), replay(journal)
    except WireError as error:
        print(f"{path} cannot be replayed: {error}")
        return 2
    except (sqlite3.DatabaseError, TypeError):
        print(f"{path} is not a journal of a broker (RUN_DIR/journal.db is one)")
        return 2
    differing = [name for name, record in ended.items() if (kept := journal.record(name)) and kept != record]
    took_s = time.perf_counter() - began
    same = wire.encode(first) == wire.encode(second) and not differing
    print(f"{len(ended)} commands ended in the journal, {len(first.commands)} live; decided twice in {took_s:.2f} s")
    if not ended and first.accepted:
        print("its events were condensed into a snapshot, as whenever a broker ends in order: nothing to decide again")
        return 0 if same else 1
    print("same decisions" if same else f"DIFFERENT decisions: {', '.join(differing) or 'states differ'}")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
