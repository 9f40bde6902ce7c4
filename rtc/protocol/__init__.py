"""What processes send to each other: messages, payloads, outcomes, roles, and their encoding. Pure.

Must not know sockets, clocks, files, or any process.
"""
