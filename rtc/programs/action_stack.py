"""The Action_Stack of one command: the steps still to do, the values of its variables, and the trims used (R94). Pure.

The broker runs every command from it; the test bench and the benchmarks run the workers from it in memory. It needs no
more of a script than `ScriptLike` states, so steps and values may be encoded bytes (the broker) or typed (the others).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar, cast

import msgspec

from rtc.protocol.messages import AnalyzerInput, BinderInput

NOMINAL = 0  # stands for the script's own steps in the place of a trim number
MAX_TRIMS = 6  # maximum number of trims per command (A17); a trim that gives up is allowed above it

StepRef = tuple[int, int]  # (NOMINAL or number of a trim, index of the step in it)


class TrimLike(Protocol):
    """One entry of the trimming stack."""

    @property
    def n(self) -> int: ...
    @property
    def label(self) -> str: ...
    @property
    def steps(self) -> Sequence[Any]: ...
    @property
    def then(self) -> str: ...


class ScriptLike(Protocol):
    """A plan of the elaborator: `rtc.protocol.messages.Script`, or the head of one."""

    @property
    def context(self) -> Any: ...
    @property
    def steps(self) -> Sequence[Any]: ...
    @property
    def trims(self) -> Sequence[TrimLike]: ...
    @property
    def bindings(self) -> dict[str, Any]: ...


ScriptT = TypeVar("ScriptT", bound=ScriptLike)
ValueT = TypeVar("ValueT")


class ActionStack(msgspec.Struct, Generic[ScriptT, ValueT], kw_only=True, omit_defaults=True, gc=False):
    """The paper's main loop: pop a step, bind it, execute it, assess it, and push a trim if the assessment asks."""

    script: ScriptT
    """The plan that the steps and trims come from."""
    refs: list[StepRef] = []
    """The steps still to do; the last element is the next step."""
    step: StepRef | None = None
    """The step that was popped last: it is bound, executed or assessed now. None before the first step."""
    bindings: dict[str, ValueT] = {}
    """The variables of the script with their present values."""
    trims_used: dict[str, list[int]] = {}
    """Step, as "trim/index" -> numbers of the trims already used for it; each is used once per step."""
    trim_labels: tuple[str, ...] = ()
    """Labels of all trims used, in order; for the outcome."""
    moved_s: float = 0.0
    """Duration of all primitives so far, in the time of the arms: it counts against the time limit of the command."""

    def restart(self) -> None:
        """Put all nominal steps on the stack, with the values that the script begins with."""
        self.refs, self.bindings = _nominal(self.script), self.script.bindings

    def pop(self) -> None:
        """Make the next step the current one. The stack must not be empty."""
        self.step = self.refs.pop()

    def put_back(self) -> None:
        """Make the current step the next one again."""
        assert self.step is not None
        self.refs.append(self.step)

    def assign(self, values: Mapping[str, ValueT]) -> None:
        """Set variables. The script and earlier payloads keep their values."""
        if values:
            self.bindings = {**self.bindings, **values}

    @property
    def step_body(self) -> Any:
        """The current step, as the elaborator made it."""
        assert self.step is not None
        trim, index = self.step
        if trim == NOMINAL:
            return self.script.steps[index]
        return self.trim(trim).steps[index]

    def trim(self, n: int) -> TrimLike:
        """The trim with this number. Raises StopIteration if the script has none."""
        return next(trim for trim in self.script.trims if trim.n == n)

    def push_trim(self, n: int, further: Sequence[int] = ()) -> TrimLike | None:
        """Push the steps of a trim for the current step, and those of `further` trims after it; the last trim,
        which decides what follows (paper, trimming stack; A16, A17).

        None: a trim is not in the script, was used for this step before, or MAX_TRIMS are used. Then the command has
        failed. After a trim that gives up, the command fails when the stack is empty."""
        assert self.step is not None
        numbers = [n, *further]
        known = {trim.n: trim for trim in self.script.trims}
        used = self.trims_used.setdefault(self._step_key, [])
        if not {*numbers} <= known.keys() - {*used} or len({*numbers}) < len(numbers):
            return None
        trims, then = [known[number] for number in numbers], known[numbers[-1]].then
        if len(self.trim_labels) + len(trims) > MAX_TRIMS and then != "give_up":
            return None
        used += numbers
        self.trim_labels += tuple(trim.label for trim in trims)
        if then == "retry_step":
            self.refs.append(self.step)
        elif then == "restart_script":
            self.restart()
        elif then in ("replace_rest", "give_up"):
            self.refs = []
        steps = [(trim.n, index) for trim in trims for index in range(len(trim.steps))]
        self.refs += reversed(steps)
        return trims[-1]

    def binder_input(self, primitive_id: str) -> BinderInput:
        """The input of a binder for the current step."""
        return BinderInput(
            primitive_id=primitive_id,
            context=self.script.context,
            step=self.step_body,
            bindings=cast(dict[str, Any], self.bindings),
            moved_s=self.moved_s,
        )

    def analyzer_input(self, evaluation: Any, report: Any) -> AnalyzerInput:
        """The input of an analyzer for the current step."""
        used = self.trims_used.get(self._step_key, []) if self.trims_used else []
        return AnalyzerInput(evaluation=evaluation, report=report, trims_used=used)

    @property
    def _step_key(self) -> str:
        assert self.step is not None
        return f"{self.step[0]}/{self.step[1]}"


def begin(script: ScriptT) -> ActionStack[ScriptT, Any]:
    """The Action_Stack of a new command: all nominal steps, none done."""
    return ActionStack(script=script, refs=_nominal(script), bindings=script.bindings)


def _nominal(script: ScriptLike) -> list[StepRef]:
    return [(NOMINAL, index) for index in reversed(range(len(script.steps)))]
