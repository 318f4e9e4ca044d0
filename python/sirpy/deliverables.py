"""The products of a survey, each by its name: what `reconstruct` makes when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from sirpy.errors import InputError
from sirpy.progress import Progress
from sirpy.workspace import Workspace


def _cloud(workspace: Workspace, memory: int, threads: int, progress: Progress) -> Path:
    from sirpy.cloud_files import export_cloud

    return export_cloud(workspace, format="laz", progress=progress)[0]


def _dsm(workspace: Workspace, memory: int, threads: int, progress: Progress) -> Path:
    from sirpy.surface_model import surface_model

    return surface_model(workspace, progress=progress)


def _ortho(workspace: Workspace, memory: int, threads: int, progress: Progress) -> Path:
    from sirpy.orthophoto import orthophoto

    return orthophoto(workspace, progress=progress)


def _mesh(workspace: Workspace, memory: int, threads: int, progress: Progress) -> Path:
    from sirpy.mesh import mesh

    return mesh(workspace, memory=memory, threads=threads, progress=progress).path


def _tiles3d(workspace: Workspace, memory: int, threads: int, progress: Progress) -> Path:
    from sirpy.tiles3d import tiles3d

    return tiles3d(workspace, progress=progress)


# In the order in which they are made.
_MAKERS: dict[str, Callable[[Workspace, int, int, Progress], Path]] = {
    "cloud": _cloud,
    "dsm": _dsm,
    "ortho": _ortho,
    "mesh": _mesh,
    "tiles3d": _tiles3d,
}
PRODUCTS = tuple(_MAKERS)


def check_products(names: Sequence[str]) -> None:
    """Raises InputError unless all of them are known."""
    if unknown := [name for name in names if name not in PRODUCTS]:
        raise InputError(
            f"--products has {unknown[0] or 'an empty name'}: choose of {', '.join(PRODUCTS)}"
        )


def make_product(
    workspace: Workspace, name: str, *, memory: int, threads: int = 0, progress: Progress
) -> Path:
    """Makes one of PRODUCTS of the fused points, with the defaults of its own command; returns its file.

    Args:
        memory: bytes that all processes together may take.
        threads: 0: one for each core.

    Raises:
        SirpyError: it cannot be made.
    """
    return _MAKERS[name](workspace, memory, threads, progress)
