"""The broker's shell: sockets, clock and journal around the Decision Unit; bytes to events, effects to bytes.

Must not decide anything.
"""
