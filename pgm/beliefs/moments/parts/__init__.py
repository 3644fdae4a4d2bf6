"""Many runs in parts: cut out, worked through in turn or by an executor, and joined.

A *part* is a slice of the runs with its evidence; a *job* is the work on it; its *share* is the
portion of its posterior that is sent back. The *room* is a list of arrays for all runs into which
the parts' results go, in memory that workers share if they can.
"""
