"""Press a held module against the back of its seat until 8 N are felt, and read what was measured.

A motion that ends by its UNLESS clause ends as failed, because its goal is not reached: here that is what is wanted.
Needs a running cluster: rtc up -d
"""

from rtc import Client, StopReason

PRESS = "PUSH MACS-NEW BY 3 CM WITH RIGHT-ARM UNLESS FORCE EXCEEDS 8 N THEN STOP REPORT POSE AND FORCES"


def main() -> None:
    with Client() as rtc:
        rtc.run("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A").raise_for_outcome()
        pressed = rtc.run(PRESS).outcome
        measured = pressed.measured
        if pressed.stop is not StopReason.FORCE_LIMIT or measured is None or measured.tcp_pose is None:
            raise SystemExit(f"no contact within 3 cm: {pressed.message}")
        x, y, z = (100 * value for value in measured.tcp_pose[:3])
        print(f"contact with {measured.peak_force_n:.1f} N, with the hand at x {x:.1f}, y {y:.1f}, z {z:.1f} cm")
        # After a contact the module may stand elsewhere than believed, so it is located again before anything else.
        for sentence in ("RELEASE MACS-NEW", "RETRACT RIGHT-ARM", "LOCATE MACS-NEW", "STOW RIGHT-ARM"):
            rtc.run(sentence).raise_for_outcome()


if __name__ == "__main__":
    main()
