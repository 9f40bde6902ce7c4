"""The Decision Unit: `decide(state, event) -> effects`, its table, actions, resources and invariants. Pure.

Must not know sockets, clocks, files, or any skill.
"""
