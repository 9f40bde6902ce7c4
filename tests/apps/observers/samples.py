"""Messages of a short run, made by hand: C-1 stows an arm, C-2 is refused."""

from __future__ import annotations

from rtc.apps.observers.feed import Received
from rtc.protocol import messages as m
from rtc.protocol.advice import by_person
from rtc.protocol.messages import NoteKind, Phase
from rtc.protocol.outcomes import Outcome, OutcomeKind, Refusal, RefusalReason, StopReason

T0 = 1000.0  # s, CLOCK_MONOTONIC
STEP = "1 of 1: stow LEFT-ARM"


def note(seq: int, at_s: float, phase: Phase, command: str = "C-1", **more: object) -> m.ProgressNote:
    return m.ProgressNote(seq=seq, at_s=T0 + at_s, command=command, phase=phase, **more)


def ended(seq: int, at_s: float, outcome: Outcome, command: str = "C-1", text: str = "STOW LEFT-ARM", **more: object):
    took_s = more.pop("took_s", at_s)
    return m.CommandEnded(
        seq=seq, at_s=T0 + at_s, command=command, request=f"r-{command}", text=text, outcome=outcome, took_s=took_s
    )


def telemetry(at_s: float, joint: float) -> m.Telemetry:
    arms = {
        name: m.ArmSample(
            joints=[joint, 0.1, 0.2, 0.3, 0.4, 0.5],
            velocities=[0.0] * 6,
            wrench=[0.0] * 6,
            tcp_pose=[0.0] * 6 + [1.0],
            hand_width_m=0.04,
            primitive="",
        )
        for name in ("RIGHT-ARM", "LEFT-ARM")
    }
    return m.Telemetry(subsystem="MCM", at_s=T0 + at_s, sim_s=at_s, late_ticks=0, ticks=1, arms=arms)


SUCCEEDED = Outcome(kind=OutcomeKind.SUCCEEDED, steps_done=1)
REFUSED = Outcome(
    kind=OutcomeKind.REFUSED,
    message="GRAPS is not a verb",
    refusal=Refusal(reason=RefusalReason.SENTENCE, message="GRAPS is not a verb", nearest=["GRASP"]),
)
ENDED = {"kind": NoteKind.STEP_ENDED, "reason": StopReason.GOAL}
DONE = {"kind": NoteKind.OUTCOME, "outcome": OutcomeKind.SUCCEEDED}
STOWED = (
    note(1, 0.0, Phase.PARSING),
    note(2, 0.01, Phase.ELABORATING, node="parser@0", took_s=0.01),
    note(3, 0.03, Phase.BINDING, step=STEP, node="elaborator@1", took_s=0.02),
    note(4, 0.04, Phase.EXECUTING, step=STEP, node="binder@2", took_s=0.01),
    note(5, 1.04, Phase.ANALYZING, step=STEP, node="MCM", took_s=1.0, **ENDED),
    note(
        6,
        1.05,
        Phase.ENDED,
        step=STEP,
        node="analyzer@3",
        took_s=0.01,
        kind=NoteKind.OUTCOME,
        outcome=OutcomeKind.SUCCEEDED,
    ),
    ended(7, 1.05, SUCCEEDED),
    note(8, 1.2, Phase.PARSING, "C-2"),
    note(9, 1.21, Phase.ENDED, "C-2", kind=NoteKind.OUTCOME, outcome=OutcomeKind.REFUSED, node="parser@0", took_s=0.01),
    ended(10, 1.21, REFUSED, "C-2", "GRAPS", took_s=0.01),
)


DECLINED = m.RequestRefused(
    at_s=T0 + 1.3,
    request="r-9",
    refusal=Refusal(reason=RefusalReason.STATE, message="the cluster is being stopped", clears=by_person("rtc up")),
    text="STOW RIGHT-ARM",
)
HALTED = m.HaltRequested(at_s=T0 + 1.4, halt="H-1", scope="ALL", called_at_s=T0 + 1.39)


def received(message: object) -> Received:
    return Received(getattr(message, "at_s", T0), message, b"x" if not isinstance(message, m.Telemetry) else b"")
