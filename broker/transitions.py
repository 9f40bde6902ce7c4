"""What may follow what: every phase of a command has its row, every stimulus its column. On one screen, on purpose.

A cell is `action -> the phases the command may be in afterwards`. An empty cell ("stale") is deliberate too: the
stimulus is late or doubled, it is counted and changes nothing. `broker.decision_unit` has one small function for
each action; `docs/decision_unit.md` is drawn from this table.
"""

from __future__ import annotations

from enum import StrEnum

from rtc.messages import Phase


class Stimulus(StrEnum):
    PRODUCT = "product"  # the job's worker delivered
    REFUSAL = "refusal"  # the job's worker refused
    AWAY = "away"  # the job could not be done: the world database, or every worker of the kind, is away
    LOSS = "loss"  # the job's worker died, hung or raised
    GRANT = "grant"  # all resources in its claim can be had
    RELEASE = "release"  # the command it was to come after has ended; those given before it are read
    REPORT = "report"  # the end report of its primitive
    STOP = "stop"  # HALT or ABORT reaches it
    PAUSE = "pause"
    RESUME = "resume"
    REST = "rest"  # a subsystem confirms rest for its halt
    OVERDUE = "overdue"  # its timer: no end report, or no confirmation of rest, within the limit
    GONE = "gone"  # the subsystem that executes for it is lost


S, P = Stimulus, Phase
STEP = "BINDING PAUSED ENDED"  # on to the next step, or a pause, or there is none
PLAN = "ELABORATING HELD ENDED"

_ROWS: dict[Phase, dict[Stimulus, str]] = {
    P.PARSING: {
        S.PRODUCT: f"parsed -> PARSING {PLAN} HALTING",
        S.RELEASE: f"take_up -> {PLAN}",
        S.REFUSAL: "refused -> ENDED",
        S.AWAY: "undone -> ENDED",
        S.LOSS: "again -> PARSING ENDED",
        S.STOP: "stop -> ENDED",
        S.PAUSE: "pause_later -> PARSING",
        S.RESUME: "resume_now -> PARSING",
    },
    P.ELABORATING: {
        S.PRODUCT: f"elaborated -> HELD {STEP}",
        S.REFUSAL: "refused -> ENDED",
        S.AWAY: "undone -> ENDED",
        S.LOSS: "again -> ELABORATING ENDED",
        S.STOP: "stop -> ENDED",
        S.PAUSE: "pause_later -> ELABORATING",
        S.RESUME: "resume_now -> ELABORATING",
    },
    P.HELD: {
        S.GRANT: "granted -> ELABORATING HELD ENDED",
        S.RELEASE: f"released -> {PLAN}",
        S.STOP: "stop -> ENDED",
        S.PAUSE: "pause_later -> HELD",
        S.RESUME: "resume_now -> HELD",
    },
    P.BINDING: {
        S.PRODUCT: f"bound -> EXECUTING ANALYZING CLOSING {STEP}",
        S.REFUSAL: "refused -> ENDED",
        S.AWAY: "undone -> ENDED",
        S.LOSS: "again -> BINDING ENDED",
        S.STOP: "stop -> ENDED",
        S.PAUSE: "pause_later -> BINDING",
        S.RESUME: "resume_now -> BINDING",
    },
    P.EXECUTING: {
        S.REPORT: "reported -> ANALYZING CLOSING",
        S.STOP: "stop_subsystem -> HALTING",
        S.PAUSE: "pause_later -> EXECUTING",
        S.RESUME: "resume_now -> EXECUTING",
        S.OVERDUE: "overdue -> HALTING",
        S.GONE: "lost_subsystem -> CLOSING",
    },
    P.ANALYZING: {
        S.PRODUCT: f"assessed -> {STEP}",
        S.REFUSAL: "refused -> ENDED",
        S.AWAY: "analyze_later -> ANALYZING ENDED",
        S.LOSS: "again -> ANALYZING ENDED",
        S.STOP: "stop_after_analysis -> CLOSING",
        S.PAUSE: "pause_later -> ANALYZING",
        S.RESUME: "resume_now -> ANALYZING",
        S.OVERDUE: "analyze_again -> ANALYZING",
    },
    P.PAUSED: {
        S.STOP: "stop -> ENDED",
        S.RESUME: "resume_paused -> BINDING ENDED",
    },
    P.HALTING: {
        S.REPORT: "rested -> CLOSING",
        S.REST: "rest_confirmed -> HALTING CLOSING ENDED",
        S.OVERDUE: "unconfirmed -> CLOSING ENDED",
        S.GONE: "lost_while_halting -> CLOSING ENDED",
    },
    P.CLOSING: {
        S.PRODUCT: "closed -> ENDED",
        S.REFUSAL: "closed -> ENDED",
        S.AWAY: "closed_untold -> ENDED",
        S.LOSS: "again -> CLOSING ENDED",
        S.OVERDUE: "closed_untold -> ENDED",
    },
    P.ENDED: {},
}


