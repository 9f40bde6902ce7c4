"""Give the sentences of both arms at once. Each command reserves what it needs; those of one arm wait for each other.

Needs a running cluster: rtc up -d
"""

from rtc import Client
from rtc.protocol.messages import CommandEnded, Phase, ProgressNote

TASK = [
    "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A",
    "GRASP LEFT-END-EFF MACS-OLD HANDLE-B",
    "RELEASE MACS-NEW WITH RIGHT-ARM AFTER {0}",
    "RELEASE MACS-OLD WITH LEFT-ARM AFTER {1}",
]


class Overlap:
    """The most commands that moved at the same time."""

    def __init__(self) -> None:
        self.moving: set[str] = set()
        self.most = 0

    def __call__(self, note: ProgressNote) -> None:
        if note.phase is Phase.EXECUTING:
            self.moving.add(note.command)
        else:
            self.moving.discard(note.command)
        self.most = max(self.most, len(self.moving))


def main() -> None:
    overlap, numbers = Overlap(), dict[int, str]()

    def accepted(n: int, command: str) -> None:
        numbers[n] = command

    def ended(n: int, end: CommandEnded) -> None:
        print(f"{end.command}  {end.outcome.kind.value}  {end.text}")

    with Client() as rtc:
        grasps = rtc.run_many(TASK[:2], on_accept=accepted, on_progress=overlap, on_end=ended)
        releases = [text.format(*(grasp.command for grasp in grasps)) for text in TASK[2:]]
        for end in [*grasps, *rtc.run_many(releases, on_progress=overlap, on_end=ended)]:
            end.raise_for_outcome()
        for end in rtc.run_many(["STOW RIGHT-ARM", "STOW LEFT-ARM"], on_progress=overlap, on_end=ended):
            end.raise_for_outcome()
    print(f"at most {overlap.most} commands moved at the same time")


if __name__ == "__main__":
    main()
