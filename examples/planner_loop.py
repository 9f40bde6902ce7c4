"""A planner in forty lines: it has goals, methods for each, and a report for every sentence.

A method is tested before it is done (`rtc.test`): one that is not feasible costs no motion. If a sentence fails in
spite of its test, the first advice with sentences is followed once. Then the next method follows.
Needs a running cluster: rtc up -d
"""

from dataclasses import dataclass

from rtc import Client, Outcome, OutcomeKind

DONE = OutcomeKind.SUCCEEDED


@dataclass(frozen=True)
class Goal:
    name: str
    methods: list[list[str]]  # each a list of sentences; the first feasible one is performed


GOALS = [
    Goal(
        "MACS-NEW is lifted",
        [
            # The left arm does not reach RACK-1. The test finds it out without motion.
            ["GRASP LEFT-END-EFF MACS-NEW HANDLE-B", "LIFT MACS-NEW BY 15 CM WITH LEFT-ARM"],
            ["GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM"],
        ],
    ),
    Goal("MACS-NEW is back", [["PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM", "STOW RIGHT-ARM"]]),
]


def advice(outcome: Outcome) -> list[str]:
    """The sentences of the first alternative that a machine can do: none in which a person looks and states facts."""
    options = outcome.refusal.clears if outcome.refusal else []
    return next((one.sentences for one in options if one.sentences and not one.states and not one.instead), [])


def perform(rtc: Client, sentences: list[str]) -> bool:
    """Whether all sentences have succeeded; what would clear a failure is tried once for each."""
    for sentence in sentences:
        outcome = rtc.run(sentence).outcome
        if outcome.kind is not DONE and (advised := advice(outcome)):
            print(f"    {outcome.message}\n    clearing it: {', then '.join(advised)}")
            for one in advised:
                rtc.run(one)
            outcome = rtc.run(sentence).outcome
        print(f"    {outcome.kind.value}: {sentence}")
        if outcome.kind is not DONE:
            return False
    return True


def reach(rtc: Client, goal: Goal) -> bool:
    """Whether a method has reached the goal. They are tried in order."""
    for n, method in enumerate(goal.methods, 1):
        tested = rtc.test(method)
        if tested[-1].outcome.kind is not DONE:
            print(f"  method {n} is not feasible: {tested[-1].outcome.message}")
        elif perform(rtc, method):
            return True
    return False


def main() -> None:
    with Client(source="aip") as rtc:
        for goal in GOALS:
            print(goal.name)
            if not reach(rtc, goal):
                raise SystemExit(f"no method reaches the goal: {goal.name}")


if __name__ == "__main__":
    main()
