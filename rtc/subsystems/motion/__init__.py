"""Execution of primitives: acceptance, profiles, stop functions, reports, and the subsystem of several arms. Pure.

Must not know pybullet, sockets or clocks.
"""
