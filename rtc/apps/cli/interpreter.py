"""The interpreter of `rtc shell`: sentences and some commands about them, with history and completion."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import typer
from prompt_toolkit import PromptSession
from prompt_toolkit.auto_suggest import AutoSuggestFromHistory
from prompt_toolkit.completion import CompleteEvent, Completer, Completion
from prompt_toolkit.document import Document
from prompt_toolkit.history import FileHistory
from prompt_toolkit.patch_stdout import patch_stdout
from rich.text import Text

from rtc.apps.cli import log, names, trace, world
from rtc.apps.cli.background import Background
from rtc.apps.cli.cluster import show_status
from rtc.apps.cli.halt import print_halt
from rtc.apps.cli.offers import CellNames
from rtc.apps.cli.output import console, errors
from rtc.apps.cli.progress import Board, print_result
from rtc.apps.cli.sentences import LeftRunning, Signalled, asked_on_interrupt, gone_away, show_silence
from rtc.apps.cli.teach import with_taught
from rtc.client.client import Client
from rtc.language.completion import Names, complete
from rtc.language.fastpath import halt_scope
from rtc.language.parse import default_grammar
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import NoCluster, RequestDeclined, RtcError

LOGGED = 20  # commands that :log shows
LEAVE = (":quit", ":q", "quit", "exit")  # these are not verbs of the language
HELP = """Type a sentence (rtc dictionary lists the verbs); with & at its end you can type on at once. Or one of:
  :status            what runs           :trace [C-7]  every phase of a command, or of the last one
  :world [LOCATION]  facts of the world  :why [C-7]    the chain of causes
  :names [KIND]      names for sentences :log          the last commands
  :help              this                :quit, exit   leave (Ctrl-D); commands continue
The colon may be omitted. HALT and STOP pass every queue. Ctrl-C while a command runs asks; twice halts.
Tab completes; Ctrl-R searches earlier lines."""


def interpret(run_dir: Path | None, key: Path | None = None) -> None:
    """Read and execute lines until the operator leaves. Raises NoCluster."""
    with Client(run_dir, on_silence=show_silence, key=key) as rtc:
        history = FileHistory(str(key.with_suffix(".history") if key else Path(rtc.run_dir) / "history"))
        session: PromptSession[str] = PromptSession(
            history=history,
            completer=Sentences(_names(rtc, far=key is not None)),
            auto_suggest=AutoSuggestFromHistory(),
            search_ignore_case=True,
        )
        console.print(f"cluster in {rtc.where}; help for help, Ctrl-D leaves")
        with _background(run_dir, key) as background:
            while (line := _read(session)) is not None and line.lower() not in LEAVE:
                if line:
                    _obey(rtc, background, line)


def obey_lines(lines: Iterable[str], run_dir: Path | None, key: Path | None = None) -> None:
    """Execute lines from a file (`rtc shell < file`), without a prompt; comments begin with #. Raises NoCluster."""
    with Client(run_dir, on_silence=show_silence, key=key) as rtc, _background(run_dir, key) as background:
        for line in map(str.strip, lines):
            if line.lower() in LEAVE:
                break
            if line and not line.startswith(("#", "--")):
                _obey(rtc, background, line)


@contextmanager
def _background(run_dir: Path | None, key: Path | None) -> Iterator[Background]:
    background = Background(run_dir, key, _print_end)
    try:
        yield background
    finally:
        if left := background.close():
            console.print(f"left running: {', '.join(left)}; rtc status")


def _print_end(record: m.CommandRecord) -> None:
    """Print the outcome of a command that was sent with &."""
    assert record.outcome is not None
    assert record.ended_at_s is not None
    ended = m.CommandEnded(
        seq=0,
        at_s=record.ended_at_s,
        command=record.command,
        request=record.request,
        text=record.text,
        outcome=record.outcome,
        took_s=record.ended_at_s - record.accepted_at_s,
    )
    print_result(ended, record.text)


class Sentences(Completer):
    """Words that may come next: words of the grammar, and names in the world."""

    def __init__(self, names: Names) -> None:
        self._names = names

    def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterator[Completion]:
        text = document.text_before_cursor
        if text.startswith(":"):
            words: Iterable[str] = (word for word in (*WORDS, *LEAVE) if word.startswith(text))
            begun = len(text)
        else:
            words = complete(default_grammar(), text, self._names)
            begun = len(text) - len(text.rstrip("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_%/"))
        yield from (Completion(word, start_position=-begun) for word in words)


