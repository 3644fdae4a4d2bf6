"""Posteriors: what inference answers, whatever the family of beliefs.

An outcome keeps what a family found, and a `Posterior` asks it; there are a status with figures,
the kinds of beliefs, and the records that a posterior shows: innovations, gates, associations.
"""
