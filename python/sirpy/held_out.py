"""Photographs that are held out of a reconstruction, to judge it by: which, and the model without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sirpy.errors import InputError, first_few
from sirpy.model_arrays import SparseModel, read_arrays, write_model
from sirpy.model_files import find_model

EVERY = 8
_LEAST_OBSERVATIONS = 2  # of a point, below which nothing says where it is
_LEAST_KEPT = 2


def hold_out(
    model: Path | str, output: Path | str, *, names: Sequence[str] = (), every: int = EVERY
) -> list[str]:
    """Writes the model without some of its photographs, which are returned, in order of names.

    Points that fewer than two of the others see go with them; cameras stay as they are.

    Args:
        names: those that are held out; if none, every `every`-th in order of names.

    Raises:
        InputError: there is no such model or photograph, fewer than two would be left, or `output` is the
            model itself.
        OutputError: the model cannot be written.
    """
    model, output = Path(model), Path(output)
    whole = read_arrays(model)
    if output.resolve() in (model.resolve(), find_model(model).resolve()):
        raise InputError(f"the output is the model itself, {output}: choose another folder")
    chosen = check_held_out(whole, model, names) if names else _every(whole, model, every)
    kept = without(whole, set(chosen))
    if len(kept.images) < _LEAST_KEPT or len(kept.points) == 0:
        raise InputError(
            f"without {first_few(chosen)} {len(kept.images)} photographs and {len(kept.points)} points of {model} "
            "are left, too few to reconstruct from: hold out fewer"
        )
    write_model(kept, output)
    return chosen


def without(model: SparseModel, names: set[str]) -> SparseModel:
    """The model without these photographs, and without points that are then seen less than twice."""
    kept = model.taking([i for i, image in enumerate(model.images) if image.name not in names])
    seen = np.bincount(kept.point, minlength=len(kept.points)) >= _LEAST_OBSERVATIONS
    held = seen[kept.point]
    before = np.concatenate([[0], np.cumsum(held, dtype=np.int64)])
    return replace(
        kept, starts=before[kept.starts], xy=kept.xy[held], point=kept.point[held]
    ).with_seen_points()


def check_held_out(model: SparseModel, path: Path, names: Sequence[str]) -> list[str]:
    """The names, each once, in their order; raises InputError where one is not in the model at `path`."""
    known = sorted(image.name for image in model.images)
    if unknown := sorted(set(names) - set(known)):
        raise InputError(
            f"{path} has no photograph {first_few(unknown)}: give names as the model has them, such as "
            f"{first_few(known)}"
        )
    return sorted(set(names))


def _every(model: SparseModel, path: Path, every: int) -> list[str]:
    if every < 2:
        raise InputError(f"--every {every} is not possible: choose 2 or more")
    names = sorted(image.name for image in model.images)
    chosen = names[every // 2 :: every]  # not the first, which fewer others overlap
    if not chosen:
        raise InputError(
            f"{path} has {len(names)} photographs, of which --every {every} holds out none: choose a smaller "
            "number, or name some with --hold-out"
        )
    return chosen
