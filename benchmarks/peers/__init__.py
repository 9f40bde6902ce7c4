"""Peers: the same chain of four stages on other frameworks, with payloads of the same sizes, in the same run.

A command is four jobs in a row. Each gets the bytes of the one before, and makes as many as the same stage of
ours. The peers only pass bytes on: none has a journal, decisions, resources, or recovery of lost work. Each module is a
program of its own, `python -m benchmarks.peers.NAME` (see `chain.main`), so that its imports and processes end with it.
"""
