"""Poses and rotations, hinges and named axes: plain figures, without any cell, robot or world."""
