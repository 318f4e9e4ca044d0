"""Features at native resolution in a COLMAP database: as of the whole photograph, for any mapper."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageFilter
from sirpy.errors import InputError
from sirpy.features import features
from sirpy.progress import Progress, Steps

ALL = 1_000_000
TABLES = ("cameras", "rigs", "images", "frames", "frame_data", "keypoints", "descriptors")


@pytest.fixture(scope="module")
def textured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photograph of 800x200 pixels with detail of all sizes."""
    random, picture = np.random.default_rng(1), np.zeros((200, 800))
    for size in (2, 4, 8, 16, 32):
        noise = random.normal(0, 255, (200 // size + 1, 800 // size + 1))
        layer = Image.fromarray(noise.astype(np.float32)).resize(
            (800, 200), Image.Resampling.BICUBIC
        )
        picture += np.asarray(layer) / 4
    folder = tmp_path_factory.mktemp("textured")
    grey = Image.fromarray(np.clip(picture + 128, 0, 255).astype(np.uint8))
    grey.filter(ImageFilter.GaussianBlur(0.7)).save(folder / "a.png")
    return folder


@pytest.fixture(scope="module")
def town_database(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    database = tmp_path_factory.mktemp("town_features") / "a.db"
    assert (
        features(town / "images", database, first_octave=-1, camera_model="OPENCV").left_out == []
    )
    return database


def rows(database: Path, table: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(database)) as connection:
        return connection.execute(f"SELECT * FROM {table} ORDER BY 1").fetchall()


def everything(database: Path) -> list[list[tuple[Any, ...]]]:
    return [rows(database, table) for table in TABLES]


def keypoints(database: Path, number: int = 1) -> NDArray[np.float32]:
    with pycolmap.Database.open(database) as opened:
        found = np.array(opened.read_keypoints(number))
        assert len(opened.read_descriptors(number).data) == len(found)
    return found[np.argsort(found[:, 0], kind="stable")]


def num_matched(found: NDArray[np.float32], others: NDArray[np.float32]) -> int:
    """Of `found`, those that have the same place and shape (0.01 pixels) among `others`, both sorted by x."""
    begin = np.searchsorted(others[:, 0], found[:, 0] - 0.01)
    end = np.searchsorted(others[:, 0], found[:, 0] + 0.01)
    return sum(
        bool((np.abs(others[a:b] - one).max(axis=1) < 0.01).any())
        for one, a, b in zip(found, begin, end, strict=True)
        if b > a
    )


def test_sub_images_find_what_the_whole_photograph_shows(textured: Path, tmp_path: Path) -> None:
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features = ALL
    pycolmap.extract_features(tmp_path / "whole.db", textured, extraction_options=options)
    whole = keypoints(tmp_path / "whole.db")
    assert len(whole) > 1000
    common: dict[str, Any] = {"max_features": ALL, "first_octave": -1, "memory": 2_000_000_000}
    for side in (800, 660):  # uncut, and 2 x 1
        database = tmp_path / f"{side}.db"
        features(textured, database, tile=side, **common)
        cut = keypoints(database)
        assert len(cut) == len(whole)
        assert num_matched(cut, whole) == num_matched(whole, cut) == len(whole)


def test_colmap_orients_all_photographs(town_database: Path, town: Path, tmp_path: Path) -> None:
    database = tmp_path / "a.db"
    shutil.copy(town_database, database)
    pycolmap.match_exhaustive(database)
    models = pycolmap.incremental_mapping(database, town / "images", tmp_path)
    largest = max(models.values(), key=lambda model: model.num_reg_images())
    assert largest.num_reg_images() == 6
    assert largest.compute_mean_reprojection_error() < 1.0


def test_colmap_3_8_matches_them(town_database: Path, tmp_path: Path) -> None:
    if shutil.which("colmap") is None:
        pytest.skip("there is no colmap")
    database = tmp_path / "a.db"
    shutil.copy(town_database, database)
    options = ["--SiftMatching.use_gpu", "0"]
    ran = subprocess.run(
        ["colmap", "exhaustive_matcher", "--database_path", database, *options],
        capture_output=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr[-300:]
    assert len(rows(database, "two_view_geometries")) == 15


def test_same_bytes_on_any_number_of_threads(
    town_database: Path, town: Path, tmp_path: Path
) -> None:
    database = tmp_path / "a.db"
    features(town / "images", database, first_octave=-1, camera_model="OPENCV", threads=1)
    assert everything(database) == everything(town_database)


class _Interrupted(Exception):
    pass


class _Impatient(Progress):
    """Interrupts when two photographs are done."""

    @contextmanager
    def stage(self, name: str, total: int, unit: str) -> Iterator[Steps]:
        class Counting(Steps):
            done = 0

            def advance(self, steps: int = 1) -> None:
                self.done += steps
                if self.done >= 2:
                    raise _Interrupted

        yield Counting()


def test_an_interrupted_run_goes_on(town_database: Path, town: Path, tmp_path: Path) -> None:
    database = tmp_path / "a.db"
    options: dict[str, Any] = {"first_octave": -1, "camera_model": "OPENCV", "threads": 1}
    with pytest.raises(_Interrupted):
        features(town / "images", database, progress=_Impatient(), **options)
    begun = rows(database, "images")
    assert 2 <= len(begun) < 6
    assert len(rows(database, "keypoints")) == len(rows(database, "descriptors")) == len(begun)
    features(town / "images", database, **options)
    assert everything(database) == everything(town_database)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.db", "a.db.features.json"]


def test_a_damaged_photograph_is_left_out_until_it_is_mended(
    town_database: Path, town: Path, tmp_path: Path
) -> None:
    images, database = tmp_path / "images", tmp_path / "a.db"
    shutil.copytree(town / "images", images)
    name = sorted(path.name for path in images.iterdir())[2]
    whole = (images / name).read_bytes()
    (images / name).write_bytes(whole[: len(whole) // 2])
    options: dict[str, Any] = {"first_octave": -1, "camera_model": "OPENCV"}
    (out,) = features(images, database, **options).left_out
    assert out.name == name and "damaged" in out.reason
    assert len(rows(database, "images")) == 5
    (images / name).write_bytes(whole)
    assert features(images, database, **options).left_out == []
    assert everything(database) == everything(town_database)


def test_a_database_of_something_else_is_never_touched(
    town_database: Path, town: Path, tmp_path: Path
) -> None:
    foreign = tmp_path / "foreign.db"
    shutil.copy(town_database, foreign)
    before = foreign.read_bytes()
    with pytest.raises(InputError, match="was not made by this command"):
        features(town / "images", foreign, first_octave=-1, camera_model="OPENCV")
    assert foreign.read_bytes() == before
    with pytest.raises(InputError, match="with other options"):
        features(town / "images", town_database, first_octave=0, camera_model="OPENCV")


def test_options_that_cannot_be(town: Path, tmp_path: Path) -> None:
    for options in ({"max_features": 0}, {"first_octave": 1}, {"threads": -1}, {"tile": 100}):
        with pytest.raises(InputError, match="is not possible"):
            features(town / "images", tmp_path / "a.db", **options)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
