"""An operator as a program: it turns the wrist of an arm while the cluster moves the arm to its place.

The stream goes on while the deadman is held. DONE is believed only when the measurements prove it.
Needs a running cluster: rtc up -d
"""

import time

from rtc import Client, OutcomeKind
from rtc.client.hand_controller import PERIOD_S, STILL, HandController

SHARED = "MOVE RIGHT-ARM TO CLEAR-POINT-1 MAINTAIN SHARED WRIST"
TURN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.1)  # m/s, rad/s
FASTEST = 0.3  # m/s, rad/s, on the way that a waiting path asks for
TURN_S, REST_S, LIMIT_S = 2.0, 0.5, 60.0


def wait_for_request(hand: HandController) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not hand.request:
        if time.monotonic() > end_s:
            raise SystemExit(f"nothing is asked of the operator with {hand.arm}")
        time.sleep(PERIOD_S)
    print(f"asked: {hand.request}")


def follow(hand: HandController, turn_s: float) -> None:
    """Turn the wrist for a while, and hold the deadman until the arm is at its place; then let go.

    While the path waits, go the way that it waits for: a wrist as it is does not allow every path."""
    began_s, on_the_way = time.monotonic(), True
    while on_the_way and (operation := hand.operation) is not None:
        turning = (elapsed_s := time.monotonic() - began_s) < turn_s
        wanted = [max(-FASTEST, min(FASTEST, x)) for x in operation.towards] or (TURN if turning else STILL)
        if refused := hand.move(wanted):
            print(f"did nothing: {refused}")
        off_m, done_m = operation.off_m or 0.0, operation.done_m or 0.0
        on_the_way = turning or off_m > 0.5 * done_m
        if elapsed_s > LIMIT_S:
            raise SystemExit(f"{hand.arm} is still {off_m:.3f} m from its place; {operation.cut}")
        time.sleep(PERIOD_S)
    hand.release()
    time.sleep(REST_S)


def done(rtc: Client) -> bool:
    outcome = rtc.run("DONE").outcome
    print(f"DONE {outcome.kind.value}: {outcome.message}")
    return outcome.kind is OutcomeKind.SUCCEEDED


def main() -> None:
    with Client() as rtc, rtc.hand("RIGHT-ARM", "ADA") as hand:
        command = rtc.submit(SHARED)
        try:
            wait_for_request(hand)
            if done(rtc):
                raise SystemExit("DONE was believed before the arm has moved")
            follow(hand, TURN_S)
            while not done(rtc) and hand.request:
                follow(hand, 0.0)
        except BaseException:
            rtc.run("TAKE RIGHT-ARM FROM OPERATOR")  # what is not finished stays the operator's
            raise
        command.wait(LIMIT_S).raise_for_outcome()
        rtc.run("STOW RIGHT-ARM").raise_for_outcome()
        print("both have moved the arm, and it is stowed")


if __name__ == "__main__":
    main()
