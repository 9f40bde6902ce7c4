"""Deployment of one cluster: supervisor, child processes, restart policy, run directory and cube addresses.

It starts, watches and restarts processes, from a list of specs. It knows nothing of commands, programs or motion.
"""
