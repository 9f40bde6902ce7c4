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
from prompt_toolkit.formatted_text import FormattedText
from prompt_toolkit.history import FileHistory
from prompt_toolkit.patch_stdout import patch_stdout
from rich.text import Text

from rtc.apps.cli import log, names, trace, world
from rtc.apps.cli.halt import halt_by
from rtc.apps.cli.language import in_one_line
from rtc.apps.cli.live_state import ASK_S, LiveState, in_words
from rtc.apps.cli.output import console, errors
from rtc.apps.cli.progress import Board, print_result
from rtc.apps.cli.sentence_files import LABEL, Labels, SentenceLine, line_of, unknown_label
from rtc.apps.cli.sentences import HALTED, LeftRunning, Signalled, asked_on_interrupt, gone_away, show_silence
from rtc.apps.cli.status import show_status
from rtc.apps.cli.teach import with_taught
from rtc.client.client import Client
from rtc.language.completion import Names, complete
from rtc.language.fastpath import halt_scope
from rtc.language.parse import Grammar, default_grammar, parse
from rtc.model.cells.cell import Cell
from rtc.model.cells.offers import CellNames
from rtc.protocol import messages as m
from rtc.protocol.outcomes import NoCluster, RequestDeclined, RtcError, TimedOut
from rtc.protocol.sentence import ParsedCommand

LOGGED = 20  # commands that :log shows
LEAVE = (":quit", ":q", "quit", "exit")  # these are not verbs of the language
HELP = """Type a sentence (rtc dictionary lists the verbs); with & at its end you can type on at once. Or one of:
  :status            what runs           :trace [C-7]  every phase of a command, or of the last one
  :world [LOCATION]  facts of the world  :why [C-7]    the chain of causes
  :names [KIND]      names for sentences :log          the last commands
  :help              this                :quit, exit   leave (Ctrl-D); commands continue
The colon may be omitted. HALT and STOP pass every queue. Ctrl-C while a command runs asks; twice halts.
A line `C3: STOW LEFT-ARM` has a label: AFTER C3 in a later line names its command. Tab completes; Ctrl-R searches
earlier lines."""


def interpret(run_dir: Path | None, key: Path | None = None) -> None:
    """Read and execute lines until the operator leaves. Raises NoCluster."""
    with Client(run_dir, on_silence=show_silence, key=key) as rtc:
        history = FileHistory(str(key.with_suffix(".history") if key else Path(rtc.run_dir) / "history"))
        console.print(f"cluster in {rtc.where}; help for help, Ctrl-D leaves")
        with _live_state(run_dir, key) as live:
            shell = Shell(rtc, live)
            session: PromptSession[str] = PromptSession(
                history=history,
                completer=Sentences(_names(rtc, shell, live), shell.grammar),
                auto_suggest=AutoSuggestFromHistory(),
                search_ignore_case=True,
                bottom_toolbar=lambda: FormattedText(in_words(live.now)),
                refresh_interval=ASK_S,
            )
            while (line := _read(session)) is not None and line.lower() not in LEAVE:
                shell.obey(line)


def obey_lines(lines: Iterable[str], run_dir: Path | None, key: Path | None = None) -> None:
    """Execute a program of sentences (`rtc shell < file`), without a prompt. Raises NoCluster."""
    with Client(run_dir, on_silence=show_silence, key=key) as rtc, _live_state(run_dir, key) as live:
        shell = Shell(rtc, live)
        for n, line in enumerate(map(str.strip, lines), 1):
            if line.lower() in LEAVE:
                break
            shell.obey(line, f"line {n}")
            if shell.halted:
                errors.print(Text(f"line {n} was halted: the lines after it are not sent"))
                break


@contextmanager
def _live_state(run_dir: Path | None, key: Path | None) -> Iterator[LiveState]:
    with LiveState(run_dir, key, _print_end) as live:
        yield live
    if live.watched:
        console.print(f"left running: {', '.join(live.watched)}; rtc status")


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

    def __init__(self, names: Names, grammar: Callable[[], Grammar]) -> None:
        self._names, self._grammar = names, grammar

    def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterator[Completion]:
        text = document.text_before_cursor
        if text.startswith(":"):
            words: Iterable[str] = (word for word in (*WORDS, *LEAVE) if word.startswith(text))
            begun = len(text)
        else:
            text = text[labelled.end() :] if (labelled := LABEL.match(text)) else text
            words = complete(self._grammar(), text, self._names)
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


