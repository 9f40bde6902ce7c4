"""Simulated cameras and pictures: drawing, lens, tag plates, films, and the process S&P of a simulated cell."""
