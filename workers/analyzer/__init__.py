"""The analyzer: an end report is judged; its product is continue, trim or abort, and the change to the world.

Must not know sockets, nor any skill by name.
"""
