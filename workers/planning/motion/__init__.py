"""Motion planning for one arm: paths, inverse kinematics, constraints, collision tests and time parametrization.

Pure functions of a `PlanningRequest`. The package knows no command, no script and no world database.
"""
