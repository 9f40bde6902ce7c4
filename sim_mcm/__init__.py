"""The simulated MCM: executes primitives on two arms, obeys halts, reports to the broker.

Imports `rtc` only. It must not know sentences, scripts, workers or the world database.
"""
