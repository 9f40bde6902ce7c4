"""A cluster for load tests: the real broker, worker loop and world, with trivial worker functions.

Its subsystem ends each primitive at once. What is measured with it is the cost of the RTC itself per command.
"""
