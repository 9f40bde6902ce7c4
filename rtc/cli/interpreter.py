"""The interpreter behind `rtc shell`: sentences and a few words about them, typed with history and completion."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import typer
from prompt_toolkit import PromptSession
from prompt_toolkit.auto_suggest import AutoSuggestFromHistory
from prompt_toolkit.completion import CompleteEvent, Completer, Completion
from prompt_toolkit.document import Document
from prompt_toolkit.history import FileHistory
from rich.text import Text

from rtc.cli import story, world
from rtc.cli.cluster import show_status
from rtc.cli.halt import print_halt
from rtc.cli.output import console, errors
from rtc.cli.progress import Board
from rtc.cli.sentences import LeftRunning, asked_on_interrupt, say_silence
from rtc.client import Client
from rtc.language.completion import complete
from rtc.language.fastpath import halt_scope
from rtc.language.parse import default_grammar
from rtc.outcomes import NoCluster, RequestDeclined, RtcError

LEAVE = (":quit", ":q", "quit", "exit")  # no verbs of the language
HELP = """Type a sentence (rtc dictionary lists the verbs), end it with & to send it and go on typing. Or one of:
  :status            what runs           :trace [C-7]  every phase of a command
  :world [LOCATION]  what is believed    :why [C-7]    the chain of causes
  :help              this                :quit, exit   leave (Ctrl-D); commands go on
HALT and STOP go past everything. Ctrl-C while a command runs asks; twice halts. Tab completes."""


def interpret(run_dir: Path | None, key: Path | None = None) -> None:
    """Read and obey lines until the operator leaves. Raises NoCluster."""
    with Client(run_dir, on_silence=say_silence, key=key) as rtc:
        history = FileHistory(str(key.with_suffix(".history") if key else Path(rtc.run_dir) / "history"))
        session: PromptSession[str] = PromptSession(
            history=history, completer=Sentences(_names(rtc)), auto_suggest=AutoSuggestFromHistory()
        )
        console.print(f"cluster in {rtc.where}; :help for help, Ctrl-D leaves")
        while (line := _read(session)) is not None and line.lower() not in LEAVE:
            if line:
                _obey(rtc, line)


class Sentences(Completer):
    """Words that may come next: those of the grammar, and the names the world knows."""

    def __init__(self, names: list[str]) -> None:
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
        return session.prompt("rtc> ").strip()
    except KeyboardInterrupt:
        return ""
    except EOFError:
        return None


def _obey(rtc: Client, line: str) -> None:
    """One line of the operator. Troubles are told and the shell goes on."""
    try:
        if line.startswith(":"):
            word, *rest = shlex.split(line)
            WORDS.get(word, _unknown)(rtc, rest)
        elif scope := halt_scope(line):
            print_halt(rtc.halt(scope))
        elif line.endswith("&"):
            console.print(Text(f"{rtc.submit(line[:-1].strip())} accepted"))
        else:
            _run(rtc, line)
    except LeftRunning:
        console.print("left running; :status shows it")
    except RequestDeclined as declined:
        errors.print(Text(declined.refusal.message))
    except NoCluster:
        raise
    except (RtcError, typer.Exit, ValueError) as error:
        errors.print(Text(str(error)))


def _run(rtc: Client, text: str) -> None:
    with Board([text]) as board, asked_on_interrupt(rtc, board):
        rtc.run_many([text], on_accept=board.accepted, on_progress=board.progress, on_end=board.ended)


def _status(rtc: Client, _: list[str]) -> None:
    show_status(rtc.status())


def _trace(rtc: Client, words: list[str]) -> None:
    story.print_trace(rtc.trace(_command(rtc, words)))


def _why(rtc: Client, words: list[str]) -> None:
    story.print_why(rtc.trace(_command(rtc, words)))


def _world(rtc: Client, words: list[str]) -> None:
    view = rtc.world.view(keys=[world.spelt(word) for word in words] or None)
    world.print_facts(view.facts)


def _help(_: Client, __: list[str]) -> None:
    console.print(Text(HELP))


def _unknown(_: Client, __: list[str]) -> None:
    console.print("no such word; :help lists them")


def _command(rtc: Client, words: list[str]) -> str:
    """The number that was typed; without one, of the last command."""
    if len(words) > 1:
        raise ValueError("name one command, such as C-7, or none: the last one")
    name = story.number(words[0]) if words else story.last_number(rtc)
    if not name:
        raise ValueError("there is no command yet")
    return name


def _names(rtc: Client) -> list[str]:
    """What the world knows by name; none when it does not answer, which is no reason not to start."""
    try:
        return sorted({fact.key.partition(".")[0] for fact in rtc.world.view().facts})
    except RtcError:
        return []


WORDS: dict[str, Callable[[Client, list[str]], None]] = {
    ":status": _status,
    ":trace": _trace,
    ":why": _why,
    ":world": _world,
    ":help": _help,
}
