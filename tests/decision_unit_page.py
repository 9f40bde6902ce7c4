"""The machines of the Decision Unit as a page: `python -m tests.decision_unit_page > docs/decision_unit.md`. Pure."""

from __future__ import annotations

from typing import Any

from broker.decisions.command.table import COMMAND
from broker.decisions.deferred_analysis import DEFERRED
from broker.decisions.halt_request import HALT
from broker.decisions.machine import Machine, TableCell
from broker.decisions.program_rollout import ROLLOUT
from broker.decisions.subsystem_link import LINK

MACHINES: dict[str, tuple[Machine[Any, Any], str]] = {
    "Command": (COMMAND, "broker/decisions/command/table.py"),
    "Deferred analysis": (DEFERRED, "broker/decisions/deferred_analysis.py"),
    "HALT request": (HALT, "broker/decisions/halt_request.py"),
    "Subsystem link": (LINK, "broker/decisions/subsystem_link.py"),
    "Program roll-out": (ROLLOUT, "broker/decisions/program_rollout.py"),
}
TEXT = {
    "Command": """
| stimulus | meaning |
|---|---|
| product, refusal, worker_lost | the result of the command's one pending job: done, refused, or its worker is lost |
| unavailable | the job could not be done: the world database, or every worker of the kind, is unavailable |
| grant | all resources of its claim are free |
| release, in *parsing* | the earlier commands of its client are parsed |
| release, in *held* | AFTER: the other command has ended. TOGETHER-WITH: it has begun to move, or has ended |
| space | the arm that it waits for has begun to move, has rested, or will not leave by itself |
| report | the end report of its primitive. *blocked*: the arm stands, and the step is planned again |
| rest | its subsystem confirms rest for the halt of its primitive |
| halt_settled | a HALT sentence only: rest is confirmed, or it is not |
| stop | a HALT or ABORT reaches it |
| pause, resume | in *executing* the subsystem pauses the motion on its path, if it can; else between two steps |
| timeout | its time limit for an end report, for rest or for the last analysis; in *analyzing*: time for a retry |
| subsystem_lost | a subsystem that it has used is lost |

A HALT sentence in its plain form needs no parser: it begins in *halting*.
""",
    "Deferred analysis": """
| stimulus | meaning |
|---|---|
| defer | its command ends before the analysis is done |
| done, refusal, worker_lost | the answer of the worker: its changes are written, it refuses, or it is lost |
| unavailable | the world database, or every analyzer, is unavailable |
| timeout | time for a retry |

An analysis waits up to 5 s for the world database. If it is still unavailable, the analysis is repeated 1 s later, for
up to a minute; then the command ends *failed*. In *closing* the command ends with its pending outcome after ten seconds
at most. In both cases the analysis is deferred: the touched names stay quarantined (`rtc status`: quarantine: the world
database) until the world database has the changes.

The analysis of a motion is given up (`give_up`, counter `analyses_given_up`) if the analyzer refuses it, or if it kills
three workers. This holds also before its command has ended. Its job then makes the facts about the touched names
suspect, and is retried every second until the world database has done that. Then the names are opened.
""",
    "HALT request": """
| stimulus | meaning |
|---|---|
| call | it arrives from a halt socket, or from a subsystem that received it at its own |
| sentence | it is a command: HALT, with a scope |
| rest, moving | a subsystem answers: all in scope is at rest, or something still moves |
| subsystem_lost | a subsystem is lost |
| timeout | its time limit for rest |

The router sends each confirmation to the caller at a socket, which waits with a time limit of its own. A HALT sentence
is a command: in *awaiting_rest* it is *halting*, and it ends when its request is *settled*. The halt of a command's own
primitive is a part of that command's machine.
""",
    "Subsystem link": """
| stimulus | meaning |
|---|---|
| hello | the process connects: the one known so far, or the first one |
| new_process | another process connects in place of the one known so far |
| gone | the connection is lost, or the process has ended |

A subsystem executes its primitives and stops by itself without the broker. The broker learns at each hello which ones
it still has. *lost* ends every command that has used the subsystem.
""",
    "Program roll-out": """
| stimulus | meaning |
|---|---|
| install | a program is loaded; the default programs are loaded when a cluster starts |
| job_done, job_failed | a job that used the newest program was done, or failed |

One per kind of worker. `rtc status` shows why a program was rolled back until the next one is loaded.
""",
}


def as_markdown(machine: Machine[Any, Any]) -> str:
    """The table: one row per state, one column per stimulus; a number refers to the reasons below it."""
    reasons: dict[str, int] = {}
    stimuli = list(machine.stimuli.__members__.values())
    head = "| state | " + " | ".join(stimuli) + " |"
    lines = [head, "|" + "---|" * (len(stimuli) + 1)]
    for state in machine.states:
        row = []
        for stimulus in stimuli:
            cell = machine.cells.get((state, stimulus))
            if cell is not None:
                row.append(in_words(cell))
            else:
                reason = machine.ignored[state, stimulus]
                row.append(f"*{reasons.setdefault(reason, len(reasons) + 1)}*")
        lines.append(f"| **{state.value}** | " + " | ".join(row) + " |")
    lines += ["", "Ignored, because:", ""]
    lines += [f"{n}. {reason}" for reason, n in reasons.items()]
    return "\n".join(lines)


def in_words(cell: TableCell[Any]) -> str:
    return f"{cell.action.__name__} → {', '.join(sorted(state.value for state in cell.following))}"


def as_mermaid(machine: Machine[Any, Any]) -> str:
    """The same as a state diagram. Each pair of states has one arrow, labelled with all its stimuli."""
    arrows: dict[tuple[Any, Any], list[str]] = {}
    for (state, stimulus), cell in machine.cells.items():
        for after in sorted(cell.following - {state}):
            arrows.setdefault((state, after), []).append(stimulus.value)
    lines = ["stateDiagram-v2", f"    [*] --> {machine.first.value}"]
    lines += [f"    {a.value} --> {b.value}: {', '.join(s)}" for (a, b), s in arrows.items()]
    leaving = {state for state, _ in arrows}
    final = [state for state in machine.states if state not in leaving]
    return "\n".join([*lines, *(f"    {state.value} --> [*]" for state in final)])


def as_page() -> str:
    return "\n".join([INTRODUCTION, *(_section(name) for name in MACHINES)])


def _section(name: str) -> str:
    machine, path = MACHINES[name]
    return f"""## {name}

Table: `{path}`.

```mermaid
{as_mermaid(machine)}
```

{as_markdown(machine)}
{TEXT[name]}"""


INTRODUCTION = """# The Decision Unit

Drawn from the tables of `broker/decisions/` by `python -m tests.decision_unit_page > docs/decision_unit.md`; a test
compares.

`decide(state, event) -> effects` (`broker/decisions/decide.py`) is pure: the time is a field of the event, and the same
events give the same effects. Each event becomes a stimulus of a machine. The cell of its present state names the action
and the states that may follow; they are checked after the action. A number means: this stimulus changes nothing; the
reason is below. `rtc status` counts such stimuli of commands as *stale*.
"""

if __name__ == "__main__":
    print(as_page(), end="")
