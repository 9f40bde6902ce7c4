"""Launchers that start remote workers on engines of others: Ray, Kubernetes, Nomad, systemd, Slurm.

Each launcher only states the line of a worker, its key and the number of workers. No other package imports an engine.
"""