def _read(session: PromptSession[str]) -> str | None:
    """One line; None at the end. Ctrl-C on an empty prompt clears the line, as in any shell."""
    try:
        with patch_stdout(raw=True):  # outcomes are printed above the prompt
            return session.prompt("rtc> ").strip()
    except KeyboardInterrupt:
        return ""
    except EOFError:
        return None


def _obey(rtc: Client, background: Background, line: str) -> None:
    """One line of the operator. Errors are printed, and the shell continues."""
    try:
        if (word := _own_word(line)) is not None:
            _, *rest = shlex.split(line)
            word(rtc, rest)
        elif scope := halt_scope(line):
            print_halt(rtc.halt(scope))
        elif line.endswith("&"):
            command = rtc.submit(line[:-1].strip(), progress=False).number
            console.print(Text(f"{command} accepted"))
            background.watch(command)
        else:
            _run(rtc, line)
    except LeftRunning:
        console.print("left running; :status shows it")
    except RequestDeclined as declined:
        errors.print(Text(declined.refusal.message))
    except NoCluster:
        raise
    except typer.Exit:
        pass  # the reason has been printed
    except (RtcError, ValueError) as error:
        errors.print(Text(str(error)))


def _own_word(line: str) -> Callable[[Client, list[str]], None] | None:
    """The action of a line that is not a sentence, such as :help or help; None for a sentence."""
    first = line.split()[0].lower()
    if first.startswith(":"):
        return WORDS.get(first, _unknown)
    return WORDS.get(f":{first}") or (_help if first == "?" else None)


def _run(rtc: Client, text: str) -> None:
    board = Board([text])
    try:
        with board, asked_on_interrupt(rtc, board):
            rtc.run_many([text], on_accept=board.accepted, on_progress=board.progress, on_end=board.ended)
    except Signalled as gone:
        sys.exit(gone_away(gone, board, 1))


def _status(rtc: Client, _: list[str]) -> None:
    show_status(rtc.status())


def _trace(rtc: Client, words: list[str]) -> None:
    trace.print_trace(rtc.trace(_command(rtc, words)))


def _why(rtc: Client, words: list[str]) -> None:
    trace.print_why(rtc.trace(_command(rtc, words)))


def _world(rtc: Client, words: list[str]) -> None:
    view = rtc.world.view(keys=[world.spelt(word) for word in words] or None)
    world.print_facts(view.facts, world.joint_units(rtc))


def _log(rtc: Client, _: list[str]) -> None:
    log.print_log(log.from_cluster(rtc, LOGGED), None)


def _names_of(rtc: Client, words: list[str]) -> None:
    known = with_taught(Cell.load(_cell(rtc)), rtc.run_dir)
    names.print_names(_cell(rtc), known, names.kind_of(" ".join(words)))


def _help(_: Client, __: list[str]) -> None:
    console.print(Text(HELP))


def _unknown(_: Client, __: list[str]) -> None:
    console.print("unknown word; :help lists the words")


def _command(rtc: Client, words: list[str]) -> str:
    """The number of a command that was typed; without one, that of the last command."""
    if len(words) > 1:
        raise ValueError("name one command, such as C-7, or none: the last one")
    name = trace.number(words[0]) if words else trace.last_number(rtc)
    if not name:
        raise ValueError("there is no command yet")
    return name


def _cell(rtc: Client) -> str:
    """The cell of the cluster. Raises KeyTrouble over tcp, where it is not available."""
    return rtc.settings.cell


def _names(rtc: Client, far: bool) -> Names:
    """The names of the cell; over tcp, those in the world. None if it does not answer: the shell starts anyway."""
    try:
        if not far:
            return CellNames(with_taught(Cell.load(_cell(rtc)), rtc.run_dir))
        return sorted({fact.key.partition(".")[0] for fact in rtc.world.view().facts})
    except RtcError:
        return []


WORDS: dict[str, Callable[[Client, list[str]], None]] = {
    ":status": _status,
    ":trace": _trace,
    ":why": _why,
    ":world": _world,
    ":log": _log,
    ":names": _names_of,
    ":help": _help,
}
