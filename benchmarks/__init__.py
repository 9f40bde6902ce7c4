"""Benchmarks of speed: `python -m benchmarks.NAME` prints the question, the progress and the result."""
