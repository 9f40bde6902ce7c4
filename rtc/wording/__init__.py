"""Facts of messages in words for people: notes, commands, measurements, rehearsals, facts of the world. Pure.

The command line, the console and the observers use it. Must not know them, sockets or clocks.
"""
