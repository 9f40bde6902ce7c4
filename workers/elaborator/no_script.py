"""Refusals of a sentence that no script takes, or a wrong one: what to change in it, or which script to load."""

from __future__ import annotations

from collections.abc import Iterator

from rtc.programs.schema import Branch, ElaboratorProgram
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import ParsedCommand
from workers.tasks import command_fields


def refused_verb(program: ElaboratorProgram, parsed: ParsedCommand) -> Refused:
    scripted = sorted(verbs(program))
    instead, cannot = program.instead.get(parsed.verb, ""), program.cannot.get(parsed.verb)
    load = "" if "rtc load" in instead or cannot else f"load a script for {parsed.verb}: rtc load FILE INTO elaborator"
    return Refused.because(
        RefusalReason.NO_SCRIPT,
        (f"{parsed.verb} cannot be tested: {cannot}" if cannot else f"there is no script for {parsed.verb} yet"),
        where=parsed.verb,
        expected=scripted,
        clears=by_person(instead, load),
    )


def refused_form(parsed: ParsedCommand, branches: list[Branch], *, hinged: bool = False) -> Refused:
    """The refusal of a sentence that no branch takes. It names no more changes than necessary, with the same hand
    and object if that is enough. `hinged`: the object of the sentence has a hinge."""
    begun = " ".join(filter(None, (parsed.verb, parsed.object or parsed.hand)))
    changes = [_changes(branch, parsed, "an angle in DEG" if hinged else "an amount") for branch in branches]
    kept = [one for one in changes if not any(path in ("hand", "object") for path, _ in one)] or changes
    least = [one for one in kept if not any(set(other) < set(one) for other in kept)]
    wanted = [", ".join(words for _, words in one) or "with an object whose figures fit" for one in least]
    return Refused.because(
        RefusalReason.NO_SCRIPT,
        f"{parsed.verb} has no script for this form of the sentence",
        where=parsed.verb,
        clears=by_person(*dict.fromkeys(f"{begun if kept is not changes else parsed.verb} {one}" for one in wanted)),
    )


def _changes(branch: Branch, parsed: ParsedCommand, amount: str) -> list[tuple[str, str]]:
    """The conditions of a branch that the sentence does not meet: (field, what to change, in words)."""
    follows = {"amount": amount, "to_value": amount, "duration_s": "a time in SEC", "until": "a condition"}
    found: list[tuple[str, str]] = []
    for check in branch.when:
        if check.given and command_fields.field(parsed, check.given) is None:
            words = f"{command_fields.in_words(check.given)} {follows.get(check.given, '')}".rstrip()
            found.append((check.given, _with(words)))
        if check.missing and command_fields.field(parsed, check.missing) is not None:
            found.append((check.missing, f"without {command_fields.in_words(check.missing)}"))
        for path, value in check.equals.items():
            if command_fields.field(parsed, path) != value:
                found.append((path, f"with {command_fields.in_words(path)} {_written(value)}"))
        for path, value in check.differs.items():
            if command_fields.field(parsed, path) == value:
                other = f"with {command_fields.in_words(path)} other than {_written(value)}"
                found.append((path, f"without {_written(value)}" if path == "path" else other))
    return found


def _with(words: str) -> str:
    """`BY a distance` stays as it is; `an object` gets a word before it."""
    return words if words.partition(" ")[0].isupper() else f"with {words}"


def _written(value: str) -> str:
    return "JOINT-MOTION" if value == "joint" else value.upper().replace("_", "-")


def wrong_program(message: str, where: str, clears: str = "") -> Refused:
    return Refused.because(RefusalReason.PROGRAM, message, where=where, clears=clears)


def verbs(program: ElaboratorProgram) -> Iterator[str]:
    """All verbs with a script."""
    yield from dict.fromkeys(branch.verb for branch in program.decision_tree if branch.enabled)
