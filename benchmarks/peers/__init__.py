"""The same four-stage chain on other people's machinery, with payloads of the same size, in the same run.

Each module has `measure(sizes, for_s, repeats) -> list[float]`: commands per second, one figure per repeat, after a
warm-up. A command is four jobs, each of which gets the bytes of the one before and returns as many as its stage does
with us. None of them journals, decides, holds resources, or answers for what it has lost.
"""
