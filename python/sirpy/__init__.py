"""sirpy: dense 3D reconstruction at native resolution by sub-image recapture."""

__version__ = "0.1.0"
