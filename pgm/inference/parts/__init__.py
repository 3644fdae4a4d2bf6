"""Many runs in parts: cut out, worked through in turn or by an executor, and joined."""
