"""Work-cells as data: the reader of cell files, checks of robot models, and the cells that come with the project.

Must not know kinematics.
"""
