"""Facts that a user states: of one object or seat, of a place, of a verb, or all of a file."""

from __future__ import annotations

from rtc.protocol.messages import AnswerStep, HandOverStep, TellStep
from workers.mechanisms.facts import assess, bind, elaborate
from workers.mechanisms.mechanism import Mechanism

MECHANISM = Mechanism(
    name="facts",
    states=elaborate.script,
    stated={"frame": elaborate.frame, "attitude": elaborate.attitude, "orientation": elaborate.attitude},
    actions={TellStep: bind.bind_stated_facts, AnswerStep: bind.bind_answer, HandOverStep: bind.bind_answer},
    plausible=assess.PLAUSIBLE,
    follows={"facts": assess.whole},
    impossible=assess.too_heavy,
    contradictions=(assess.postures, assess.spreads, assess.names, assess.mounts, assess.hands),
)
