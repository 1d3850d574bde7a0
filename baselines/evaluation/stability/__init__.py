"""Where a policy is stable about steady motion."""
