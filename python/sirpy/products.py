"""What the products of a workspace are made of: its fused points, in the frame of its georeference."""

from __future__ import annotations

from sirpy.cloud import Cloud
from sirpy.errors import InputError
from sirpy.files import fingerprint
from sirpy.georeference import read_frame
from sirpy.workspace import Workspace


def open_cloud(workspace: Workspace) -> Cloud:
    """The cloud that products are made of; what was made of another cloud or frame is removed.

    Raises:
        InputError: there is no complete cloud, or a part of it is damaged.
    """
    frame = read_frame(workspace)
    parts = [workspace.fused_part(sub_image) for _, sub_image in workspace.sub_images()]
    missing = [part for part in parts if not part.exists()]
    if missing:
        raise InputError(f"there is no {missing[0]}: run `sirpy fuse` first")
    place = [frame.crs, frame.scale, frame.rotation.tolist(), frame.translation.tolist()]
    workspace.begin_stage("products", fingerprint(workspace.fingerprint_of("fuse"), place))
    return Cloud(parts, frame)
