"""rtc do: submits sentences, shows their progress and one result for each, and handles Ctrl-C."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli import sentence_files
from rtc.apps.cli.halt import halt_by, print_halt
from rtc.apps.cli.long_steps import LongSteps
from rtc.apps.cli.output import (
    LEFT_RUNNING,
    AsJson,
    RunDir,
    With,
    cli_error,
    console,
    emit_json,
    errors,
    exit_code,
    exits_with,
)
from rtc.apps.cli.progress import Board
from rtc.apps.cli.sentence_files import Labels, SentenceLine
from rtc.apps.cli.sentence_program import SentenceProgram
from rtc.apps.cli.stdio import OutputClosed
from rtc.apps.cli.trace import recall
from rtc.client.client import Client
from rtc.client.session import Source, as_text
from rtc.language.fastpath import halt_scope
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind, RequestDeclined
from rtc.wording import notes as wording
from rtc.wording.advice import in_words
from rtc.wording.refusals import refusal_lines
from rtc.wording.sentences import quoted

HALTED = (OutcomeKind.HALTED, OutcomeKind.HALT_NOT_CONFIRMED)  # after these the rest of a program is not sent


class LeftRunning(Exception):
    """The operator chose to leave commands running."""


class Signalled(Exception):
    """SIGTERM or SIGHUP: this process ends, its commands continue."""

    def __init__(self, number: int) -> None:
        self.exit_code = 128 + number  # as in shells
        super().__init__(f"ended by {signal.Signals(number).name}")


def do(
    sentences: Annotated[list[str] | None, typer.Argument(help="Sentences, each in quotes.")] = None,
    file: Annotated[Path | None, typer.Option(help="Read sentences from a file, one a line; - is stdin.")] = None,
    parallel: Annotated[bool, typer.Option("--parallel", help="Send all at once.")] = False,
    keep_going: Annotated[
        bool, typer.Option("--keep-going", "-k", help="Go on after one that fails, not after a halt.")
    ] = False,
    no_wait: Annotated[bool, typer.Option("--no-wait", help="Return once they are accepted.")] = False,
    if_tested: Annotated[
        str, typer.Option(metavar="DIGEST", help="Only as `rtc test` found it: refuse what is stale.")
    ] = "",
    advice: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Follow advice N of the last command, or of the one named.")
    ] = None,
    source: Annotated[str, typer.Option("--as", help="operator, or aip (differs in records only).")] = "operator",
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Submit sentences, show their progress and one result for each.

    They run one after the other, until one does not succeed (-k continues, except after a halt). With --parallel all
    are sent at once, and the cluster decides which can run at the same time. A file has one sentence a line, comments
    (# or --), and labels: after `C3: LOCATE DOOR-2`, AFTER C3 in a later line names its command.

    Exit status: 0 all succeeded, 1 a failure, 2 a refusal, 3 halted, 4 no cluster, 130 left running. Ctrl-C asks: leave
    them running, or halt. If stdout is closed (`| head`) or full, or this process gets SIGTERM (exit status 143) or
    SIGHUP (129), they are left running, and stderr names them.

    Example:  rtc do "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A" "LIFT MACS-NEW BY 5 CM"
    Example:  rtc do --file plan.txt --parallel
    Example:  rtc do --advice 1
    """
    if advice is not None:
        if file is not None or len(sentences or []) > 1:
            raise cli_error("--advice takes the number of one command at most, and no file: rtc do --advice 1 C-12", 2)
        if parallel:
            raise cli_error("--advice performs its sentences in their order; leave out --parallel", 2)
        record, _ = recall(sentences[0] if sentences else "", False, run_dir, key)
        sentences = advised(record, advice)
    lines = _program(sentences or [], file)
    texts = [line.text for line in lines]
    if not all(text.strip() for text in texts) or not texts:
        raise cli_error("no sentence; give one in quotes; rtc dictionary VERB shows examples", 2)
    if source not in ("operator", "aip"):
        raise cli_error(f"--as is operator or aip, not {source}", 2)
    if not (parallel or no_wait) and (problem := sentence_files.never_sent(lines)):
        raise cli_error(problem, 2)
    halts = [halt_scope(text) for text in texts]
    need_broker = not all(halts)
    with Client(run_dir, source=_source(source), need_broker=need_broker, on_silence=show_silence, key=key) as rtc:
        if no_wait:
            code, results = hand_in(rtc, lines, json, if_tested)
        else:
            code, results = _see_through(rtc, lines, parallel and not any(halts), keep_going, json, if_tested)
    if hint := quotes_forgotten(texts, results):
        errors.print(Text(hint))
    if json:
        with exits_with(code):
            emit_json({"results": results, "exit": code})
    raise typer.Exit(code)


