"""Pick a module up, carry it to another place in the air, and put it back on its rack.

Needs a running cluster: rtc up -d
"""

from rtc import Client, NotSucceeded
from rtc.wording.advice import in_one_line

TASK = [
    "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A",
    "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM",
    "MOVE RIGHT-ARM BY 10 CM ALONG BACK MAINTAIN SPEED 10 CM/S",
    "PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM",
    "STOW RIGHT-ARM",
]


def main() -> None:
    with Client() as rtc:
        for sentence in TASK:
            try:
                ended = rtc.run(sentence).raise_for_outcome()
            except NotSucceeded as error:
                refusal = error.outcome.refusal
                advice = in_one_line(refusal.clears) if refusal else ""
                raise SystemExit(f"{error}\nto clear it: {advice or 'see rtc why'}") from None
            print(f"{ended.command}  {ended.took_s:5.1f} s  {sentence}")


if __name__ == "__main__":
    main()
