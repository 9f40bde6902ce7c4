"""The transition table of a command: for each phase and stimulus the action and the phases that may follow.

A cell holds a reference to the action, a function of `broker.decisions.nominal` or `broker.decisions.termination`,
and the phases the command
may be in afterwards. An empty cell ("stale") is deliberate: the stimulus is late or a duplicate. It is counted and
changes nothing. `docs/decision_unit.md` is drawn from this table.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from broker.decisions import nominal, termination
from broker.decisions.context import DecisionContext
from broker.decisions.events import Stimulus
from broker.decisions.state import Command
from rtc.protocol.messages import Phase

Action = Callable[[DecisionContext, Command, Any], None]


class Cell(NamedTuple):
    """What one stimulus does to a command in one phase."""

    action: Action
    following: frozenset[Phase]  # the phases that may follow; checked after the action


def cell(action: Action, *following: Phase) -> Cell:
    return Cell(action, frozenset(following))


S, P = Stimulus, Phase
STEP = (P.BINDING, P.PAUSED, P.ENDED)  # the next step is bound, or the command pauses, or no step is left
PLAN = (P.ELABORATING, P.HELD, P.ENDED)  # the resources are granted, or the command waits, or it is refused

_ROWS: dict[Phase, dict[Stimulus, Cell]] = {
    P.PARSING: {
        S.PRODUCT: cell(nominal.on_parsed, P.PARSING, *PLAN, P.HALTING),
        S.RELEASE: cell(nominal.take_up, *PLAN),
        S.REFUSAL: cell(termination.refuse, P.ENDED),
        S.UNAVAILABLE: cell(termination.fail_unavailable, P.ENDED),
        S.WORKER_LOST: cell(termination.retry_job, P.PARSING, P.ENDED),
        S.STOP: cell(termination.stop, P.ENDED),
        S.PAUSE: cell(nominal.request_pause, P.PARSING),
        S.RESUME: cell(nominal.withdraw_pause, P.PARSING),
    },
    P.ELABORATING: {
        S.PRODUCT: cell(nominal.on_elaborated, P.HELD, *STEP),
        S.REFUSAL: cell(termination.refuse, P.ENDED),
        S.UNAVAILABLE: cell(termination.fail_unavailable, P.ENDED),
        S.WORKER_LOST: cell(termination.retry_job, P.ELABORATING, P.ENDED),
        S.STOP: cell(termination.stop, P.ENDED),
        S.PAUSE: cell(nominal.request_pause, P.ELABORATING),
        S.RESUME: cell(nominal.withdraw_pause, P.ELABORATING),
    },
    P.HELD: {
        S.GRANT: cell(nominal.on_granted, P.ELABORATING, P.HELD, P.ENDED),
        S.RELEASE: cell(nominal.on_released, *PLAN),
        S.STOP: cell(termination.stop, P.ENDED),
        S.PAUSE: cell(nominal.request_pause, P.HELD),
        S.RESUME: cell(nominal.withdraw_pause, P.HELD),
    },
    P.BINDING: {
        S.PRODUCT: cell(nominal.on_bound, P.EXECUTING, P.ANALYZING, P.CLOSING, *STEP),
        S.REFUSAL: cell(termination.refuse, P.ENDED),
        S.UNAVAILABLE: cell(termination.fail_unavailable, P.ENDED),
        S.WORKER_LOST: cell(termination.retry_job, P.BINDING, P.ENDED),
        S.STOP: cell(termination.stop, P.ENDED),
        S.PAUSE: cell(nominal.request_pause, P.BINDING),
        S.RESUME: cell(nominal.withdraw_pause, P.BINDING),
    },
    P.EXECUTING: {
        S.REPORT: cell(nominal.on_reported, P.ANALYZING, P.CLOSING),
        S.STOP: cell(termination.stop_primitive, P.HALTING),
        S.PAUSE: cell(nominal.request_pause, P.EXECUTING),
        S.RESUME: cell(nominal.withdraw_pause, P.EXECUTING),
        S.TIMEOUT: cell(termination.stop_overdue, P.HALTING),
        S.SUBSYSTEM_LOST: cell(termination.on_subsystem_lost, P.CLOSING),
    },
    P.ANALYZING: {
        S.PRODUCT: cell(nominal.on_assessed, *STEP),
        S.REFUSAL: cell(termination.refuse, P.ENDED),
        S.UNAVAILABLE: cell(termination.schedule_analysis_retry, P.ANALYZING, P.ENDED),
        S.WORKER_LOST: cell(termination.retry_job, P.ANALYZING, P.ENDED),
        S.STOP: cell(termination.stop_after_analysis, P.CLOSING),
        S.PAUSE: cell(nominal.request_pause, P.ANALYZING),
        S.RESUME: cell(nominal.withdraw_pause, P.ANALYZING),
        S.TIMEOUT: cell(termination.retry_analysis, P.ANALYZING),
    },
    P.PAUSED: {
        S.STOP: cell(termination.stop, P.ENDED),
        S.RESUME: cell(nominal.resume, P.BINDING, P.ENDED),
    },
    P.HALTING: {
        S.REPORT: cell(termination.on_rested, P.CLOSING),
        S.REST: cell(termination.on_rest_confirmed, P.HALTING, P.CLOSING, P.ENDED),
        S.TIMEOUT: cell(termination.fail_unconfirmed, P.CLOSING, P.ENDED),
        S.SUBSYSTEM_LOST: cell(termination.on_lost_while_halting, P.CLOSING, P.ENDED),
    },
    P.CLOSING: {
        S.PRODUCT: cell(termination.finish_closing, P.ENDED),
        S.REFUSAL: cell(termination.finish_closing, P.ENDED),
        S.UNAVAILABLE: cell(termination.defer_closing_analysis, P.ENDED),
        S.WORKER_LOST: cell(termination.retry_job, P.CLOSING, P.ENDED),
        S.TIMEOUT: cell(termination.defer_closing_analysis, P.ENDED),
    },
    P.ENDED: {},
}


TABLE: dict[tuple[Phase, Stimulus], Cell] = {
    (phase, stimulus): cell for phase, row in _ROWS.items() for stimulus, cell in row.items()
}
assert set(_ROWS) == set(Phase), "every phase has its row"


def as_markdown() -> str:
    """The table for the docs: one row per phase, one column per stimulus."""
    head = "| phase | " + " | ".join(Stimulus) + " |"
    lines = [head, "|" + "---|" * (len(Stimulus) + 1)]
    for phase in Phase:
        words = [_in_words(TABLE.get((phase, stimulus))) for stimulus in Stimulus]
        lines.append(f"| **{phase.value}** | " + " | ".join(words) + " |")
    return "\n".join(lines)


def _in_words(cell: Cell | None) -> str:
    if cell is None:
        return "stale"
    return f"{cell.action.__name__} → {', '.join(sorted(phase.value for phase in cell.following))}"


def as_mermaid() -> str:
    """The same as a state diagram. Each pair of phases has one arrow, labelled with all its stimuli."""
    arrows: dict[tuple[Phase, Phase], list[str]] = {}
    for (phase, stimulus), cell in TABLE.items():
        for after in sorted(cell.following - {phase}):
            arrows.setdefault((phase, after), []).append(stimulus.value)
    lines = ["stateDiagram-v2", "    [*] --> parsing"]
    lines += [f"    {a.value} --> {b.value}: {', '.join(s)}" for (a, b), s in arrows.items()]
    return "\n".join([*lines, "    ended --> [*]"])


def as_page() -> str:
    return f"""# The Decision Unit

