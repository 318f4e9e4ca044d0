"""The folder of CMP-MVS: numbers from 1, images of one size, projection matrices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from engine_scenes import Notes, assert_numbered_images_are, cut_town, expected_pixels
from sirpy.cmp_mvs import write_cmp_mvs


def test_images_and_projection_matrices_are_numbered_from_one(town: Path, tmp_path: Path) -> None:
    workspace = cut_town(town, tmp_path / "out", same_size=1)
    notes = Notes()
    write_cmp_mvs(workspace, progress=notes)
    stored = workspace.natives[0].sub_images[0].stored
    assert notes.notes == [
        f"CMP-MVS: ncams=36, width={stored.width}, height={stored.height} in its .ini"
    ]
    out = workspace.folder
    assert_numbered_images_are(workspace, [out / f"{number:05}.jpg" for number in range(1, 37)])
    for number, (world, pixels) in enumerate(expected_pixels(workspace), start=1):
        header, *rows = (out / f"{number:05}_P.txt").read_text().splitlines()
        assert header == "CONTOUR"
        projection = np.array([row.split() for row in rows], float)
        assert projection.shape == (3, 4)
        seen = np.column_stack([world, np.ones(len(world))]) @ projection.T
        np.testing.assert_allclose(seen[:, :2] / seen[:, 2:] + 0.5, pixels, atol=1e-6)


def test_uneven_sizes_are_said(town: Path, tmp_path: Path) -> None:
    notes = Notes()
    write_cmp_mvs(cut_town(town, tmp_path / "out"), progress=notes)
    (note,) = notes.notes
    assert note.startswith("CMP-MVS expects images of one size")
