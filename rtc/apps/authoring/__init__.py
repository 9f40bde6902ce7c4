"""Cells of users: a first cell file for an arm, and all faults of a cell, URDF or SRDF at once.

It knows the models and the cell format, no clusters and no physics.
"""
