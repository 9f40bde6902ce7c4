"""What cameras see: AprilTags in pictures, and poses of objects from them.

It must not know the true state of a simulator, the renderer or the broker.
"""
