"""The app `rtc` and its commands; an expected error becomes one message and an exit status, never a traceback.

A command's module is imported only if the command is called or all are listed: `rtc halt` must not wait for numpy.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from keyword import iskeyword
from typing import Annotated, Any

import typer

from rtc.apps.cli import version
from rtc.apps.cli.interrupts import raise_at_interrupts
from rtc.apps.cli.output import LEFT_RUNNING, NO_CLUSTER, cli_error, errors
from rtc.apps.cli.stdio import OutputClosed, attach
from rtc.protocol.outcomes import KeyTrouble, NoCluster, RequestDeclined, RtcError
from rtc.runtime import time_limit
from rtc.wording.advice import in_one_line

#: command -> module of this package with its function (for a group: its app); in the order of the help
COMMANDS = {
    "up": "cluster",
    "down": "cluster",
    "status": "status",
    "doctor": "doctor",
    "do": "sentences",
    "test": "rehearsal",
    "halt": "halt",
    "operator": "operator",
    "jog": "jog",
    "look": "look",
    "picture": "picture",
    "record": "record",
    "play": "record",
    "observe": "observe",
    "log": "log",
    "console": "console",
    "trace": "trace",
    "why": "trace",
    "replay": "replay",
    "break": "debug",
    "step": "debug",
    "trust": "trust",
    "cell": "cell",
    "names": "names",
    "teach": "teach",
    "world": "world_files",
    "load": "programs",
    "programs": "programs",
    "outcomes": "programs",
    "parse": "language",
    "dictionary": "language",
    "grammar": "language",
    "shell": "shell",
    "keys": "keys",
    "inject": "inject",
    "demo": "demo",
    "docs": "docs",
}
EPILOG = "First steps: rtc demo, or: rtc up -d; rtc shell; rtc halt; rtc down"


def build(names: list[str]) -> typer.Typer:
    """The app with these commands."""
    app = typer.Typer(
        name="rtc",
        help="Run-time control of a telerobot: submit commands, watch their progress, stop them at any time.",
        epilog=EPILOG,
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)  # keeps the form `rtc COMMAND` if there is only one command
    for name in names:
        module: Any = import_module(f"rtc.apps.cli.{COMMANDS[name]}")
        if hasattr(module, "app"):
            module.app.callback()(raise_at_interrupts)
            app.add_typer(module.app, name=name)
        else:
            function = getattr(module, f"{name}_" if iskeyword(name) else name)
            odd = {"ignore_unknown_options": name == "halt"}  # an option that it lacks is a scope, and halts ALL
            app.command(name, context_settings=odd)(_interruptible(function))
    return app


def _interruptible(command: Callable[..., None]) -> Callable[..., None]:
    """Ctrl-C in a command that does not handle it prints one line; Typer would exit silently."""

    @wraps(command)
    def called(*given: Any, **options: Any) -> None:
        raise_at_interrupts()
        try:
            command(*given, **options)
        except KeyboardInterrupt:
            raise cli_error("interrupted", LEFT_RUNNING) from None

    return called


def _version(wanted: bool) -> None:
    if wanted:
        print(version.line())
        raise typer.Exit()


def _options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def as_option(words: list[str]) -> list[str]:
    """The arguments, with `help` and `help COMMAND` replaced by the option --help."""
    return [*words[1:2], "--help"] if words[:1] == ["help"] else words


def main() -> None:
    """Run the command line. Exit status: see `rtc do -h`; 4 = no cluster."""
    attach()
    sys.argv[1:] = as_option(sys.argv[1:])
    try:
        try:
            _call()
        finally:
            sys.stdout.flush()  # before Python's own flush at exit, whose errors cannot be reported
    except OutputClosed as closed:  # of a command that only prints; others report the state of their work
        if closed.reader_gone:  # `rtc trace C-7 | head`
            sys.exit(0)
        errors.print(f"rtc: {closed}")
        sys.exit(1)


def _call() -> None:
    called = sys.argv[1] if len(sys.argv) > 1 else ""
    time_limit.install()
    try:
        build([called] if called in COMMANDS else list(COMMANDS))(prog_name="rtc")
    except NoCluster as error:
        sys.exit(cli_error(str(error), NO_CLUSTER).exit_code)
    except RequestDeclined as error:
        clears = f" ({in_one_line(error.refusal.clears)})" if error.refusal.clears else ""
        sys.exit(cli_error(str(error) + clears, 2).exit_code)
    except KeyTrouble as error:
        sys.exit(cli_error(str(error), 2).exit_code)
    except RtcError as error:
        sys.exit(cli_error(str(error), 1).exit_code)
    except UnicodeEncodeError as error:  # undecodable bytes; in a sentence the parser refuses them at their place
        sys.exit(cli_error(f"this is not text: {error.object!a}", 2).exit_code)
    except KeyboardInterrupt:
        sys.exit(cli_error("interrupted", LEFT_RUNNING).exit_code)


if __name__ == "__main__":
    main()
