"""Request the item of the package in this directory.

Install it before the cluster starts: pip install ./examples/plugin && rtc up -d
"""

from rtc import Client


def main() -> None:
    with Client() as rtc:
        ended = rtc.run("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A REPORT HAND").raise_for_outcome()
        assert ended.outcome.measured is not None
        hand = ended.outcome.measured.others["HAND"]
        print(f"the hand holds at {hand['opening_mm']:.1f} mm with {hand['grip_n']:.0f} N")
        for sentence in ("RELEASE MACS-NEW", "STOW RIGHT-ARM"):
            rtc.run(sentence).raise_for_outcome()


if __name__ == "__main__":
    main()
