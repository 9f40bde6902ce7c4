"""What all worker processes share: the job loop, preloading, and imports without unused libraries.

Must not know what a worker function does.
"""
