"""Programs of sentences: one a line, with comments (# or --), and labels such as `C3: LOCATE DOOR-2`.

A later sentence names the command of a label: AFTER C3, or AFTER C-3. In a program with labels each command that a
sentence names is a label above it. Without labels, C-3 is a number of the cluster.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from rtc.apps.cli.output import cli_error

LABEL = re.compile(r"([A-Z]+)[-_]?(\d+)[ \t]*:[ \t]*", re.IGNORECASE)
#: the language itself ends a sentence at --; a quotation may contain #
_COMMENT = re.compile(r'("[^"]*")|(?<!\S)#.*')
#: quotations and comments name nothing; neither does an object that is called like a command
_REFERENCE = re.compile(
    r'"[^"]*"|--.*|(?<![\w-])(?:(?:AFTER|TOGETHER[-_]WITH)[ \t,]+(?P<order>[A-Z][\w-]*)'
    r"|(?:HALT|STOP|PAUSE|RESUME|ABORT|SHOW|DESCRIBE)[ \t,]+(?P<command>[A-Z]+[-_]?\d+)(?![\w-]))",
    re.IGNORECASE | re.ASCII,
)
_COMMAND = re.compile(r"C[-_]?\d+", re.IGNORECASE | re.ASCII)


class SentenceLine(NamedTuple):
    """A sentence. `label`: C-12 of `C12:`; empty without one. `place`: its file and line, such as plan.txt:3."""

    label: str
    text: str
    place: str = ""


class Reference(NamedTuple):
    """The name of another command in a sentence, at these columns. `sure`: it cannot name anything else."""

    name: str
    start: int
    end: int
    sure: bool


def read(file: Path) -> list[SentenceLine]:
    """The sentences of a file; - is stdin. Raises typer.Exit, with the reason printed."""
    try:
        text = sys.stdin.read() if str(file) == "-" else file.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise cli_error(f"cannot read {file}: {error}", 2) from None
    name = "stdin" if str(file) == "-" else file.name
    text = text.removeprefix("\ufeff")  # some editors begin a file with this mark
    lines = [line_of(one, f"{name}:{n}") for n, one in enumerate(text.splitlines(), 1)]
    return checked([line for line in lines if line is not None])


def checked(lines: list[SentenceLine]) -> list[SentenceLine]:
    """The lines. Raises typer.Exit, with the reason printed, for a label that is unknown, doubled or empty."""
    if problem := next(_problems(lines), ""):
        raise cli_error(problem, 2)
    return lines


def line_of(written: str, place: str = "") -> SentenceLine | None:
    """One line of a program, without its comment; None if nothing is left."""
    text = _COMMENT.sub(lambda found: found[1] or "", written).strip()
    if not text or text.startswith("--"):
        return None
    found = LABEL.match(text)
    label, sentence = (spelt(found[0].rstrip(" \t:")), text[found.end() :]) if found else ("", text)
    return SentenceLine(label, sentence, place)


def references(text: str) -> Iterator[Reference]:
    """The commands that a sentence names, from left to right."""
    for found in _REFERENCE.finditer(text):
        if (group := found.lastgroup) and found[group].upper() != "LAST":
            sure = group == "order" or _COMMAND.fullmatch(found[group]) is not None
            yield Reference(found[group], *found.span(group), sure)


def spelt(name: str) -> str:
    """C-3 of C3, c_3 or C-3; another name in capitals."""
    found = re.fullmatch(r"([A-Z]+)[-_]?(\d+)", name, re.IGNORECASE | re.ASCII)
    return f"{found[1]}-{found[2]}".upper() if found else name.upper().replace("_", "-")


def unknown_label(text: str, above: Iterable[str], strict: bool) -> str:
    """Why a sentence names no label; empty if it does, or names none. `above`: the labels so far. `strict`: C-3 is
    not a number of the cluster either."""
    labels = list(above)
    for one in references(text):
        if one.sure and spelt(one.name) not in labels and (strict or one.name.isalnum()):
            known = f"the labels above are {', '.join(labels)}" if labels else f'such a line begins with "{one.name}:"'
            return f"no line above has the label {one.name}; {known}"
    return ""


def _problems(lines: list[SentenceLine]) -> Iterator[str]:
    strict = any(line.label for line in lines)
    above: dict[str, str] = {}
    for line in lines:
        if line.label in above:
            yield f"{line.place}: {line.label} is the label of {above[line.label]} already"
        if line.label and not line.text:
            yield f"{line.place}: after the label {line.label} there is no sentence"
        if problem := unknown_label(line.text, above, strict):
            yield ": ".join(filter(None, (line.place, line.text, problem)))
        if line.label:
            above[line.label] = line.place


def never_sent(lines: list[SentenceLine]) -> str:
    """Why a line of a program, sent one after the other, would wait for itself; empty if none would.

    A GIVE goes on until TAKE, DONE or CANNOT. In the same program these come after its end."""
    given: SentenceLine | None = None
    for line in lines:
        verb = next(iter(line.text.upper().split()), "")
        if verb == "GIVE":
            given = line
        elif given is not None and verb in ("TAKE", "DONE", "CANNOT"):
            own, other = (": ".join(filter(None, (one.place, one.text))) for one in (line, given))
            return (
                f"{own} is sent after the end of a sentence that waits for it: {other}\n"
                f"leave {verb} out: the program goes on when the operator has given DONE, with rtc operator --done or "
                'on the page, or when another terminal has given it, such as rtc do "TAKE RIGHT-ARM FROM OPERATOR"'
            )
    return ""


class Labels:
    """The commands that labelled sentences have become. `lines`: a program that is read as a whole."""

    def __init__(self, lines: Iterable[SentenceLine] = ()) -> None:
        self._expected = {line.label for line in lines if line.label}
        self.numbers: dict[str, str] = {}  # label -> C-n; empty if its sentence did not become a command

    def known(self, text: str) -> bool:
        """Whether all labels in a sentence have become commands, or never will."""
        return not any(spelt(one.name) in self._expected - self.numbers.keys() for one in references(text))

    def sent_as(self, text: str) -> str:
        """The sentence with the cluster's numbers of commands in place of the labels of the file.

        A label whose sentence did not become a command must not name another command, such as C-3 of another file.
        So it is written without its hyphen: C3 names no command, and the sentence is refused."""
        parts, done = [], 0
        for one in references(text):
            if (label := spelt(one.name)) in self.numbers:
                parts += [text[done : one.start], self.numbers[label] or label.replace("-", "")]
                done = one.end
        return "".join([*parts, text[done:]])
