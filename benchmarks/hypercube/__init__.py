"""A simulator of the cluster at any size, with measured service and link times.

`measure` and its parts time single processes of the real cluster. The model (`queues`, `cluster`) uses these times, and
nothing of the benchmarks that it is checked against.
"""
