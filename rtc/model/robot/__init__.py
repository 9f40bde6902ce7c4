"""Robot models: forward and inverse kinematics, collision checks and trajectory bounds.

Computed from the URDF and SRDF texts of a cell. This package knows neither tasks nor the world database.
"""
