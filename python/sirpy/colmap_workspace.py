"""What COLMAP's dense commands need in a workspace beside images and model: lists, folders, run
scripts.

COLMAP's patch match aborts at an image without sparse points unless it is given a depth range, which
then holds for all images of the run. So sub-images with few points have lists of their own, one for each
photograph, with the range of the sparse points around them; the run scripts give it to COLMAP.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import get_args

from sirpy.colmap_lists import is_listable, is_source, names_note
from sirpy.engine_views import EngineView, engine_views
from sirpy.files import fingerprint, write_text
from sirpy.native_scene import NativeScene, read_native_scene
from sirpy.progress import Progress
from sirpy.view_fields import points_seen
from sirpy.workspace import MapFolder, Pass, Workspace

_SCRIPT = """\
#!/bin/sh
# Dense reconstruction of this workspace by COLMAP at full resolution. COLMAP names the program to
# use.
set -e
workspace=$(cd "$(dirname "$0")" && pwd)
colmap=${COLMAP:-colmap}

patch_match() {
  "$colmap" patch_match_stereo --workspace_path "$workspace" --workspace_format COLMAP \\
    --PatchMatchStereo.max_image_size -1 "$@"
}

# Sub-images that see few sparse points, with the depth range in the first line of their list.
few_points() {
  for list in "$workspace"/stereo/few-points/*.cfg; do
    [ -e "$list" ] || continue
    read -r _ _ depth_min _ depth_max < "$list"
    patch_match --config_path "$list" --PatchMatchStereo.allow_missing_files true \\
      --PatchMatchStereo.depth_min "$depth_min" --PatchMatchStereo.depth_max "$depth_max" "$@"
  done
}

"""
_PASSES: dict[Pass, str] = {
    # As COLMAP does for one list: every photometric map, unfiltered, before the first geometric one.
    "geometric": """\
few_points --PatchMatchStereo.geom_consistency false --PatchMatchStereo.filter false
patch_match --PatchMatchStereo.geom_consistency true
few_points --PatchMatchStereo.geom_consistency true
""",
    "photometric": """\
few_points --PatchMatchStereo.geom_consistency false
patch_match --PatchMatchStereo.geom_consistency false
""",
}
_PRODUCTS = """\
set --
[ ! -d "$workspace/masks" ] || set -- --StereoFusion.mask_path "$workspace/masks"
"$colmap" stereo_fusion --workspace_path "$workspace" --workspace_format COLMAP \\
  --input_type {kind} --StereoFusion.max_image_size -1 --output_path "$workspace/fused.ply" "$@"
"$colmap" poisson_mesher --input_path "$workspace/fused.ply" \\
  --output_path "$workspace/meshed-poisson.ply"
"""


@dataclass(frozen=True)
class DenseLists:
    """Names of sub-images: `few_points` have a depth range given, `unlisted` are in no list."""

    few_points: tuple[str, ...]
    unlisted: tuple[str, ...]


def write_dense_folder(
    workspace: Workspace,
    source_images: int,
    *,
    min_points: int = 1,
    progress: Progress = Progress(),
) -> DenseLists:
    """Writes `stereo/` and the run scripts.

    Args:
        source_images: how many source images COLMAP shall choose for each reference.
        min_points: sub-images that see fewer sparse points are given a depth range and sources.

    Raises:
        OutputError: the workspace cannot be written.
    """
    natives = workspace.natives  # before anything is written: is this a workspace?
    scene = read_native_scene(workspace)
    few = {
        sub.name
        for native in natives
        for sub in native.sub_images
        if is_listable(sub.name) and points_seen(scene, native.name, sub.stored) < min_points
    }
    # What COLMAP writes here belongs to this cut: cutting anew clears it away.
    inputs = fingerprint("colmap", source_images, min_points, workspace.fingerprint_of("cut"))
    for stage in ("views", "stereo", "fuse"):
        workspace.begin_stage(stage, inputs)
    names = sorted(sub.name for _, sub in workspace.sub_images())
    # COLMAP does not make the folders of a name.
    for parent in sorted({str(PurePosixPath(name).parent) for name in names}):
        for folder in map(workspace.stereo_folder, get_args(MapFolder)):
            (folder / parent).mkdir(parents=True, exist_ok=True)
    if note := names_note(names, sources=bool(few)):
        progress.note(note)
    listed = [name for name in names if name not in few and is_listable(name)]
    given = _write_few_points(workspace, scene, few, source_images, progress) if few else []
    write_text(
        workspace.patch_match_config,
        "".join(f"{name}\n__auto__, {source_images}\n" for name in listed),
    )
    write_text(workspace.fusion_config, "".join(f"{name}\n" for name in sorted(listed + given)))
    for kind, passes in _PASSES.items():
        text = _SCRIPT + passes + _PRODUCTS.format(kind=kind)
        write_text(workspace.run_script(kind), text, executable=True)
    return DenseLists(tuple(given), tuple(sorted(few - set(given))))


def _write_few_points(
    workspace: Workspace,
    scene: NativeScene,
    few: set[str],
    source_images: int,
    progress: Progress,
) -> list[str]:
    """Writes the lists; the names that are in one: not those without a depth range or source."""
    names = [sub.name for _, sub in workspace.sub_images()]
    by_photograph: defaultdict[str, list[tuple[EngineView, str]]] = defaultdict(list)
    for view in engine_views(
        workspace, most_sources=source_images, only=few, scene=scene, progress=progress
    ):
        sources = [names[number] for number, _ in view.sources]
        if listed := ", ".join(filter(is_source, sources)):
            by_photograph[view.camera.name].append((view, listed))
    for number, group in enumerate(by_photograph.values()):
        lines = [
            f"# depth_min {min(view.min_depth for view, _ in group)!r}"
            f" depth_max {max(view.max_depth for view, _ in group)!r}"
        ]
        for view, listed in group:
            lines += [view.sub_image.name, listed]
        write_text(workspace.few_points_config(number), "\n".join(lines) + "\n")
    return [view.sub_image.name for group in by_photograph.values() for view, _ in group]
