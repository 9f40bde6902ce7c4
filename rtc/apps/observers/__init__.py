"""Processes that watch a cluster from outside: the recorder, and metrics with traces.

They subscribe to what broker and MCM publish anyway, and may be killed at any time. Neither broker, MCM nor workers
may import them. The libraries they need are extras, imported only where they are used.
"""
