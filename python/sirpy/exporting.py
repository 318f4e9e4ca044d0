"""A workspace for other engines: one function for all of them, as the options of the commands name
them."""

from __future__ import annotations

from sirpy.clustering import read_clusters
from sirpy.cmp_mvs import write_cmp_mvs
from sirpy.colmap_workspace import write_dense_folder
from sirpy.engine_options import CopyPolicy, Engine, MvsnetDepths
from sirpy.errors import InputError, first_few
from sirpy.mvsnet import write_mvsnet
from sirpy.pmvs import write_pmvs
from sirpy.progress import Progress
from sirpy.workspace import Workspace


def export(
    workspace: Workspace,
    engine: Engine,
    *,
    num_sources: int = 20,
    min_points: int = 1,
    mvsnet_depths: MvsnetDepths = "range",
    copy_policy: CopyPolicy = "hard-link",
    progress: Progress = Progress(),
) -> None:
    """Writes what an engine reads beside images and models into a workspace that was cut.

    PMVS works on the groups of `clusters`, where the workspace has them.

    Args:
        num_sources: of each sub-image, at most: chosen by COLMAP itself, listed for MVSNET.
        min_points: sub-images that see fewer sparse points are given a depth range for COLMAP.
        mvsnet_depths: what the line of depths in MVSNET's cameras holds.
        copy_policy: how PMVS, CMP-MVS and MVSNET get their numbered images.

    Raises:
        InputError: an option is out of range, this is no workspace, or not one for the engine.
        OutputError: the workspace cannot be written.
    """
    for name, value in (("num_sources", num_sources), ("min_points", min_points)):
        if value < 1:
            raise InputError(f"{name} = {value} is not possible: it must be at least 1")
    if engine == "COLMAP":
        _export_colmap(workspace, num_sources, min_points, progress)
    elif engine == "PMVS":
        groups = read_clusters(workspace)
        write_pmvs(workspace, clusters=groups, copy_policy=copy_policy, progress=progress)
    elif engine == "CMP-MVS":
        write_cmp_mvs(workspace, copy_policy=copy_policy, progress=progress)
    else:
        write_mvsnet(
            workspace,
            most_sources=num_sources,
            depths=mvsnet_depths,
            copy_policy=copy_policy,
            progress=progress,
        )


def _export_colmap(
    workspace: Workspace, num_sources: int, min_points: int, progress: Progress
) -> None:
    if workspace.views.exists():
        raise InputError(
            f"{workspace.folder} has the lists of `sirpy views`, which COLMAP reads as they are: cut "
            "into another folder to let COLMAP choose"
        )
    lists = write_dense_folder(workspace, num_sources, min_points=min_points, progress=progress)
    if lists.few_points:
        progress.note(
            f"{_sub_images(lists.few_points)} see fewer than {min_points} sparse points: the run "
            "scripts give COLMAP their depth range from stereo/few-points"
        )
    if lists.unlisted:
        progress.note(
            f"{_sub_images(lists.unlisted)} see fewer than {min_points} sparse points, and nothing "
            "around them tells a depth range or a source: COLMAP will make no maps of them"
        )


def _sub_images(names: tuple[str, ...]) -> str:
    return f"{len(names)} sub-images ({first_few(names)})"
