"""Names of bindings that the elaborator makes and the binder reads."""

POSE_OF_JOINTS = "/plan"  # suffix: NAME/plan is the pose from which the joint values NAME were solved