class Shell:
    """Obeys one line after the other. Errors are printed, and the next line is read."""

    def __init__(self, rtc: Client, live: LiveState) -> None:
        self._rtc, self._live = rtc, live
        self._labels = Labels()
        self._grammar: tuple[str, Grammar] = ("", default_grammar())  # with the digest of the cluster's
        self.halted = False  # whether a command that it waited for was halted

    def obey(self, written: str, place: str = "") -> None:
        """A line of the operator, or of a program, whose `place` is printed with errors. Raises NoCluster."""
        if (line := line_of(written, place)) is None:
            return
        try:
            if not line.label and (word := _own_word(line.text)) is not None:
                word(self._rtc, shlex.split(line.text)[1:])
            else:
                self._sentence(line)
        except LeftRunning:
            console.print("left running; :status shows it")
        except RequestDeclined as declined:
            errors.print(Text(declined.refusal.message))
        except NoCluster:
            raise
        except typer.Exit:
            pass  # the reason has been printed
        except (RtcError, ValueError) as error:
            errors.print(Text(": ".join(filter(None, [place, str(error)]))))

    def grammar(self) -> Grammar:
        """The grammar that was the cluster's at the last sentence."""
        return self._grammar[1]

    def labels(self) -> list[str]:
        return list(self._labels.numbers)

    def _sentence(self, line: SentenceLine) -> None:
        """Raises ValueError for a label that no earlier line has, in a program with labels."""
        if problem := line.place and unknown_label(line.text, self.labels(), strict=bool(self.labels())):
            raise ValueError(problem)
        text = self._labels.sent_as(line.text)
        command = ""
        if scope := halt_scope(text):
            halt_by(self._rtc, scope)
        elif text.endswith("&"):
            text = text[:-1].strip()
            self._echo(text)
            command = self._rtc.submit(text, progress=False).number
            console.print(Text(f"{command} accepted"))
            self._live.watched.append(command)
        else:
            self._echo(text)
            ended = _run(self._rtc, text, line.label)
            command, self.halted = ended.command, ended.outcome.kind in HALTED
        if line.label:
            self._labels.numbers[line.label] = command

    def _echo(self, text: str) -> None:
        """One line: how the cluster understands a sentence. It explains itself what it does not understand."""
        record = parse(self._of_cluster(), text)
        if isinstance(record, ParsedCommand):
            console.print(Text(f"  {in_one_line(record)}", style="dim"))

    def _of_cluster(self) -> Grammar:
        """The grammar of the cluster; the default one if it does not tell its own."""
        try:
            program = self._rtc.program(m.WorkerKind.PARSER)
            if program.digest != self._grammar[0]:
                self._grammar = (program.digest, Grammar(program.body.decode()))
        except (TimedOut, RequestDeclined):
            pass
        return self._grammar[1]


def _own_word(line: str) -> Callable[[Client, list[str]], None] | None:
    """The action of a line that is not a sentence, such as :help or help; None for a sentence."""
    first = line.split()[0].lower()
    if first.startswith(":"):
        return WORDS.get(first, _unknown)
    return WORDS.get(f":{first}") or (_help if first == "?" else None)


def _run(rtc: Client, text: str, label: str) -> m.CommandEnded:
    """The end of the command; its number is empty if it became none."""
    board = Board([text], [label])
    try:
        with board, asked_on_interrupt(rtc, board):
            (ended,) = rtc.run_many([text], on_accept=board.accepted, on_progress=board.progress, on_end=board.ended)
    except Signalled as gone:
        sys.exit(gone_away(gone, board, 1))
    return ended


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


def _names(rtc: Client, shell: Shell, live: LiveState) -> Names:
    """The names of the cell, as it is now; over tcp, those in the world."""

    def commands() -> list[str]:
        return [*live.now.commands, *shell.labels()]

    if not rtc.far:
        return CellNames(Cell.load(_cell(rtc)), places=lambda: live.now.places, commands=commands)
    return lambda _: sorted({key.partition(".")[0] for key in live.now.facts}) + commands()


WORDS: dict[str, Callable[[Client, list[str]], None]] = {
    ":status": _status,
    ":trace": _trace,
    ":why": _why,
    ":world": _world,
    ":log": _log,
    ":names": _names_of,
    ":help": _help,
}
