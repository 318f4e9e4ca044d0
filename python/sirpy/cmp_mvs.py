"""The input folder of CMP-MVS (Jancosek and Pajdla, CVPR 2011): 00001.jpg, 00001_P.txt, ...

P is CONTOUR and the 3x4 projection matrix of a sub-image, as COLMAP writes it except for the pixel
centres: they lie at whole numbers, where the author's published code (AliceVision) interpolates.
"""

from __future__ import annotations

from sirpy.engine_options import CopyPolicy
from sirpy.engine_views import engine_views, place_images, precision_note, size_note
from sirpy.errors import InputError
from sirpy.files import write_text
from sirpy.progress import Progress
from sirpy.workspace import Workspace

_ENGINE = "CMP-MVS"
_MOST_IMAGES = 99_999  # five digits


def write_cmp_mvs(
    workspace: Workspace,
    *,
    copy_policy: CopyPolicy = "hard-link",
    progress: Progress = Progress(),
) -> None:
    """Writes the numbered images and projection matrices into a workspace that was cut.

    Says by `progress.note` what belongs into the .ini file of CMP-MVS.

    Raises:
        InputError: this is no workspace, its sub-images are no JPEGs or too many.
        OutputError: the folder cannot be written.
    """
    views = engine_views(workspace, most_sources=0, progress=progress)
    if len(views) > _MOST_IMAGES:
        raise InputError(
            f"CMP-MVS numbers images with five digits, and there are {len(views)} sub-images: "
            "use fewer columns and rows, or fewer photographs"
        )
    place_images(workspace, views, lambda n: workspace.cmp_mvs_image(n + 1), copy_policy, _ENGINE)
    for view in views:
        rows = [" ".join(map(repr, row)) for row in view.img_from_world.tolist()]
        text = "\n".join(["CONTOUR", *rows, ""])
        write_text(workspace.cmp_mvs_camera(view.number + 1), text)
    stored = views[0].sub_image.stored
    ini = f"CMP-MVS: ncams={len(views)}, width={stored.width}, height={stored.height} in its .ini"
    for note in (size_note(views, _ENGINE) or ini, precision_note(views, _ENGINE)):
        if note:
            progress.note(note)
