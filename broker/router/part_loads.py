"""Parts of the delivered programs that a sentence loads (LOAD name INTO kind): the queue of loads does it as a job.

The answer of the job is a script with one step, whose result states the changes.
"""

from __future__ import annotations

from broker.decisions.effects import LoadPart
from broker.decisions.events import Event, JobDeclined, JobFinished
from broker.persistence.program_store import StoredProgram
from broker.router.core import Core
from rtc.programs import loader
from rtc.protocol import wire
from rtc.protocol.advice import by_person
from rtc.protocol.messages import AnswerStep, ProgramText, Script, ScriptContext
from rtc.protocol.outcomes import Refusal, RefusalReason

NODE = "broker"


def begin(core: Core, effect: LoadPart, now: float) -> None:
    """Queue the load of this part; decline the job of an unknown one."""
    path = loader.part(effect.kind, effect.name)
    if path is None:
        known = list(loader.parts(effect.kind))
        message = f"the delivered {effect.kind.value} programs have no part {effect.name}"
        clears = "one of the names expected; a file of your own: rtc load FILE INTO " + effect.kind.value
        refusal = Refusal(reason=RefusalReason.NAME, message=message, expected=known, clears=by_person(clears))
        core.enqueue(_declined(effect, refusal, now))
        return
    text = ProgramText(request=effect.job, kind=effect.kind, name=path.name, body=path.read_bytes())
    if (too_many := core.loads.add(effect, text)) is not None:
        core.enqueue(_declined(effect, too_many, now))


def answer(effect: LoadPart, text: ProgramText, loaded: StoredProgram | Refusal, now: float) -> Event:
    """The answer of the job whose load has ended."""
    if isinstance(loaded, Refusal):
        return _declined(effect, loaded, now)
    says = "; ".join(loaded.changes) or f"{text.name} is in use already: nothing has changed"
    step = AnswerStep(name="state", label=f"load {text.name} into {text.kind.value}", says=says)
    product = Script(context=ScriptContext(verb="", script="load"), case=1, steps=[step])
    return JobFinished(at_s=now, job=effect.job, attempt=effect.attempt, node=NODE, product=wire.raw(product))


def _declined(effect: LoadPart, refusal: Refusal, now: float) -> JobDeclined:
    """A program that does not check is no fault of a worker's program, which would be tried with another one."""
    reason = RefusalReason.STATE if refusal.reason is RefusalReason.PROGRAM else refusal.reason
    kept = Refusal(reason=reason, message=refusal.message, expected=refusal.expected, clears=refusal.clears)
    return JobDeclined(at_s=now, job=effect.job, attempt=effect.attempt, node=NODE, refusal=kept)
