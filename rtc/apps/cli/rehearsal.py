"""rtc test: what sentences would do, on paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli import sentence_files
from rtc.apps.cli.output import AsJson, RunDir, With, cli_error, console, emit_json, exit_code, exits_with
from rtc.apps.cli.sentence_files import SentenceLine
from rtc.client.client import Client
from rtc.client.rehearsing import digest_of, rehearse
from rtc.client.session import as_text
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.rehearsal import Rehearsal
from rtc.wording.refusals import refusal_lines
from rtc.wording.rehearsals import in_lines
from rtc.wording.sentences import quoted


def test(
    sentences: Annotated[list[str] | None, typer.Argument(help="Sentences in quotes, or files of sentences.")] = None,
    faults: Annotated[bool, typer.Option("--faults", help="Also each other end of each step, with its trims.")] = False,
    keep_going: Annotated[bool, typer.Option("--keep-going", "-k", help="Go on without one that fails.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Show all steps and all facts.")] = False,
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Test sentences on paper: nothing moves, and nothing is written.

    Each sentence is planned in the world as those before it are predicted to leave it. The answer: feasible, or which
    step is not and why, with sentences that were tested and would do; the predicted time and end; the facts that it
    rests on; and a digest. `rtc do --if-tested DIGEST` then refuses a sentence if one of these facts has changed.

    Exit status: 0 all feasible, 2 one is not, 4 no cluster.

    Example:  rtc test "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A" "LIFT MACS-NEW BY 15 CM"
    Example:  rtc test plan.txt --faults
    """
    lines = [line for argument in sentences or [] for line in _lines(argument)]
    if not lines:
        raise cli_error("no sentence; give one in quotes, or a file of them", 2)
    texts = [line.text for line in lines]
    with Client(run_dir, key=key) as rtc:
        ended = rehearse(
            rtc,
            texts,
            [line.label for line in lines],
            faults=faults,
            keep_going=keep_going,
            on_end=None if json else lambda n, one: _show(lines[n], one, verbose or len(lines) == 1),
        )
    code = exit_code([one.outcome.kind for one in ended])
    report = _report(lines, ended, code)
    if json:
        with exits_with(code):
            emit_json(report)
    else:
        _show_all(report, lines, ended)
    raise typer.Exit(code)


def _lines(argument: str) -> list[SentenceLine]:
    """A sentence, or those of a file."""
    path = Path(argument)
    if argument == "-" or (" " not in argument.strip() and path.is_file()):
        return sentence_files.read(path)
    return [SentenceLine("", as_text(argument))] if argument.strip() else []


def _report(lines: Sequence[SentenceLine], ended: Sequence[m.CommandEnded], code: int) -> dict[str, Any]:
    results = [_result(line, one) for line, one in zip(lines, ended, strict=False)]
    results += [{"label": line.label, "text": line.text, "kind": "not_tested"} for line in lines[len(ended) :]]
    rehearsals = [one.outcome.rehearsal for one in ended if one.outcome.rehearsal is not None]
    return {
        "feasible": code == 0 and len(ended) == len(lines),
        "digest": digest_of(ended, [line.text for line in lines]),
        "predicted_s": sum(one.predicted_s for one in rehearsals),
        "relies_on": {key: version for one in rehearsals for key, version in one.relies_on.items()},
        "results": results,
        "exit": code,
    }


def _result(line: SentenceLine, ended: m.CommandEnded) -> dict[str, Any]:
    outcome: dict[str, Any] = msgspec.to_builtins(ended.outcome)
    feasible = ended.outcome.kind is OutcomeKind.SUCCEEDED
    return {"label": line.label, "text": line.text, "command": ended.command, "feasible": feasible, **outcome}


# --- for people --------------------------------------------------------------------------------------------


def _show(line: SentenceLine, ended: m.CommandEnded, full: bool) -> None:
    outcome, rehearsal = ended.outcome, ended.outcome.rehearsal or Rehearsal()
    feasible = outcome.kind is OutcomeKind.SUCCEEDED
    head = Text(f"{line.label:<5}" if line.label else "")
    head.append(f"{'feasible' if feasible else 'NOT FEASIBLE':<12} ", style="green" if feasible else "bold red")
    head.append(f"{rehearsal.predicted_s:6.1f} s  {quoted(line.text)}")
    head.append(f": {rehearsal.remark}" if rehearsal.remark else "")
    console.print(head)
    if not feasible:
        refusal = outcome.refusal
        words = refusal_lines(refusal, ended.text) if refusal is not None else [outcome.message]
        for words_of in [*words, *([f"in step {outcome.step}"] if outcome.step else [])]:
            console.print(Text(f"       {words_of}"))
    for words_of in in_lines(rehearsal, full=full):
        console.print(Text(f"       {words_of}"))


def _show_all(report: dict[str, Any], lines: Sequence[SentenceLine], ended: Sequence[m.CommandEnded]) -> None:
    feasible = sum(one.outcome.kind is OutcomeKind.SUCCEEDED for one in ended)
    left = len(lines) - len(ended)
    words = f"{feasible} of {len(lines)} feasible" + (f", {left} not tested (-k goes on)" if left else "")
    words += f"; about {report['predicted_s']:.0f} s in all"
    console.print(Text(words))
    if report["digest"]:
        console.print(Text(f"digest {report['digest']}: rtc do --if-tested {report['digest']} ..."))
