"""Where on the Earth a model lies."""

from __future__ import annotations

from sirpy.frame import Frame
from sirpy.workspace import Workspace


def read_frame(workspace: Workspace) -> Frame:
    """The frame of the workspace's products."""
    return Frame()
