"""From matches to models: COLMAP's incremental mapper or its global one, on one thread with fixed seeds."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pycolmap

from sirpy.sfm_options import Mapper

SEED = 1


def map_photographs(
    database: Path,
    images: Path,
    mapper: Mapper,
    *,
    use_priors: bool = False,
    advance: Callable[[int], None] = lambda _: None,
) -> list[pycolmap.Reconstruction]:
    """The models, the largest first; photographs of one are not related to those of another.

    Args:
        use_priors: the database has positions, which cameras are to keep to (incremental).
        advance: called with the number of photographs that were just oriented.
    """
    folder = database.with_name("models")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    if mapper == "global":
        models = pycolmap.global_mapping(database, images, folder, _global_options())
        for model in models.values():
            advance(model.num_reg_images())
    else:
        models = pycolmap.incremental_mapping(
            database,
            images,
            folder,
            _incremental_options(use_priors),
            initial_image_pair_callback=lambda: advance(2),
            next_image_callback=lambda: advance(1),
        )
    shutil.rmtree(folder)
    oriented = [model for model in models.values() if model.num_reg_images() >= 2]
    return sorted(oriented, key=lambda m: (-m.num_reg_images(), -m.num_points3D()))


def _incremental_options(use_priors: bool) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = SEED
    options.min_model_size = 2
    options.use_prior_position = use_priors
    # Single positions are off by far more than GPS promises.
    options.use_robust_loss_on_prior_position = use_priors
    return options


def _global_options() -> pycolmap.GlobalPipelineOptions:
    options = pycolmap.GlobalPipelineOptions()
    mapper = options.mapper
    seeded: tuple[Any, ...] = (
        *(options, mapper, mapper.rotation_averaging),
        *(mapper.global_positioning, mapper.retriangulation),
    )
    for part in seeded:
        part.random_seed = SEED
    options.num_threads = mapper.num_threads = 1
    mapper.bundle_adjustment.ceres.solver_options.num_threads = 1
    return options
