"""Tests of what watches a cluster. They are a package: pytest ends what is shared by one at its end, else at the last."""
