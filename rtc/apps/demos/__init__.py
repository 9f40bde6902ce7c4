"""Scenarios that start their own cluster, comment on its work and check the results."""
