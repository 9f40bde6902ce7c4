"""A cluster whose own work is next to nothing: real broker, real shells, real world; trivial worker functions and a
subsystem that is done at once. What is measured with it is what the RTC itself costs per command."""
