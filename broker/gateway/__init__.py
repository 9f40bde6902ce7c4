"""The gateway: the one process that other machines reach over tcp, with CURVE keys and roles.

Must not know commands; it forwards what a role permits.
"""
