"""What performs primitives: `base` (towards the broker), `motion` (arms and hands), `perception` (cameras).

A subsystem of your own builds on `base`; an MCM of your own on `motion`. No simulator is known here.
"""
