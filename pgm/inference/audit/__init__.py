"""The evidence audit: how far a Gaussian answer is from the exact one, by importance sampling."""

from pgm.inference.audit.result import Audit
from pgm.inference.audit.run import audit

__all__ = ["Audit", "audit"]
