"""The swap-out of a module, as a planner, an operator and a film: a program of a user, in several files."""
