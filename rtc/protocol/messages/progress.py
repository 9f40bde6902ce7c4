"""What happens to a command on its way: its phase, and notes of what was done and why it waits.

A note carries facts. `rtc.wording.notes` puts them in words.
"""

from __future__ import annotations

from enum import StrEnum

from rtc.protocol.messages.shared import Message
from rtc.protocol.outcomes import Compared, Measured, OutcomeKind, StopReason


class Phase(StrEnum):
    """Phase of a command. ENDED is final; HALTING and CLOSING lead only to ENDED."""

    PARSING = "parsing"
    REHEARSING = "rehearsing"  # a TEST sentence is performed on paper
    ELABORATING = "elaborating"
    HELD = "held"  # waits for its resources
    WAITING = "waiting"  # waits until another arm leaves the space that it needs
    BINDING = "binding"
    EXECUTING = "executing"
    ANALYZING = "analyzing"
    PAUSED = "paused"  # between two steps; in replies to queries also on the path of a motion
    HALTING = "halting"  # halted; waits until rest is confirmed
    CLOSING = "closing"  # a last analysis, whose advice is ignored; facts about what was touched become suspect
    ENDED = "ended"


class NoteKind(StrEnum):
    """What a note states. In brackets the fields of the note that belong to it."""

    PHASE = "phase"  # a new phase, and nothing else
    PARSED_BEFORE = "parsed_before"  # the same sentence was parsed before
    # Why it waits.
    IN_USE = "in_use"  # of `about`, a resource, by `owner`
    IN_USE_PAUSED = "in_use_paused"  # the same, and the owner is paused [clears]
    IN_USE_OPERATOR = "in_use_operator"  # the same, and the operator has `arm` for the owner [clears]
    AFTER = "after"  # waits until `owner` has succeeded
    TOGETHER = "together"  # waits until `owner` begins
    SURRENDERED = "surrendered"  # waits for the operator, who is asked to do what `owner` has failed to do [clears]
    ANSWERING = "answering"  # an answer of the operator to `owner`, on its way
    SPACE = "space"  # waits for the space of `arm`, which `owner` moves [message: what it would meet]
    # On its way.
    LOADING = "loading"  # the part of a program: `about`
    PLANNED = "planned"  # by the elaborator [message]
    PAUSED = "paused"  # between two steps
    BREAKPOINT = "breakpoint"  # paused before the step `about` [clears]
    MOTIONS_CHANGED = "motions_changed"  # another arm has begun to move meanwhile, so the step is planned again
    PLANNED_AGAIN = "planned_again"  # the step was stopped, or not started, beside another arm [message]
    BOUND = "bound"  # by the binder; it starts once the arms of `owner` have left its space [message, expected_s]
    ASSIGNED = "assigned"  # by the binder: values for later steps; nothing moves [message]
    STARTED = "started"  # by its subsystem
    STEP_ENDED = "step_ended"  # by its subsystem [reason, message, measured]
    JUDGED = "judged"  # by the analyzer, as expected [reason, message, found, drift, compared]
    TRIM = "trim"  # chosen by the analyzer [as before; trim, pieces]
    WILL_PAUSE_FIRST = "will_pause_first"  # before its first step
    WILL_PAUSE = "will_pause"  # before its next step
    SLOWS_DOWN = "slows_down"  # on its path, to pause there
    STANDS = "stands"  # on its path [value: part of its duration that is done]
    GOES_ON = "goes_on"  # along its path
    RESUMED = "resumed"
    REPORT = "report"  # of REPORT EVERY [measured]
    CONDITION = "condition"  # of REPORT WHEN [message: the condition; value, unit; measured]
    # What was done again.
    WORKER_LOST = "worker_lost"  # `about`, with its last words [message]; its job is done again
    ANALYSIS_AGAIN = "analysis_again"  # the world database is unavailable [message]
    PROGRAM_FAILED = "program_failed"  # `program`, of workers `about`; its job is done again with another [message]
    # How it ends.
    HALT = "halt"  # a HALT sentence, of the scope `about`
    STOPPING = "stopping"  # its motion is halted; `about`: the scope, if it was a halt [reason, message]
    AT_REST = "at_rest"  # confirmed [reason of the end report; none: its motion had not begun]
    NOT_AT_REST = "not_at_rest"  # rest was not confirmed in time [message]
    SUBSYSTEM_LOST = "subsystem_lost"  # [message]
    LAST_ANALYSIS = "last_analysis"  # the running analysis continues; its verdict is ignored [message]
    OUTCOME = "outcome"  # [outcome, message]
    JOURNAL_LOST = "journal_lost"  # of the broker, without a command [message]


class ProgressNote(Message, frozen=True, kw_only=True):
    """One event in the journey of a command; also one line of a trace."""

    seq: int  # number in the broker's event stream; 0: a report of EVERY or WHEN, outside that stream
    at_s: float
    command: str
    phase: Phase  # the phase it is in now
    kind: NoteKind = NoteKind.PHASE  # what has happened; the fields that belong to it stand there
    step: str = ""  # "5 of 9: feel GP1"
    node: str = ""  # process that did the work that just ended: "binder@2", "MCM"
    took_s: float = 0  # duration of that work, from dispatch to answer; 0, which is left out, not 0.0, which is not
    reason: StopReason | None = None  # with which a step has ended, or why the motion is stopped
    outcome: OutcomeKind | None = None
    message: str = ""  # of the process that did the work, for people
    found: str = ""  # what the analyzer has found in the report, for people
    drift: str = ""  # what has left its band although the step ended as expected, for people
    owner: str = ""  # the command that it waits for: "C-3"; of BOUND there may be several: "C-3, C-4"
    about: str = ""  # name of a resource, a scope, a worker, a breakpoint
    program: str = ""  # digest of one that has failed
    arm: str = ""
    clears: list[str] = []  # sentences, each of which ends the wait
    value: float | None = None  # in `unit`, which is SI
    unit: str = ""
    expected_s: float = 0  # planned duration of the current step; 0 = unknown
    measured: Measured | None = None  # what REPORT requests
    compared: Compared | None = None  # prediction and report of the step that was judged
    trim: int = 0  # entry of the trimming stack that was pushed
    pieces: list[str] = []  # its label, and those of the entries that follow it
    warning: bool = False  # needs a person's attention although the command continues

    def __repr__(self) -> str:
        about = f"({self.kind})" if self.kind is not NoteKind.PHASE else ""
        words = " ".join(filter(None, (self.command, self.phase.value, self.step, about)))
        return f"<ProgressNote {words}>"
