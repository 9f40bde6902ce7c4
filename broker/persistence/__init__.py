"""What the broker keeps on disk: the write-ahead journal, its replay, and the bodies of programs.

Must not decide anything.
"""
