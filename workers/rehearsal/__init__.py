"""Rehearsals: sentences performed on paper, with predicted reports instead of a subsystem and an overlay instead of the
world (R142). Pure.
"""
