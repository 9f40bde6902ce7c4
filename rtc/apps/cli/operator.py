"""rtc operator: what the operator is asked to do, and his answer."""

from __future__ import annotations

from typing import Annotated

import typer

from rtc.apps.cli.output import EXIT, AsJson, RunDir, cli_error, console, emit_json
from rtc.client.client import Client
from rtc.protocol.messages import ArmSample, Operation
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.units import in_words

MEASURED_S = 1.0  # maximum wait for a telemetry sample


def operator(
    done: Annotated[bool, typer.Option("--done", help="You have done it: the same as the sentence DONE.")] = False,
    cannot: Annotated[str, typer.Option("--cannot", help="You cannot do it, for this reason.")] = "",
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Show what the operator is asked to do with each arm, or answer it. `rtc jog` moves the arm.

    DONE is believed only when the measurements prove it; otherwise the refusal states what is missing.

    Example:  rtc operator
    Example:  rtc operator --done
    Example:  rtc operator --cannot "the bolt head is stripped"
    """
    if done and cannot:
        raise cli_error("one answer at a time: --done or --cannot", 2)
    with Client(run_dir) as rtc:
        if done or cannot:
            _answer(rtc, "DONE" if done else f'CANNOT "{cannot.replace(chr(34), chr(39))}"')
        sample = next(rtc.telemetry(silence_s=MEASURED_S), None)
        asked = {name: arm for name, arm in (sample.arms if sample else {}).items() if arm.operation is not None}
        if json:
            emit_json(asked)
            return
        for name, arm in asked.items():
            _show(name, arm)
        if not asked:
            console.print("the operator is asked for nothing now")


def _answer(rtc: Client, sentence: str) -> None:
    outcome = rtc.run(sentence).outcome
    if outcome.kind is not OutcomeKind.SUCCEEDED:
        clears = f" ({outcome.refusal.clears})" if outcome.refusal is not None else ""
        raise cli_error(outcome.message + clears, EXIT[outcome.kind])
    console.print(outcome.message)


def _show(name: str, arm: ArmSample) -> None:
    operation = arm.operation
    assert operation is not None
    his = [name, *(part for part, is_his in (("hand", operation.hand), ("spindle", operation.spindle)) if is_his)]
    console.print(f"{arm.primitive}: {operation.request}")
    console.print(f"  yours: {', '.join(his)}{_distance(operation)}")
    force_n = sum(x * x for x in arm.wrench[:3]) ** 0.5
    console.print(f"  force {force_n:.1f} N, hand {in_words(round(arm.hand_width_m, 4), 'm')} open")
    for words in filter(None, (operation.operator and f"moved by {operation.operator}", operation.cut)):
        console.print(f"  {words}")


def _distance(operation: Operation) -> str:
    if operation.off_m is None:
        return ""
    near = f"; {in_words(operation.done_m, 'm')} is near enough" if operation.done_m is not None else ""
    return f"; {in_words(round(operation.off_m, 3), 'm')} from the goal{near}"
