"""The world database: model (pure), store, server process, client and leases.

Facts have a value, a validity, a version and a source. Only analyzers write them, each under a lease. This package
knows neither commands nor programs.
"""
