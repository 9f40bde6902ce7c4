"""What a work-cell and its arms are: `cells` (the cell as data) and `robot` (kinematics, bodies, collision)."""
