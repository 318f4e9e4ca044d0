"""The choices that commands offer for other engines, apart from what carries them out."""

from __future__ import annotations

from typing import Literal

Engine = Literal["COLMAP", "PMVS", "CMP-MVS", "MVSNET"]

MvsnetDepths = Literal["range", "interval"]
"""The line of depths of a camera: `range` is DEPTH_MIN DEPTH_MAX, as PatchmatchNet reads it; `interval`
is DEPTH_MIN DEPTH_INTERVAL DEPTH_NUM DEPTH_MAX, as MVSNet, CasMVSNet, IterMVS, UniMVSNet ... do."""

CopyPolicy = Literal["copy", "hard-link", "soft-link"]
"""How a file gets a second name."""

FewPoints = Literal["keep", "drop"]
