"""The cameras of photographs: structure from motion on decimated copies, then refinement at native
resolution.

    OUTPUT       COLMAP model of the native photographs, binary
    OUTPUT.sfm   the workspace beside it: decimated copies, database, log, decimated model,
                 refinement.json; what the same command goes on from. Without it the model is
                 nobody's, and is not replaced.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from sirpy.errors import BudgetError, InputError, OutputError
from sirpy.files import fingerprint, folder_written_whole, read_json, write_json
from sirpy.memory import gigabytes
from sirpy.model_arrays import read_arrays
from sirpy.model_files import MODEL_FILES, model_identity
from sirpy.native_images import LeftOut
from sirpy.progress import Progress
from sirpy.refinement_record import read_left_out
from sirpy.sfm_options import SfmOptions
from sirpy.sparse_model import sparse
from sirpy.workspace import Workspace, check_writable


@dataclass(frozen=True)
class SfmResult:
    """`model`: folder of the COLMAP model in native pixels; `left_out`: photographs that are not in
    it, and why; `components`: names of the photographs that could be related to each other, first
    those of the model; `refinement`: residuals before and after the refinement (refinement.json),
    None without it."""

    model: Path
    left_out: list[LeftOut]
    components: list[list[str]]
    refinement: Path | None


def sfm(
    images: Path | str,
    output: Path | str,
    *,
    options: SfmOptions = SfmOptions(),
    native: bool = True,
    memory: int | None = None,
    threads: int = 0,
    progress: Progress | None = None,
) -> SfmResult:
    """Writes the COLMAP model of the photographs in `images`, in native pixels, to the folder
    `output`.

    The result does not depend on `threads` or `memory`; the same call continues a run that was
    killed, and does nothing again that is done.

    Args:
        output: must not exist, or be what an earlier call wrote.
        native: refine the cameras at native resolution.
        memory: bound in bytes on all processes together; None for no bound.
        threads: 0 for one on each core.

    Raises:
        InputError: the photographs or options are at fault.
        BudgetError: `memory` does not do.
        OutputError: `output` cannot be written, or holds something else.
    """
    # A link, ".", "a/" too have a place beside them.
    target = Path(output).resolve()
    workspace = Workspace(target.with_name(f"{target.name}.sfm"))
    _check_target(target, workspace)
    check_writable(target)
    found = solve_cameras(
        *(Path(images), workspace, options),
        native=native,
        memory=memory,
        threads=threads,
        progress=progress or Progress(),
    )
    identity = model_identity(found.model)
    if identity != _identity(target):
        _remember(identity, workspace)
        with folder_written_whole(target) as temporary:
            for path in sorted(found.model.iterdir()):
                if path.name in MODEL_FILES:
                    shutil.copyfile(path, temporary / path.name)
    return SfmResult(Path(output), found.left_out, found.components, found.refinement)


def solve_cameras(
    images: Path,
    workspace: Workspace,
    options: SfmOptions,
    *,
    native: bool,
    memory: int | None,
    threads: int,
    progress: Progress,
) -> SfmResult:
    """The stages `sparse` and `refine` in a workspace, as far as they are not done."""
    made = sparse(
        images, workspace.folder, options=options, memory=memory, threads=threads, progress=progress
    )
    return refine_cameras(
        *(images, workspace, made.left_out, made.components),
        native=native,
        memory=memory,
        threads=threads,
        progress=progress,
    )


def refine_cameras(
    images: Path,
    workspace: Workspace,
    left_out: list[LeftOut],
    components: list[list[str]],
    *,
    native: bool,
    memory: int | None,
    threads: int,
    progress: Progress,
) -> SfmResult:
    """The stage `refine` after `sparse` has left out some photographs; without `native` it removes
    what an earlier run refined.

    Raises:
        BudgetError: `memory` does not do.
    """
    solved = workspace.sfm_model
    is_done = workspace.begin_stage("refine", fingerprint(model_identity(solved), native))
    if not native:
        return SfmResult(solved, left_out, components, None)
    if not is_done or not workspace.is_refined:
        from sirpy.native_refinement import refine

        needed = predicted_refinement_peak(workspace)
        if memory is not None and needed > memory:
            raise BudgetError(
                f"refining the cameras needs {gigabytes(needed)}, more than --memory allows "
                f"({gigabytes(memory)}): allow more, or keep the decimated cameras with --no-native"
            )
        refine(
            *(images, solved, workspace.refined_model),
            threads=threads or os.cpu_count() or 1,
            progress=progress,
        )
    left_out = sorted([*left_out, *read_left_out(workspace.refinement)], key=lambda out: out.name)
    return SfmResult(workspace.refined_model, left_out, components, workspace.refinement)


def predicted_refinement_peak(workspace: Workspace) -> int:
    """Bytes, after the stage `sparse`."""
    from sirpy.native_refinement import predicted_peak

    return predicted_peak(read_arrays(workspace.sfm_model))


def _check_target(target: Path, workspace: Workspace) -> None:
    """Only what an earlier run wrote is replaced."""
    if not target.exists():
        return
    if not target.is_dir():
        raise OutputError(f"{target} is a file: choose another --output")
    elsewhere = "choose another --output, or move it away"
    if others := sorted(path.name for path in target.iterdir() if path.name not in MODEL_FILES):
        raise OutputError(
            f"{target} holds {others[0]}, which `sirpy sfm` did not make: {elsewhere}"
        )
    if any(target.iterdir()) and _identity(target) not in _written(workspace):
        raise OutputError(
            f"{target} holds a model that was not made with {workspace.folder}, or was changed since: {elsewhere}"
        )


def _identity(target: Path) -> str | None:
    """Of the model in the folder; None where there is none, or only some of its files."""
    try:
        return model_identity(target)
    except InputError:
        return None


def _written(workspace: Workspace) -> list[str]:
    """Identities of the models that were written last, the last of them perhaps not in full."""
    try:
        return read_json(_record(workspace), lambda found: [str(one) for one in found], "delete it")
    except FileNotFoundError:
        return []


def _remember(identity: str, workspace: Workspace) -> None:
    write_json(_record(workspace), [*_written(workspace)[-1:], identity])


def _record(workspace: Workspace) -> Path:
    return workspace.folder / "output.json"
