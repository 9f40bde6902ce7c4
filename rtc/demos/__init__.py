"""Scenarios that bring their own cluster and tell their story."""
