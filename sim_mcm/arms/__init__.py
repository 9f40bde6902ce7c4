"""Arms and their cells: exact (kinematic) and physical (pybullet), servo, hand, control laws, seats.

Must not know commands, sockets or reports.
"""