def quotes_forgotten(texts: list[str], results: list[dict[str, Any]]) -> str:
    """A hint if several refused single words were probably meant as one sentence; otherwise empty."""
    words = [text for text in texts if len(text.split()) == 1]
    if len(words) < 2 or all(one["kind"] != "refused" or one["text"] not in words for one in results):
        return ""
    return f'each argument is a sentence; put one of several words in quotes: rtc do "{quoted(" ".join(words))}"'


def advised(record: m.CommandRecord, n: int) -> list[str]:
    """The sentences of alternative `n` of what `rtc why` shows. Raises typer.Exit, with the reason printed."""
    advice = record.outcome.refusal.clears if record.outcome and record.outcome.refusal else []
    if n > len(advice):
        raise cli_error(f"{record.command} has no advice {n}; rtc why {record.command} shows what it has", 2)
    one = advice[n - 1]
    texts = [*one.sentences, *([record.text] if one.again else [])]
    if one.states or not texts:
        raise cli_error(f"this is for a person to do: {in_words(one)}", 2)
    return texts


def _see_through(
    rtc: Client, lines: list[SentenceLine], parallel: bool, keep_going: bool, json: bool, if_tested: str
) -> tuple[int, list[dict[str, Any]]]:
    """Run all sentences; the exit status and a result for each."""
    kinds: list[OutcomeKind] = []
    results: list[dict[str, Any]] = []
    board = Board([line.text for line in lines], [line.label for line in lines], quiet=json)
    program = SentenceProgram(rtc, board, lines, if_tested)
    try:
        with board, asked_on_interrupt(rtc, board):
            if parallel:
                ended = program.run(range(len(lines)))
                kinds = [one.outcome.kind for one in ended]
                results = [_result(one, line, board) for one, line in zip(ended, lines, strict=True)]
            else:
                for n in range(len(lines)):
                    kind, result = _one(rtc, program, n)
                    kinds.append(kind)
                    results.append(result)
                    if kind in HALTED or (kind != OutcomeKind.SUCCEEDED and not keep_going):
                        break
    except LeftRunning:
        console.print("left running; `rtc status` shows them, `rtc halt` stops them")
        return LEFT_RUNNING, results
    except (OutputClosed, Signalled) as gone:
        return gone_away(gone, board, len(lines)), results
    why = "after a halt no further sentence is sent" if kinds[-1] in HALTED else "use -k to go on"
    _leave_out(lines[len(results) :], results, why, quiet=json)
    return exit_code(kinds), results


def _leave_out(lines: list[SentenceLine], results: list[dict[str, Any]], why: str, *, quiet: bool) -> None:
    """Show the sentences that are not sent, and add them to the results."""
    for line in lines:
        results.append({"text": line.text, **_label(line), "kind": "not_sent"})
        if not quiet:
            words = Text(f"  {quoted(line.text)}  ") + Text(f"({why})", style="dim")
            console.print(Text("NOT SENT", style="bold") + words)


def gone_away(why: OutputClosed | Signalled, board: Board, sentences: int) -> int:
    """Print on stderr which commands continue after the end of this process. Returns the exit status."""
    running, others = board.running, sentences - len(board.running) - len(board.kinds)
    parts = [str(why)]
    if running:
        parts.append(f"left running: {', '.join(running)}; rtc halt {running[0] if len(running) == 1 else ''}".rstrip())
    if others:
        parts.append(f"not known, or not sent: {others} more; rtc status")
    errors.print(Text(f"rtc: {'; '.join(parts)}"))
    if isinstance(why, Signalled):
        return why.exit_code
    if running:
        return LEFT_RUNNING
    return exit_code(board.kinds) or int(others > 0)


def _one(rtc: Client, program: SentenceProgram, n: int) -> tuple[OutcomeKind, dict[str, Any]]:
    line, board = program.lines[n], program.board
    if scope := halt_scope(text := program.text(n)):
        program.name(n, "")
        halted = halt_by(rtc, scope, errors if board.quiet else console)
        kind = OutcomeKind.SUCCEEDED if halted.confirmed else OutcomeKind.HALT_NOT_CONFIRMED
        return kind, {"text": text, **_label(line), "kind": kind.value, "halt": msgspec.to_builtins(halted)}
    (ended,) = program.run([n])
    return ended.outcome.kind, _result(ended, line, board)


