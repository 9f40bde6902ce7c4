"""The command line `rtc`: one module per group of commands, and what they share to print and to ask.

It uses the client only, like any other program, and starts a cluster in a process of its own (`python -m deploy`).
"""
