"""sirpy: dense 3D reconstruction at native resolution by sub-image recapture."""

import os

__version__ = "0.1.0"

# Before the C++ core is loaded: idle OpenMP threads sleep. While rows are decoded by one thread the
# others would otherwise spin, which doubles the CPU time of a cut.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