class Cell(tuple[str, frozenset[Phase]]):
    """(action, the phases that may follow)."""

    __slots__ = ()


def _cell(text: str) -> Cell:
    action, _, phases = text.partition(" -> ")
    return Cell((action, frozenset(Phase[name] for name in phases.split())))


TABLE: dict[tuple[Phase, Stimulus], Cell] = {
    (phase, stimulus): _cell(text) for phase, row in _ROWS.items() for stimulus, text in row.items()
}
assert set(_ROWS) == set(Phase), "every phase has its row"


def as_markdown() -> str:
    """The table for the docs: one row a phase, one column a stimulus."""
    head = "| phase | " + " | ".join(Stimulus) + " |"
    lines = [head, "|" + "---|" * (len(Stimulus) + 1)]
    for phase in Phase:
        cells = []
        for stimulus in Stimulus:
            cell = TABLE.get((phase, stimulus))
            cells.append(f"{cell[0]} → {', '.join(sorted(p.value for p in cell[1]))}" if cell else "stale")
        lines.append(f"| **{phase.value}** | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def as_mermaid() -> str:
    """The same as a state diagram; arrows between the same two phases are drawn once, with all their stimuli."""
    arrows: dict[tuple[Phase, Phase], list[str]] = {}
    for (phase, stimulus), (_, following) in TABLE.items():
        for after in sorted(following - {phase}):
            arrows.setdefault((phase, after), []).append(stimulus.value)
    lines = ["stateDiagram-v2", "    [*] --> parsing"]
    lines += [f"    {a.value} --> {b.value}: {', '.join(s)}" for (a, b), s in arrows.items()]
    return "\n".join([*lines, "    ended --> [*]"])


def as_page() -> str:
    return f"""# The Decision Unit

Drawn from `broker/transitions.py` by `python -m broker.transitions > docs/decision_unit.md`; a test compares.

`decide(state, event) -> effects` (`broker/decision_unit.py`) is pure: the time is a field of the event, and the same
events give the same effects. Every event that concerns a command becomes one of the stimuli below; the cell of the
command's phase names the action and the phases it may lead to. *stale* is deliberate: the stimulus is late or doubled,
it is counted and changes nothing.

```mermaid
{as_mermaid()}
```

{as_markdown()}

| stimulus | meaning |
|---|---|
| product, refusal, loss | the answer to the command's one pending job: done, refused, or its worker is gone |
| grant | all it claims can be had |
| release | the command it was to come after has ended, or begun; in *parsing*: what its client gave before is read |
| report | the end report of its primitive; rest: a subsystem confirms rest for its halt |
| stop | HALT or ABORT reaches it; pause and resume take effect between two steps |
| away | the job could not be done, and nobody is to blame: the world database, or every worker of the kind, is away |
| overdue | its timer: no end report, no rest, or no last analysis within the limit; in *analyzing*: time to try again |
| gone | the subsystem that executes for it is lost |

What has happened is never kept from the world. An analysis that finds the world database away is done again after a
second, for up to a minute; then the command ends *failed*. In *closing* the command ends as it was to end, after ten
seconds at most. In both cases what it touched stays closed for all (`rtc status`: quarantine: the world database)
until the world has been told after all (`broker/untold.py`).
"""


if __name__ == "__main__":
    print(as_page(), end="")
