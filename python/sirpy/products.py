"""What the products of a workspace are made of: its fused points, in the frame of its georeference."""

from __future__ import annotations

from sirpy.cloud import Cloud
from sirpy.fusion import fused_parts
from sirpy.georeference import begin_products, read_frame
from sirpy.workspace import Workspace


def open_cloud(workspace: Workspace) -> Cloud:
    """The cloud that products are made of; what was made of another cloud or frame is removed.

    Raises:
        InputError: there is no complete cloud, or a part of it is damaged.
    """
    parts = fused_parts(workspace)
    frame = read_frame(workspace)
    begin_products(workspace, frame)
    return Cloud(parts, frame)
