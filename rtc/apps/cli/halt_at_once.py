"""`rtc halt` in its plain forms: the order leaves before any library is loaded, and neither typer nor rich is.

What this module does not understand it leaves to the complete command (`rtc.apps.cli.halt`): help, errors, key files,
and a run directory where no process listens.
"""

from __future__ import annotations

import sys

from rtc.client.first_order import FirstOrder
from rtc.runtime import environment

TYPE_CHECKING = False  # see rtc/__init__.py
if TYPE_CHECKING:
    from rtc.client.halt import HaltResult, SubsystemHalt

NOT_CONFIRMED = 3  # exit status
TIMEOUT_S, SHORTEST_S = 2.0, 0.01  # wait for rest


def run(words: list[str]) -> int | None:
    """Halt; the exit status. None: nothing was sent, and the complete command must take it."""
    if (called := plain(words)) is None:
        return None
    scope, timeout_s, as_json, run_dir = called
    first = FirstOrder(run_dir, scope)
    if not first.sent_to:
        return None
    return _finish(first, timeout_s, as_json, run_dir)


def plain(words: list[str]) -> tuple[str, float, bool, str] | None:
    """(scope, timeout in s, as JSON, run directory) of the words after `halt`; None for those of the complete command.

    All other words are the scope, as after HALT in a sentence: no halt is refused for a word (decision 0174)."""
    scope, timeout, as_json, run_dir = list[str](), "", False, ""
    left = [part for word in words for part in (word.split("=", 1) if word.startswith("--") else [word])]
    while left:
        word = left.pop(0)
        if word in ("-h", "--help", "--with", "--run-dir") and not (word == "--run-dir" and left and left[0]):
            return None
        if word == "--json":
            as_json = True
        elif word == "--timeout":
            timeout = left.pop(0) if left else ""
        elif word == "--run-dir":
            run_dir = left.pop(0)
        else:
            scope.append(word)
    return " ".join(scope) or "ALL", seconds(timeout), as_json, run_dir or environment.run_dir()


def seconds(timeout: str) -> float:
    """A time limit; the usual one for what is no number, since no halt is refused for that."""
    try:
        wanted_s = float(timeout or TIMEOUT_S)
    except ValueError:
        return TIMEOUT_S
    return max(SHORTEST_S, wanted_s) if wanted_s == wanted_s else TIMEOUT_S


def _finish(first: FirstOrder, timeout_s: float, as_json: bool, run_dir: str) -> int:
    """Wait for rest and print the result."""
    import zmq

    from rtc.apps.cli.json_line import emit_json
    from rtc.apps.cli.stdio import OutputClosed, attach
    from rtc.client.halt import HaltLine, local_settings

    attach()
    with zmq.Context() as context:
        line = HaltLine(context, local_settings(run_dir), first)
        try:
            result = line.finish(timeout_s, _show)
        finally:
            line.close()
    try:
        if as_json:
            emit_json(result)
        else:
            _print(result, run_dir)
        sys.stdout.flush()
    except OutputClosed as closed:
        if as_json:
            sys.stderr.write(f"rtc: {closed}\n")
    return 0 if result.confirmed else NOT_CONFIRMED


def _show(found: SubsystemHalt, awaited: list[str]) -> None:
    """On stderr: what comes last on stdout is the result."""
    from rtc.apps.cli.halt_words import as_text, confirmed

    try:
        sys.stderr.write(as_text([confirmed(found, awaited)], sys.stderr.isatty() and environment.colours()))
        sys.stderr.flush()
    except OSError:
        pass  # the result follows


def _print(result: HaltResult, run_dir: str) -> None:
    from rtc.apps.cli.halt_words import as_text, in_words, state_of
    from rtc.apps.cli.stdio import OutputClosed

    lines = in_words(result)
    try:
        sys.stdout.write(as_text(lines, sys.stdout.isatty() and environment.colours()))
        if not result.reached and not result.declined and "halt" in result.sent_to and result.scope.startswith("C-"):
            sys.stdout.flush()
            sys.stdout.write(as_text([[(words, "")] for words in state_of(result.scope, run_dir, None)], False))
    except OutputClosed:
        sys.stderr.write(as_text(lines, False))
