"""The record of a command in words: as a list of its notes, and as a chain of causes."""

from __future__ import annotations

from itertools import groupby

from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.wording import notes as wording
from rtc.wording.feedback import stages
from rtc.wording.measured import duration, in_words, seconds
from rtc.wording.refusals import refusal_lines
from rtc.wording.sentences import quoted

DID = {"parser": "parsed", "elaborator": "planned", "binder": "bound", "analyzer": "judged"}  # kind of worker -> verb


def report_lines(note: m.ProgressNote) -> list[str]:
    """A report of EVERY or WHEN: the condition that was true, and what was measured."""
    return [*filter(None, [wording.in_words(note)]), *(in_words(note.measured) if note.measured else [])]


def trace_lines(note: m.ProgressNote, accepted_at_s: float) -> list[str]:
    """One line; of the feedback loop one for each of its stages."""
    first, *others = [f"{stage}: {words}" if words else stage for stage, words in stages(note)] or [
        wording.in_words(note)
    ]
    return [trace_line(note, accepted_at_s, first), *(f"{'':51}{words}" for words in others)]


def trace_line(note: m.ProgressNote, accepted_at_s: float, first: str) -> str:
    """`first`: the note in words."""
    took = seconds(note.took_s) if note.node else ""
    line = f"{seconds(note.at_s - accepted_at_s):>9}  {took:>8}  {note.node:<13} {address(note.node):<4} "
    words = [first] if first else []
    words += [f"about {duration(note.expected_s)}"] if note.expected_s else []
    words += in_words(note.measured) if note.measured else []
    return line + (f"{note.phase.value:<11}  {'; '.join(words)}" if words else note.phase.value)


def address(node: str) -> str:
    """The cube address of a worker, 10 for binder@2; empty for other processes."""
    _, at, number = node.partition("@")
    return format(int(number), "02b") if at and number.isdigit() else ""


def chain(record: m.CommandRecord) -> list[str]:
    """The record in words: one line for each successful step, all links for the last one."""
    lines = [f"{record.command} was given by the {record.source}: {quoted(record.text)}"]
    steps = [(step, list(notes)) for step, notes in groupby(_by_step(record.notes), key=lambda pair: pair[0])]
    last = len(steps) - 1
    ended_well = record.outcome is not None and record.outcome.kind == OutcomeKind.SUCCEEDED
    for n, (step, pairs) in enumerate(steps):
        notes = [note for _, note in pairs]
        if not step:
            lines += [link(note) for note in notes if note.node or note.phase == m.Phase.HELD]
        elif n == last and not ended_well:
            lines.append(f"script line {step}")
            lines += ["    " + link(note) for note in notes if note.node or wording.in_words(note)]
        else:
            lines.append(f"script line {step}: {_in_short(notes)}")
    return lines


def why(record: m.CommandRecord) -> list[str]:
    """What a person can do comes first, then how it came about."""
    outcome = record.outcome
    if outcome is None or outcome.refusal is None:
        return chain(record)
    lines = refusal_lines(outcome.refusal, record.text)
    return [*(line for line in lines if line != outcome.message), *chain(record)]  # the card has the message


def link(note: m.ProgressNote) -> str:
    """One link of the chain; of the feedback loop with its stages."""
    if not note.node:
        return ": ".join(filter(None, (note.phase.value, wording.in_words(note))))
    if note.kind is m.NoteKind.STARTED:
        return f"started by {note.node}"
    done = DID.get(note.node.partition("@")[0], "reported")
    words = "; ".join(f"{stage}: {result}" for stage, result in stages(note) if result) or wording.in_words(note)
    by = "" if "@" in note.node else f" by {note.node}"  # which worker it was, rtc trace shows
    return f"{done}{by} in {seconds(note.took_s)}" + (f": {words}" if words else "")


def _by_step(notes: list[m.ProgressNote]) -> list[tuple[str, m.ProgressNote]]:
    """Each note with its step: a note about finished work may already carry the next step.
    Notes that only repeat the process are left out."""
    pairs: list[tuple[str, m.ProgressNote]] = []
    step, node = "", ""
    for note in notes:
        kind = note.node.partition("@")[0]
        about = {"parser": "", "elaborator": "", "analyzer": step}.get(kind, note.step)
        if wording.in_words(note) or not note.node or note.node != node:
            pairs.append((about, note))
        step, node = note.step, note.node
    return pairs


def _in_short(notes: list[m.ProgressNote]) -> str:
    """The result of a step, as its subsystem reported it, and what the analyzer found in the report."""
    reports = [one for one in notes if one.node and "@" not in one.node and one.kind is not m.NoteKind.STARTED]
    shown = reports or [note for note in notes if wording.in_words(note)]
    if not shown:
        return "done"
    note = shown[-1]
    found = "".join(f"; {words}" for one in notes for words in (one.found, one.drift) if words)
    return f"{note.node} {wording.in_words(note)} after {seconds(note.took_s)}{found}" if reports else link(note)


def waits_for(status: m.Status, record: m.CommandRecord) -> list[str]:
    """What a held command waits for now, and what would clear it. `status`: of the broker."""
    commands = {row.command: row for row in status.commands}
    lines, owners = [], []
    for row in status.resources:
        if record.command not in row.waiting:
            continue
        ahead = row.waiting[: row.waiting.index(record.command)]
        queue = f"; before it in the line: {', '.join(ahead)}" if ahead else ""
        lines.append(f"waits for {row.name}, {_taken(row, commands)}{queue}")
        owners += [name for name in [*row.owners, *ahead] if name in commands]
    give_up = f"to give this one up: ABORT {record.command}"
    if owners := list(dict.fromkeys(owners)):
        lines.append(f"to clear it: wait for {', '.join(owners)}, or: ABORT {owners[0]}; {give_up}")
    elif not lines and record.notes:  # for another command, or for the space of an arm
        lines += [wording.in_words(record.notes[-1]), give_up]
    return lines


def _taken(resource: m.ResourceRow, commands: dict[str, m.CommandRow]) -> str:
    """The owner of a resource in words, with its sentence and what it does."""
    if resource.quarantine:
        return "which is closed until rest is confirmed or its facts are written (rtc status)"
    if (row := commands.get(resource.owner)) is None:
        return f"in use by {resource.owner}" if resource.owner else "which is not yet granted"
    now = ": ".join(filter(None, [row.phase, row.step]))
    return f"in use by {resource.owner} ({now}): {quoted(row.text)}"
