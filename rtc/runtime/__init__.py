"""What every process of a cluster shares: start, sockets, settings, keys, fork server, handover, locks.

Must not know commands, skills or motions.
"""
