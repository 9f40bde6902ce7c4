"""The client SDK: connection, halts, heartbeat, and what can be read of a run, present or past.

Only `rtc.apps.cli`, `rtc.apps.demos`, tests and benchmarks build on it. Broker, workers and MCM must not import it.
"""
