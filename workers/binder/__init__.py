"""The binder: one step and the world become a primitive (P, M, F, R), or a refusal.

Must not know sockets, nor any skill by name.
"""
