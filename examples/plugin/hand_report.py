"""What REPORT HAND measures: opening and grip force of the hand. It is called in the loop of the MCM."""


def measure(arm):
    return {"opening_mm": 1000 * arm.width_m, "grip_n": arm.grip_n}
