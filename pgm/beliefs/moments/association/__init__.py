"""Sightings of unknown identity, associated with what they may be of."""
