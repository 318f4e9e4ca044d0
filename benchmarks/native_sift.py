"""A model of photographs at native size by pycolmap alone: SIFT, all pairs, incremental mapping, all its defaults.

    python benchmarks/native_sift.py IMAGES MODEL [--camera_model OPENCV] [--camera_per image]

The largest of its models is written to the folder MODEL. A process of its own, so that its cost can be measured.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import pycolmap
from sirpy.photographs import find_photographs, photograph_size

_MODES = {
    "auto": pycolmap.CameraMode.AUTO,
    "image": pycolmap.CameraMode.PER_IMAGE,
    "folder": pycolmap.CameraMode.PER_FOLDER,
    "single": pycolmap.CameraMode.SINGLE,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("images", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("--camera_model", default="OPENCV")
    parser.add_argument("--camera_per", choices=_MODES, default="auto")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="sirpy-") as scratch:
        model = solve(arguments.images, Path(scratch), arguments.camera_model, arguments.camera_per)
    arguments.model.mkdir(parents=True, exist_ok=True)
    model.write_binary(arguments.model)


def solve(
    images: Path, scratch: Path, camera_model: str, camera_per: str
) -> pycolmap.Reconstruction:
    """The largest model that COLMAP makes. Ends the program where it makes none."""
    database = scratch / "database.db"
    names = find_photographs(images)
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.max_image_size = max(max(photograph_size(images / name)) for name in names)
    pycolmap.extract_features(
        database,
        images,
        image_names=names,
        camera_mode=_MODES[camera_per],
        reader_options=pycolmap.ImageReaderOptions(camera_model=camera_model),
        extraction_options=extraction,
    )
    pycolmap.match_exhaustive(database)
    models = pycolmap.incremental_mapping(database, images, scratch)
    if not models:
        raise SystemExit(f"COLMAP makes no model of the photographs in {images}")
    return max(models.values(), key=lambda model: model.num_reg_images())


if __name__ == "__main__":
    main()
