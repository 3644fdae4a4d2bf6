"""A recorded drive and its parts: streams, scans, motions between stamps, pose graphs."""
