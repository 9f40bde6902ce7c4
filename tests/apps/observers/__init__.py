"""Tests of what watches a cluster: a package, as else pytest ends what they share at the end of all tests."""
