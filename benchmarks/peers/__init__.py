"""The same chain of four stages on other people's machinery, with payloads of the same sizes, in the same run.

A command is four jobs in a row, each given the bytes that the one before has made, and making as many as its stage
makes with us. None of the peers journals, decides, holds resources, or answers for what was lost; they only have to
pass bytes on. Each module is a program of its own, `python -m benchmarks.peers.NAME` (see `chain.main`), so that what
it imports and starts is gone with it.
"""
