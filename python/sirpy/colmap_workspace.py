"""What COLMAP's dense commands need in a workspace beside images and model: lists, folders, run
scripts."""

from __future__ import annotations

import numpy as np

from sirpy.files import fingerprint, written_whole
from sirpy.model_arrays import read_arrays
from sirpy.workspace import Workspace

_SCRIPT = """\
#!/bin/sh
# Dense reconstruction of this workspace by COLMAP at full resolution. COLMAP names the program to
# use.
set -e
workspace=$(cd "$(dirname "$0")" && pwd)
colmap=${{COLMAP:-colmap}}
"$colmap" patch_match_stereo --workspace_path "$workspace" --workspace_format COLMAP \\
  --PatchMatchStereo.max_image_size -1 --PatchMatchStereo.geom_consistency {geometric}
"$colmap" stereo_fusion --workspace_path "$workspace" --workspace_format COLMAP \\
  --input_type {kind} --StereoFusion.max_image_size -1 --output_path "$workspace/fused.ply"
"$colmap" poisson_mesher --input_path "$workspace/fused.ply" \\
  --output_path "$workspace/meshed-poisson.ply"
"""


def write_dense_folder(workspace: Workspace, source_images: int) -> list[str]:
    """Writes `stereo/` and the run scripts.

    Sub-images without sparse points are in no list: COLMAP's patch match aborts where it cannot
    tell a depth range.

    Args:
        source_images: how many source images COLMAP shall choose for each reference.

    Returns:
        The names of the sub-images without sparse points.

    Raises:
        OutputError: the workspace cannot be written.
    """
    model = read_arrays(workspace.sparse, may_be_empty=True)
    points = dict(zip((i.name for i in model.images), np.diff(model.starts), strict=True))
    names = sorted(name for name, count in points.items() if count > 0)
    # What COLMAP writes here belongs to this cut: cutting anew clears it away.
    inputs = fingerprint("colmap", source_images, workspace.fingerprint_of("cut"))
    if not workspace.begin_stage("views", inputs):
        workspace.begin_stage("stereo", inputs)
    for kind in ("depth_maps", "normal_maps", "consistency_graphs"):
        workspace.stereo_folder(kind).mkdir(parents=True, exist_ok=True)
    texts = {
        workspace.patch_match_config: "".join(f"{n}\n__auto__, {source_images}\n" for n in names),
        workspace.fusion_config: "".join(f"{name}\n" for name in names),
        workspace.run_script("geometric"): _SCRIPT.format(geometric="true", kind="geometric"),
        workspace.run_script("photometric"): _SCRIPT.format(geometric="false", kind="photometric"),
    }
    for path, text in texts.items():
        with written_whole(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
            if path.suffix == ".sh":
                temporary.chmod(0o755)
    return sorted(points.keys() - set(names))
