"""The result of a hypothesis test: what a sentence is expected to do, on which facts that rests, and what would help.

A rehearsal performs the sentence on paper. Poses are [x y z qx qy qz qw] (m, world axes) of a tcp; times are those of
the arms. Stop reasons and validities are the values of `StopReason` and `Validity`.
"""

from __future__ import annotations

from typing import Any

import msgspec

from rtc.protocol.advice import Advice


class RehearsedStep(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One step that was bound on paper, with its predicted end."""

    label: str
    performer: str = ""  # arm or camera; empty: nothing moves
    reason: str = ""  # stop reason that it is expected to end with
    predicted_s: float = 0.0
    until_stopped: bool = False  # nothing but its time limit or a halt ends it; `predicted_s` is 0
    tcp_pose: list[float] = []  # at its end
    carried_kg: float | None = None  # mass in the hand while it moves
    grip_n: float | None = None  # force with which the fingers press
    press_n: float | None = None  # force set-point of a compliant motion
    stops_at_n: float | None = None  # wrist force at which it is stopped
    note: str = ""
    trim: int = 0  # it is of this entry of the trimming stack; 0: of the script


class PredictedFact(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A fact that the sentence is expected to leave."""

    key: str
    value: Any
    validity: str
    # How far the fact may be from the predicted one. What is sensed on the way may be found anywhere that was possible
    # before it; after the sentence it is known better than this.
    spread: list[float] | None = None


class FaultBranch(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What follows if a step ends with another stop reason than expected."""

    step: str
    reason: str
    trims: list[str] = []  # that were tried on paper, in order
    recovered: bool = False
    message: str = ""  # how it ends without a recovery
    clears: Advice = []


class Repair(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Sentences whose rehearsal is feasible in place of a refused one, to be given in this order."""

    sentences: list[str]
    changes: str  # what is different, in words
    predicted_s: float


class Rehearsal(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The rehearsal of one sentence. If it is not feasible, the outcome's `refusal` and `step` say where and why."""

    digest: str = ""  # of this sentence and those rehearsed before it, and of all facts and programs they rest on
    script: str = ""
    steps: list[RehearsedStep] = []
    predicted_s: float = 0.0  # of all steps that have an end of their own
    ends: dict[str, list[float]] = {}  # arm -> predicted tcp pose after the sentence
    holding: dict[str, str] = {}  # arm -> object predicted in its hand; empty text: none
    resources: list[str] = []
    in_use: dict[str, str] = {}  # those that a live command holds now -> its number
    relies_on: dict[str, int] = {}  # fact of the world database -> its version; 0: it does not exist
    foreseen: list[str] = []  # facts read as the sentences before are predicted to leave them
    remark: str = ""  # what its result would state: that another kind of motion is taken, say
    assumes: list[str] = []  # what only sensing can tell, in words
    changes: list[PredictedFact] = []
    faults: list[FaultBranch] = []  # only those asked for
    repairs: list[Repair] = []  # of an infeasible sentence
