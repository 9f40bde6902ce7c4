"""The elaborator: a parsed command and the world become a script of steps, or a refusal.

Must not know sockets, nor any skill by name.
"""
