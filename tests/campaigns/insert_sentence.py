"""Does the sentence INSERT bring a module into a seat that is not where it is believed to be?

The scene is that of `tests.campaigns.displaced_seat`. One sentence, INSERT, carries the module over the lips and into
the slot (1.5 mm of clearance), tugs at it, lets go and backs off. A run succeeds if the command does too. If it does
not, its advice is followed literally. For
comparison, the same errors with PLACE, which is position-controlled (`--rigid`).

    python -m tests.campaigns.insert_sentence [--runs 100]
"""

from __future__ import annotations

from functools import partial

from rtc.spatial.geometry import Array
from tests.campaigns import advice
from tests.campaigns.displaced_seat import ARM, BAY, MODULE, BeforeBay, Run, arguments, campaign

INSERT, PLACE = f"INSERT {MODULE} INTO {BAY} WITH {ARM}", f"PLACE {MODULE} ON {BAY} WITH {ARM}"


class Commander(BeforeBay):
    """Inserts by a sentence."""

    def __init__(self, sentence: str) -> None:
        super().__init__()
        self._sentence = sentence

    def run(self, offset: Array) -> Run:
        self.displace(offset)
        done = self.bench.do(self._sentence)
        why = done.failure or done.refusal
        peak_n = max((report.peak_force_n for report in done.reports[1:]), default=0.0)
        run = self.judge(False, peak_n, 1 + len(done.trims), why.message if why else "")
        run = run._replace(true=run.seated if done.succeeded else bool(run.failed) and self.holds_still())
        if done.succeeded:
            return run
        return run._replace(followed=advice.follow_on_bench(self.bench, self._sentence, done))


def main() -> None:
    given = arguments(__doc__).parse_args()
    verb = "PLACE" if given.rigid else "INSERT"
    make = partial(Commander, PLACE if given.rigid else INSERT)
    campaign("insert_sentence", f"does {verb} seat a module in a displaced seat?", make, given)


if __name__ == "__main__":
    main()
