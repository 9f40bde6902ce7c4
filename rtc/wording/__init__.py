"""Facts of messages in words for people: the one place where the texts of notes are made. Pure.

The command line, the console and the observers use it. Must not know them, sockets or clocks.
"""
