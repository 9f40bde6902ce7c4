"""Stateless workers: parser, elaborator, binder and analyzer, one process each, all run by the same worker loop.

A worker maps a job (program, cell, world, input) to a product or a refusal. It may import `rtc`, but not `broker`,
`sim_mcm` or `deploy`; it keeps no state from one job to the next except caches.
"""
