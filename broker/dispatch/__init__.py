"""Which worker gets a job, how many workers there are, and which timers run. Pure; the time is an argument.

Must not know commands or sockets.
"""
