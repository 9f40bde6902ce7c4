"""What the model check explores: two commands or three, and every way in which they can meet."""

from __future__ import annotations

from tests.simulation.model import Scenario, Sentence

LEFT, RIGHT, BOTH = ("LEFT-ARM",), ("RIGHT-ARM",), ("LEFT-ARM", "RIGHT-ARM")
ONE = Sentence()


def _control(verb: str, object: str | None = "C-1", hand: str | None = None) -> Sentence:
    return Sentence(parsed=(("kind", "control"), ("verb", verb), ("hand", hand), ("object", object)))


def _moving(arm: tuple[str, ...], meets: tuple[str, ...]) -> Sentence:
    return Sentence(arms=arm, meets=meets[0], moves=True)


SCENARIOS = (
    Scenario(name="same arm", sentences=(ONE, ONE)),
    Scenario(name="same arm, one client", sentences=(ONE, ONE), one_client=True),
    Scenario(name="three of one client", sentences=(ONE, Sentence(arms=BOTH), ONE), one_client=True),
    Scenario(name="same arm, a trim", sentences=(Sentence(trims=1), ONE)),
    Scenario(name="different arms", sentences=(ONE, Sentence(arms=LEFT))),
    Scenario(name="both arms, then one", sentences=(Sentence(arms=BOTH, steps=2), Sentence(arms=LEFT, empty_steps=1))),
    Scenario(name="arms in each other's way", sentences=(_moving(RIGHT, LEFT), _moving(LEFT, RIGHT)), faults=1),
    Scenario(name="a test beside a command", sentences=(ONE, Sentence(parsed=(("test", True),)))),
    Scenario(name="facts stated", sentences=(ONE, Sentence(stated=True, trims=1))),
    Scenario(name="after", sentences=(ONE, Sentence(parsed=(("after", "C-1"),)))),
    Scenario(name="together with", sentences=(ONE, Sentence(arms=LEFT, parsed=(("together_with", "C-1"),)))),
    Scenario(name="now", sentences=(ONE, Sentence(parsed=(("now", True),)))),
    Scenario(name="HALT as a sentence", sentences=(ONE, Sentence(text="HALT"))),
    Scenario(name="HALT C-1 as a sentence", sentences=(ONE, Sentence(text="HALT C-1"))),
    Scenario(name="abort", sentences=(ONE, _control("ABORT"))),
    Scenario(name="abort of an arm", sentences=(ONE, _control("ABORT", None, "RIGHT-ARM"), ONE), one_client=True),
    Scenario(name="pause, resume", sentences=(Sentence(steps=2), _control("PAUSE"), _control("RESUME"))),
    Scenario(name="client goes away", sentences=(ONE, Sentence(arms=LEFT, halt_if_lost=True))),
    Scenario(name="a lost journal", sentences=(Sentence(steps=2), ONE), losses=True),
    Scenario(name="halt of an arm, of a command", sentences=(ONE, Sentence(arms=LEFT)), halts=("RIGHT-ARM", "C-2")),
)