def hand_in(rtc: Client, lines: list[SentenceLine], json: bool, if_tested: str) -> tuple[int, list[dict[str, Any]]]:
    """Submit without waiting for outcomes."""
    results: list[dict[str, Any]] = []
    out, labels = console, Labels(lines)
    for line in lines:
        text = labels.sent_as(line.text)
        if scope := halt_scope(text):
            halted = halt_by(rtc, scope)
            labels.numbers[line.label] = ""
            results.append({"text": text, **_label(line), "kind": "halted", "halt": msgspec.to_builtins(halted)})
            continue
        try:
            command = rtc.submit(text, progress=False, if_tested=if_tested).number
        except RequestDeclined as declined:
            for words in refusal_lines(declined.refusal, text):
                errors.print(Text(words))
            refusal = msgspec.to_builtins(declined.refusal)
            results.append({"text": text, **_label(line), "kind": "refused", "refusal": refusal})
            _leave_out(lines[len(results) :], results, "one before it was refused", quiet=json)
            return 2, results
        labels.numbers[line.label] = command
        accepted = Text(f"{command} accepted  {quoted(text)}")
        try:
            out.print(accepted)
        except OutputClosed:
            out = errors  # the number must not be lost
            out.print(accepted)
        results.append({"text": text, **_label(line), "kind": "accepted", "command": command})
    return 0, results


@contextmanager
def asked_on_interrupt(rtc: Client, board: Board) -> Iterator[None]:
    """Ctrl-C asks; a second Ctrl-C, or Ctrl-C without a terminal, halts.

    The question is asked inside the signal handler. That is safe: the halt line shares nothing with the interrupted
    code, and the wait continues afterwards to receive the outcomes.
    """

    steps = _long_steps(rtc, board)

    def interrupted(*_: object) -> None:
        if steps:
            steps.drop()
        board.pause()
        answer = _ask() if sys.stdin.isatty() else "h"
        if answer == "l":
            raise LeftRunning
        if answer == "h":
            for scope in board.running or ["ALL"]:
                halt_by(rtc, scope, errors)
        board.resume()

    def ended(number: int, _: object) -> None:
        for other in (signal.SIGTERM, signal.SIGHUP):  # a second signal must not interrupt the last message
            signal.signal(other, signal.SIG_IGN)
        raise Signalled(number)

    before = {signal.SIGINT: signal.signal(signal.SIGINT, interrupted)}
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup
            before[number] = signal.signal(number, ended)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if steps:
            steps.drop()


def _long_steps(rtc: Client, board: Board) -> LongSteps | None:
    """The question about long steps; None without a terminal."""
    if board.quiet or not (sys.stdin.isatty() and console.is_terminal):
        return None
    steps = LongSteps(
        lambda words: errors.print(Text(words, style="bold yellow")),
        lambda command: print_halt(rtc.halt(command), errors),  # one command: nothing else is awaited
        sys.stdin.fileno(),
    )
    board.on_long = steps.take
    return steps


def show_silence(words: str) -> None:
    """Print on stderr that the broker is silent or answers again."""
    errors.print(Text(f"rtc: {words}", style="bold yellow"))


def _ask() -> str:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        errors.print(Text("\n(l)eave running, (h)alt, or (w)ait on? Ctrl-C again halts: "), end="")
        return (input().strip().lower() or "w")[0]
    except (KeyboardInterrupt, EOFError):
        return "h"
    finally:
        signal.signal(signal.SIGINT, before)


def _program(sentences: list[str], file: Path | None) -> list[SentenceLine]:
    """The sentences of the arguments, then those of the file. Raises typer.Exit, with the reason printed."""
    given = [sentence_files.line_of(text) or SentenceLine("", text) for text in map(as_text, sentences)]
    read = sentence_files.read(file) if file else []
    return [*sentence_files.checked(given), *(line._replace(text=as_text(line.text)) for line in read)]


def _label(line: SentenceLine) -> dict[str, str]:
    return {"label": line.label} if line.label else {}


def _result(ended: m.CommandEnded, line: SentenceLine, board: Board) -> dict[str, Any]:
    """One result of --json. `reports`: those of EVERY and WHEN, the latest if they are many."""
    outcome = msgspec.to_builtins(ended.outcome)
    text = ended.text or line.text
    result = {"command": ended.command, "text": text, **_label(line), **outcome, "took_s": round(ended.took_s, 6)}
    if reports := board.reports.get(ended.command):
        result["reports"] = [_report(note) for note in reports]
        if older := board.reports_older[ended.command]:
            result["reports_older"] = older
    return result


def _report(note: m.ProgressNote) -> dict[str, Any]:
    """A report. `when`: the condition that was true, with what was measured; without it the report is periodic."""
    when = {"when": words} if (words := wording.in_words(note)) else {}
    return {"at_s": note.at_s, **when, **msgspec.to_builtins(note.measured)}


def _source(name: str) -> Source:
    return "aip" if name == "aip" else "operator"
