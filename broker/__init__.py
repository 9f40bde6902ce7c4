"""The broker: one process that accepts commands, decides what follows, and routes messages between all others.

It knows phases, jobs and resources. It names no skill, plans no motion, and must not import workers, sim_mcm or deploy.
"""
