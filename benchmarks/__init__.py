"""How fast it is. Each is `python -m benchmarks.NAME`: states its question, shows progress, keeps its result."""
