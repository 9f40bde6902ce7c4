"""What a mechanism of the robot is given: the task of a stage, and what all mechanisms use to do theirs."""

from __future__ import annotations
