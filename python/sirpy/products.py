"""What the products of a workspace are made of: its fused points, in the frame of its georeference."""

from __future__ import annotations

from sirpy.cloud import Cloud
from sirpy.files import fingerprint
from sirpy.fusion import fused_parts
from sirpy.georeference import read_frame
from sirpy.workspace import Workspace


def open_cloud(workspace: Workspace) -> Cloud:
    """The cloud that products are made of; what was made of another cloud or frame is removed.

    Raises:
        InputError: there is no complete cloud, or a part of it is damaged.
    """
    frame = read_frame(workspace)
    parts = fused_parts(workspace)
    place = [frame.crs, frame.scale, frame.rotation.tolist(), frame.translation.tolist()]
    workspace.begin_stage("products", fingerprint(workspace.fingerprint_of("fuse"), place))
    return Cloud(parts, frame)
