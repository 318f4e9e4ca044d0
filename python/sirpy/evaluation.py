"""A cloud without ground truth, judged by photographs that took no part in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sirpy.common_ground import CommonGround, Observer, common_ground
from sirpy.cut_tasks import CutInputs, PixelOptions
from sirpy.errors import InputError, first_few
from sirpy.evaluation_picture import side_by_side
from sirpy.files import written_whole
from sirpy.held_out import check_held_out
from sirpy.judged_cloud import JudgedCloud, observers_within, open_judged
from sirpy.left_out import leave_out
from sirpy.model_arrays import SparseModel, read_arrays
from sirpy.native_images import LeftOut
from sirpy.photographs import check_names
from sirpy.pictures import encoded_png
from sirpy.posed_camera import PosedCamera
from sirpy.progress import Progress
from sirpy.rephotograph import rephotograph
from sirpy.rephotograph_score import THRESHOLDS, RephotographOptions, Score
from sirpy.workspace import Workspace

DEFAULT_MEMORY = 8_000_000_000  # bytes


@dataclass(frozen=True)
class Evaluation:
    """Scores by photograph, and of the pixels of all; photographs that could not be used."""

    cloud: Path
    options: RephotographOptions
    photographs: dict[str, Score]
    left_out: tuple[LeftOut, ...]

    @property
    def all(self) -> Score:
        return sum(self.photographs.values(), Score())

    def as_json(self) -> dict[str, Any]:
        return {
            "cloud": str(self.cloud),
            **asdict(self.options),
            "all": _json(self.all),
            "photographs": {name: _json(score) for name, score in self.photographs.items()},
            "left_out": {out.name: out.reason for out in self.left_out},
        }

    def __str__(self) -> str:
        rows = {**self.photographs, "all": self.all}
        width = max(len(name) for name in [*rows, "photograph"])
        right = "".join(f"{least:>8g}" for least in THRESHOLDS)
        lines = [f"{'photograph':<{width}}  covered  right:{right[2:]}      pixels"]
        for name, score in rows.items():
            shares = ["-" if share is None else f"{share:.1%}" for share in score.shares().values()]
            right = "".join(f"{share:>8}" for share in shares[1:])
            lines.append(f"{name:<{width}}  {shares[0]:>7}      {right}  {score.pixels:>10,}")
        return "\n".join(lines)


def _json(score: Score) -> dict[str, Any]:
    return {**score.shares(), "pixels": score.pixels, "textured": score.textured}


def evaluate(
    model: Path | str,
    images: Path | str,
    cloud: Path | str,
    *,
    hold_out: Sequence[str] = (),
    within: Workspace | None = None,
    options: RephotographOptions = RephotographOptions(),
    masks: Path | str | None = None,
    picture: Path | str | None = None,
    memory: int = DEFAULT_MEMORY,
    progress: Progress | None = None,
) -> Evaluation:
    """Judges a cloud by photographs that were held out: it is drawn into them, and compared by NCC.

    Counted are pixels that enough photographs of the cloud see, in the sub-images that it was made of.
    Moving things, glints and other exposures bound every score: only scores of the same photographs and
    region can be compared.

    Args:
        model: of all photographs, those held out too.
        cloud: a workspace, or a file: PLY, LAS or LAZ with colours, in the frame of the model or made by a workspace.
        hold_out: names; if none, the photographs of the model that the cloud's workspace did not use.
        within: counts the pixels that the sub-images of this workspace see; if None, of the cloud's own.
        masks: folder of masks, black where a photograph is not to be compared.
        picture: folder for a PNG of each photograph, NAME.png: photograph, cloud and NCC.
        memory: bytes for this process, beside the sparse model.

    Raises:
        InputError: an input cannot be used, no photograph can be judged, or the cloud lies elsewhere.
        BudgetError: not even some rows of a photograph fit into `memory`.
        OutputError: a picture cannot be written.
    """
    path, progress = Path(model), progress or Progress()
    inputs = CutInputs(Path(images), Path(masks) if masks is not None else None, PixelOptions())
    whole, judged = read_arrays(path), open_judged(Path(cloud))
    next(judged.points(), None)  # what is wrong with the file is not the photographs' fault
    names = _held_out(whole, path, hold_out, judged, progress)
    observers = observers_within(within or judged.workspace, whole, path, set(names))
    scores: dict[str, Score] = {}
    left_out: list[LeftOut] = []

    def score(name: str) -> Score | None:
        view, ground = _seen(whole, name, observers, options.min_views)
        found = rephotograph(view, inputs, judged, ground, options, memory)
        if found is not None and picture is not None:
            with written_whole(Path(picture) / f"{name}.png") as temporary:
                temporary.write_bytes(encoded_png(side_by_side(name, found)))
        return found.score if found is not None else None

    with progress.stage("evaluating", len(names), "photograph") as steps:
        for name in names:
            try:
                if (of_one := score(name)) is not None:
                    scores[name] = of_one
            except InputError as error:
                leave_out(name, str(error), left_out, progress)
            steps.advance()
    made = Evaluation(judged.path, options, scores, tuple(left_out))
    _check(made, names, path, progress)
    return made


def _held_out(
    model: SparseModel, path: Path, names: Sequence[str], cloud: JudgedCloud, progress: Progress
) -> list[str]:
    """The photographs to judge by; those that the cloud was made of too are noted."""
    workspace = cloud.workspace
    used = {native.name for native in workspace.natives} if workspace is not None else set()
    if names:
        chosen = check_held_out(model, path, names)
        if known := [name for name in chosen if name in used]:
            progress.note(f"the cloud was made of {first_few(known)} too, whose scores flatter it")
    elif workspace is None:
        raise InputError(
            f"nothing tells which photographs took no part in {cloud.path}: name them with --hold-out"
        )
    else:
        unusable = {out.name for out in workspace.left_out}
        chosen = sorted({image.name for image in model.images} - used - unusable)
    if not chosen:
        raise InputError(
            f"{cloud.path} was made of all photographs of {path}: hold some out with `sirpy evaluate split` "
            "before reconstructing"
        )
    check_names(chosen)
    return chosen


def _seen(
    model: SparseModel, name: str, observers: Sequence[Observer], min_views: int
) -> tuple[PosedCamera, CommonGround]:
    index = next(i for i, image in enumerate(model.images) if image.name == name)
    view = PosedCamera.of(model, model.images[index])
    points = model.points[model.point[model.seen(index)]]
    return view, common_ground(view, points, observers, min_views)


def _check(made: Evaluation, names: Sequence[str], model: Path, progress: Progress) -> None:
    out = {one.name for one in made.left_out}
    unseen = [name for name in names if name not in made.photographs and name not in out]
    if not made.photographs:
        reason = (
            made.left_out[0].reason
            if made.left_out
            else f"too few photographs of the cloud look where {first_few(unseen)} look"
        )
        raise InputError(f"no photograph can be judged: {reason}")
    if made.all.covered == 0:
        raise InputError(
            f"no point of {made.cloud} falls into {first_few([*made.photographs])}: give a cloud in the frame of "
            f"{model}, as fused.ply is, not one in a CRS"
        )
    if unseen:
        progress.note(
            f"{len(unseen)} photographs see nothing that was reconstructed and are not judged: {first_few(unseen)}"
        )
