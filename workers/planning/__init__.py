"""Planning shared by elaborator, binder and analyzer: queries on the world, robot models, path segments, motions.

Must not know scripts, reports or sockets.
"""
