"""The command line: options become those of the functions, whichever way they are spelled."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

import pytest
from sirpy import cli, clustering, view_selection
from sirpy.cli import app
from sirpy.errors import InputError
from sirpy.fusion import FusionOptions
from sirpy.stereo_backend import StereoOptions
from sirpy.workspace import Workspace
from typer.testing import CliRunner


def run(*arguments: str | Path) -> str:
    done = CliRunner().invoke(app, [str(word) for word in arguments])
    if done.exception is not None:
        raise done.exception
    return done.output


def test_a_plan_for_programs_and_for_people(town: Path) -> None:
    grid = ("--column_cuts", "100,200", "--rows", "2", "--overlap", "5")
    found = json.loads(run("plan", town / "sparse", *grid, "--json"))
    assert found["grid"] == {"columns": 3, "rows": 2, "column_cuts": [100, 200], "row_cuts": []}
    assert (found["photographs"], found["sub_images"]) == (6, 36)
    stages = ["cut", "views", "stereo", "fuse", "report"]
    assert [stage["name"] for stage in found["stages"]] == stages
    assert found["predicted_peak"] == {stage["name"]: stage["peak"] for stage in found["stages"]}
    table = run("plan", town / "sparse", *grid, "--images", town / "images")
    assert "36 of at most" in table
    assert "native pixels carry detail in" in table


def test_regions_and_clusters(town: Path, tmp_path: Path) -> None:
    square = [[-5, -5], [5, -5], [5, 5], [-5, 5], [-5, -5]]
    area = tmp_path / "area.geojson"
    area.write_text(json.dumps({"type": "Polygon", "coordinates": [square]}))
    out = tmp_path / "out"
    cut = ("cut", town / "images", "--model", town / "sparse", "-o", out, "--quiet")
    run(*cut, "--columns=4", "--rows=3", "--roi=20,20,300,200", "--area", area)
    sub_images = [sub for _, sub in Workspace(out).sub_images()]
    assert 0 < len(sub_images) < 6 * 12
    assert min(sub.core.x0 for sub in sub_images) >= 20
    for option in ("--cluster_size", "--cluster-size"):
        assert "of at most 7 sub-images" in run("clusters", out, option, "7")
    with pytest.raises(InputError, match="--model_crs nowhere is not a known CRS"):
        run(*cut, "--area", area, "--model_crs", "nowhere")
    with pytest.raises(InputError, match="make 2 columns, not 3"):
        run(*cut, "--column-cuts=50", "--columns=3")


@pytest.mark.parametrize(
    ("command", "meant"),
    [
        (cli.stereo, StereoOptions),
        (cli.fuse, FusionOptions),
        (cli.views, view_selection.views),
        (cli.clusters, clustering.clusters),
    ],
)
def test_defaults_are_those_of_the_library(command: Any, meant: Any) -> None:
    library = inspect.signature(meant).parameters
    shared = {
        name: one.default
        for name, one in inspect.signature(command).parameters.items()
        if name in library and one.default is not inspect.Parameter.empty
    }
    assert shared
    assert shared == {name: library[name].default for name in shared}
