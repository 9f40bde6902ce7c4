"""The context of one call of `decide`: state, time, effects so far, and the stimuli that follow.

It also has the operations that every action needs, such as creating a job or writing a note. It makes no decisions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypedDict, Unpack

import msgspec

from broker.decisions.effects import DispatchJob, Effect, LoadPart, PublishNote, StartTimer, StopTimer
from broker.decisions.events import Stimulus
from broker.decisions.resources import WORLD, Quarantine
from broker.decisions.state import (
    NOTES_KEPT,
    SPACES_KEPT,
    ArmMotion,
    Command,
    JobKind,
    PendingJob,
    ScriptHead,
    State,
    StepHead,
)
from rtc.programs.action_stack import NOMINAL, ActionStack
from rtc.protocol import wire
from rtc.protocol.messages import (
    REHEARSER,
    AnalyzerInput,
    BinderInput,
    ElaboratorInput,
    NoteKind,
    ParserInput,
    Phase,
    ProgressNote,
    RehearsalInput,
    WorkerKind,
)
from rtc.protocol.outcomes import Compared, Measured, OutcomeKind, StopReason
from rtc.protocol.primitive import Box, Primitive, apart

read_step = wire.decoder(StepHead)
JobInput = ParserInput | ElaboratorInput | BinderInput | AnalyzerInput | RehearsalInput
NO_PROGRAMS: dict[str, str] = {}


class NoteFacts(TypedDict, total=False):
    """What a note states besides its kind; the fields are those of ProgressNote."""

    reason: StopReason | None
    outcome: OutcomeKind
    message: str
    found: str
    drift: str
    owner: str
    about: str
    program: str
    arm: str
    clears: list[str]
    value: float
    expected_s: float
    measured: Measured | None
    compared: Compared | None
    trim: int
    pieces: list[str]
    warning: bool


class DecisionContext:
    """State and time of one decision, with the effects collected so far."""

    __slots__ = ("effects", "followups", "node", "now", "state", "took_s")

    def __init__(self, state: State, now: float) -> None:
        self.state, self.now = state, now
        self.effects: list[Effect] = []
        self.followups: list[tuple[str, Stimulus, Any]] = []  # (command, stimulus, payload)
        self.node = ""  # worker or subsystem that caused the event
        self.took_s: float = 0  # duration of its work

    def enqueue_stimulus(self, command: str, stimulus: Stimulus, payload: Any = None) -> None:
        """Stimulate another command after this action."""
        self.followups.append((command, stimulus, payload))

    def is_next(self, command: Command) -> bool:
        """True if all earlier commands of its client have been taken up."""
        return next(iter(self.state.intake_order[command.client])) == command.id

    def leave_intake(self, command: Command) -> None:
        """Remove a command that was taken up or has ended. Its client's next command is taken up if it is parsed."""
        line = self.state.intake_order[command.client]
        names = iter(line)  # one search: the first name is behind those of all removed commands
        was_next, following = next(names) == command.id, next(names, "")
        del line[command.id]
        if not line:
            del self.state.intake_order[command.client]
        elif was_next and line[following]:
            self.enqueue_stimulus(following, Stimulus.RELEASE)

    def grant(self, commands: list[str]) -> None:
        for command in commands:
            self.followups.append((command, Stimulus.GRANT, None))

    def confirm_rest(self, subsystem: str, performers: list[str] | None = None, moved: str = "") -> None:
        """Record confirmed rest and lift the quarantines that waited for it.

        `performers`: the performers at rest, None = all of the subsystem. `moved`: a primitive, or a command for all
        its primitives, that is known to be at rest as well."""
        found = self.state.subsystems.get(subsystem)
        if found and performers is not None and set(performers) >= set(found.performers):
            performers = None
        for live in self.state.commands.values():
            if live.subsystem == subsystem and live.phase is Phase.CLOSING:
                live.at_rest |= (
                    performers is None or set(performers) >= set(live.performers) or moved in (live.id, live.primitive)
                )
        opened = self.state.resources.confirm_rest(subsystem, performers, moved)
        self.quarantine_deferred()
        self.forget_motions()
        self.grant(opened)

    def quarantine_deferred(self) -> None:
        """Keep the names of deferred analyses quarantined, at rest or not (`broker.decisions.deferred_analysis`)."""
        for command, left in self.state.deferred_analyses.items():
            for name in left.names:
                self.state.resources.quarantine.setdefault(name, Quarantine(WORLD, command))

    def begin_motion(self, command: Command, arm: str, body: msgspec.Raw, space: list[Box]) -> None:
        """Other arms plan beside this motion from now on: it is known where the arm goes."""
        self.state.motions[arm] = ArmMotion(
            command=command.id, primitive=command.primitive, body=body, space=space, beside=command.beside
        )
        self.state.motions_begun += 1
        self.state.spaces_mm = [*self.state.spaces_mm, space][-SPACES_KEPT:]
        self._recheck_space(arm)

    def is_clear(self, command: Command, space: list[Box]) -> bool:
        """Whether a motion in this space keeps clear of all that began after the job which planned it was created."""
        begun = self.state.motions_begun - command.motions_seen[0]
        latest = self.state.spaces_mm[-begun:] if begun else []
        return len(latest) == begun and all(apart(space, other) for other in latest)

    def end_motions(self, command: Command) -> None:
        """The world database has the results of this command's motions. Stimulate the commands that wait for that."""
        for arm in [arm for arm, motion in self.state.motions.items() if motion.command == command.id]:
            self._forget(arm)

    def forget_motions(self) -> None:
        """Forget the motions of ended commands, except of an arm in quarantine: its position is not known."""
        state = self.state
        for arm, motion in list(state.motions.items()):
            if motion.command not in state.commands and arm not in state.resources.quarantine:
                self._forget(arm)

    def _forget(self, arm: str) -> None:
        del self.state.motions[arm]
        self.state.motions_ended += 1
        self._recheck_space(arm)

    def _recheck_space(self, arm: str) -> None:
        for waiting in self.state.space_lines.get(arm, ()):
            self.enqueue_stimulus(waiting, Stimulus.SPACE)

    def owner_of(self, arm: str) -> Command | None:
        """The live command that holds this arm."""
        holders = self.state.resources.holders.get(arm, {})
        return next((self.state.commands[name] for name, exclusive in holders.items() if exclusive), None)

    def leave_space_line(self, command: Command) -> None:
        if not command.waits_for:
            return
        line = self.state.space_lines[command.waits_for]
        line.remove(command.id)
        if not line:
            del self.state.space_lines[command.waits_for]
        command.waits_for = ""

    def check_space_lines(self) -> None:
        """Stimulate the commands that wait for an arm without an owner: it will not leave by itself."""
        for arm in self.state.space_lines:
            if self.owner_of(arm) is None:
                self._recheck_space(arm)

    def count(self, what: str) -> None:
        self.state.counts[what] = self.state.counts.get(what, 0) + 1

    def note(self, command: Command, kind: NoteKind, **facts: Unpack[NoteFacts]) -> None:
        """Write a note. The phase stays."""
        self.enter(command, command.phase, kind, **facts)

    def enter(
        self,
        command: Command,
        phase: Phase,
        kind: NoteKind = NoteKind.PHASE,
        **facts: Unpack[NoteFacts],
    ) -> None:
        """Change the phase and write a note."""
        state, notes = self.state, command.notes
        state.seq += 1
        command.phase = phase
        note = ProgressNote(
            seq=state.seq,
            at_s=self.now,
            command=command.id,
            phase=phase,
            kind=kind,
            step=command.step_words,
            node=self.node,
            took_s=self.took_s,
            **facts,
        )
        notes.append(note)
        if len(notes) > NOTES_KEPT:
            del notes[NOTES_KEPT // 2]
        if command.progress or (state.has_subscribers and not command.unwatched):
            self.effects.append(PublishNote(client=command.client if command.progress else "", note=note))

    def create_job(
        self,
        command: Command,
        worker: WorkerKind,
        data: JobInput,
        locations: tuple[str, ...] | None = None,
        *,
        kind: JobKind = JobKind.STAGE,
    ) -> None:
        """Create the next job of this command, with the programs the command began with, and dispatch it."""
        command.jobs += 1
        command.job = PendingJob(
            id=f"{command.id}/{command.jobs}",
            attempt=1,
            worker=worker,
            kind=kind,
            program="" if kind is JobKind.REHEARSAL else command.programs.get(worker, ""),
            input=wire.raw(data),
            locations=locations,
            since_s=self.now,
        )
        self.dispatch_again(command)

    def motions_beside(self, command: Command) -> list[Primitive]:
        """The motions of other commands, for a planner's next job; what the job knows is kept in the command."""
        state = self.state
        command.motions_seen = (state.motions_begun, state.motions_ended)
        if not state.motions:  # the usual case
            command.beside = ()
            return []
        others = {motion.primitive: motion.body for motion in state.motions.values() if motion.command != command.id}
        command.beside = tuple(others)
        return [wire.opaque(body, Primitive) for body in others.values()]

    def dispatch_again(self, command: Command) -> None:
        """Dispatch the job of a command once more: jobs are stateless."""
        assert command.job is not None
        programs = command.programs if command.job.kind is JobKind.REHEARSAL else NO_PROGRAMS
        self.dispatch(command.job, command.client, programs)

    def dispatch(self, job: PendingJob, client: str = "", programs: dict[str, str] = NO_PROGRAMS) -> None:
        """`client`: the client of its command; empty for a command that has ended. `programs`: of a rehearsal."""
        if job.kind is JobKind.LOAD:
            self.effects.append(LoadPart(job=job.id, attempt=job.attempt, kind=job.worker, name=job.about))
            return
        self.effects.append(
            DispatchJob(
                job=job.id,
                attempt=job.attempt,
                kind=job.worker,
                queue=REHEARSER if job.kind is JobKind.REHEARSAL else job.worker,
                program=job.program,
                cell=self.state.programs.get("cell", ""),
                input=job.input,
                locations=job.locations,
                client=client,
                programs=programs,
                doubt=job.about,
            )
        )

    def start_timer(self, command: Command, limit_s: float, subsystems: Sequence[str] = ()) -> None:
        """`subsystems`: the limit counts their own time (`StartTimer`)."""
        command.due_s = self.now + limit_s
        self.effects.append(StartTimer(timer=command.id, at_s=command.due_s, subsystems=subsystems))

    def stop_timer(self, command: Command) -> None:
        command.due_s = 0.0
        self.effects.append(StopTimer(timer=command.id))


def step_in_words(actions: ActionStack[ScriptHead, msgspec.Raw]) -> str:
    """Describe the current step: "5 of 9: feel one side", or "trim 2, 1 of 1: ..."."""
    assert actions.step is not None
    trim, index = actions.step
    label = read_step(actions.step_body).label
    if trim == NOMINAL:
        return f"{index + 1} of {len(actions.script.steps)}: {label}"
    return f"trim {trim}, {index + 1} of {len(actions.trim(trim).steps)}: {label}"
