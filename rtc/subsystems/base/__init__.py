"""What every subsystem does towards the broker, whatever it moves or measures: orders, reports, halts, the connection.

The MCM and S&P build on it. It knows neither arms nor cameras.
"""
