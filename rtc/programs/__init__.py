"""Programs of the workers: loading, schema, checks, expressions. `default/` has the programs of each kind as data.

Must not know any worker; names of code are registered in `extension_names`.
"""
