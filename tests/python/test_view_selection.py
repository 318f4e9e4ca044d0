"""View selection: views.json holds what was found, and other files are refused."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sirpy.cutting import cut
from sirpy.errors import InputError
from sirpy.rectangle import Grid
from sirpy.synthetic import render_scene
from sirpy.view_selection import Views, read_views, views
from sirpy.workspace import Workspace


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    folder = tmp_path_factory.mktemp("views")
    scene = render_scene(folder / "scene", image_count=4, size=(480, 320), threads=1)
    return cut(scene / "images", scene / "sparse", folder / "cut", grid=Grid(2, 2))


@pytest.fixture(scope="module")
def found(workspace: Workspace) -> Views:
    return views(workspace, num_sources=2)


def test_what_is_read_is_what_was_found(workspace: Workspace, found: Views) -> None:
    read = read_views(workspace)
    assert (read.sub_images, read.rank, read.coarsest) == (
        found.sub_images,
        found.rank,
        found.coarsest,
    )
    assert read.fields.keys() == found.fields.keys() == {one.name for one in workspace.natives}
    for name, field in found.fields.items():
        again = read.fields[name]
        assert (again.name, again.side, again.sources) == (name, field.side, field.sources)
        assert field.allowed.any()
        for array in ("allowed", "min_depth", "max_depth"):
            one, other = getattr(field, array), getattr(again, array)
            assert one.dtype == other.dtype and np.array_equal(one, other)


def _source(stored: Any) -> Any:
    return stored["sub_images"][0]["sources"][0]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda one: one.update(version=1), "was made by another version"),
        (lambda one: one.update(coarsest=1), "is damaged"),
        (lambda one: one.update(halo=-1), "is damaged"),
        (lambda one: one["images"].pop(), "is of other sub-images"),
        (lambda one: one["images"][0]["allowed"].pop(), "is damaged"),
        (lambda one: one["images"][0]["allowed"][0].__setitem__(0, 1 << 20), "is damaged"),
        (lambda one: one["images"][0]["allowed"][0].__setitem__(0, -1), "is damaged"),
        (lambda one: one["images"][0]["min_depth"][0].__setitem__(0, 1e9), "is damaged"),
        (lambda one: one["images"][0]["max_depth"][0].__setitem__(0, np.nan), "is damaged"),
        (lambda one: one["images"][0]["sources"][0].update(level=4), "is damaged"),
        (lambda one: one["images"][0]["sources"][0].update(name="x"), "is of other sub-images"),
        (lambda one: one["images"][0].update(side=256), "is of other sub-images"),
        (lambda one: one["sub_images"][0].update(window=[0, 0, 9999, 5]), "is of other sub-images"),
        (lambda one: _source(one).update(window=[-5, 0, 20, 5]), "is of other sub-images"),
        (lambda one: _source(one).update(window=[5, 5, 0, 5]), "is of other sub-images"),
        (lambda one: _source(one).update(window=[5, 5, -3, -5]), "is of other sub-images"),
        (lambda one: _source(one).update(window=[5, 5, 3]), "is damaged"),
    ],
)
def test_damaged_files_are_refused(
    workspace: Workspace, found: Views, damage: Callable[[Any], None], message: str
) -> None:
    text = workspace.views.read_text()
    stored = json.loads(text)
    for image in stored["images"]:  # every block is matched, so that its depths must be sound
        assert image["allowed"][0][0] > 0
    damage(stored)
    try:
        workspace.views.write_text(json.dumps(stored))
        with pytest.raises(InputError, match=f"{re.escape(str(workspace.views))} {message}"):
            read_views(workspace)
    finally:
        workspace.views.write_text(text)


@pytest.mark.parametrize("number", [0, 17])
def test_numbers_of_sources_that_cannot_be(workspace: Workspace, number: int) -> None:
    with pytest.raises(InputError, match=f"--num-sources {number} is not possible: choose 1 to 16"):
        views(workspace, num_sources=number)


def test_other_options_find_other_views(workspace: Workspace, found: Views, tmp_path: Path) -> None:
    before = workspace.views.read_bytes()
    assert views(workspace, num_sources=2).sub_images == found.sub_images
    assert workspace.views.read_bytes() == before
    most = max(bin(mask).count("1") for one in found.fields.values() for mask in one.allowed.flat)
    assert 2 <= most <= 4  # where some pixels of a block would have less than that, it has more
    other = views(workspace, num_sources=1)
    counts = [bin(mask).count("1") for one in other.fields.values() for mask in one.allowed.flat]
    assert 1 <= max(counts) <= 2 and np.mean(np.array(counts) <= 1) > 0.5
