"""Pictures of a cell: the believed or true scene to draw, and the drawing process as its clients see it.

Must not know how a picture is drawn (`sim_mcm.cameras`).
"""