Drawn from `broker/decisions/transitions.py` by `python -m broker.decisions.transitions > docs/decision_unit.md`; a
test compares.

`decide(state, event) -> effects` (`broker/decisions/decide.py`) is pure: the time is a field of the event, and the same
events give the same effects. Every event that concerns a command becomes one of the stimuli below. The cell of the
command's phase names the action and the phases that may follow. *stale* is deliberate: the stimulus is late or a
duplicate. It is counted and changes nothing.

```mermaid
{as_mermaid()}
```

{as_markdown()}

| stimulus | meaning |
|---|---|
| product, refusal, worker_lost | the result of the command's one pending job: done, refused, or its worker is lost |
| unavailable | the job could not be done: the world database, or every worker of the kind, is unavailable |
| grant | all resources of its claim are free |
| release | the command it waits for has ended or begun; in *parsing*: the earlier commands of its client are parsed |
| report | the end report of its primitive |
| rest | a subsystem confirms rest for its halt |
| stop | a HALT or ABORT reaches it |
| pause, resume | they take effect between two steps |
| timeout | its time limit for an end report, for rest or for the last analysis; in *analyzing*: time for a retry |
| subsystem_lost | the subsystem that executes its primitive is lost |

Each change of the world is written in the end. An analysis that finds the world database unavailable is repeated every
second for up to a minute; then the command ends *failed*. In *closing* the command ends with its pending outcome after
ten seconds at most. In both cases the analysis is deferred: the touched names stay quarantined (`rtc status`:
quarantine: the world database) until the world database has the changes (`broker/decisions/deferred_analysis.py`).
"""


if __name__ == "__main__":
    print(as_page(), end="")
