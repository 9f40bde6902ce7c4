"""The machine of a command: its table, and its actions by what they are about. Pure.

Must not know sockets, clocks, files, or any skill.
"""
