"""What elaborator, binder and analyzer share of a command: reflexes, stop conditions, cameras, names of bindings.

Must not know scripts, programs of one worker, or sockets.
"""
