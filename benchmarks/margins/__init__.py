"""How far from its thresholds does each verb end, and how far are the failures that they are for?"""
