"""`sirpy export`: a cut workspace for other engines."""

from __future__ import annotations

from pathlib import Path

import pytest
from engine_scenes import cut_town
from sirpy.cli import app
from sirpy.errors import InputError
from sirpy.exporting import export
from sirpy.view_selection import views
from sirpy.workspace import Workspace
from typer.testing import CliRunner


def test_one_workspace_serves_all_engines(town: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    cut_town(town, out)
    for engine, made in (
        ("PMVS", "run-pmvs.sh"),
        ("CMP-MVS", "00036_P.txt"),
        ("MVSNET", "pair.txt"),
        ("COLMAP", "run-colmap-geometric.sh"),
    ):
        done = CliRunner().invoke(app, ["export", str(out), engine, "--quiet"])
        assert done.exit_code == 0, done.output
        assert done.output == f"{engine}: {out}\n"
        assert (out / made).is_file()
    assert (out / "pair.txt").is_file()  # the others' stay


def test_the_lists_of_sirpy_views_are_not_overwritten(town: Path, tmp_path: Path) -> None:
    workspace = cut_town(town, tmp_path / "out")
    views(workspace)
    before = workspace.patch_match_config.read_bytes()
    with pytest.raises(InputError, match="has the lists of `sirpy views`"):
        export(workspace, "COLMAP")
    assert workspace.patch_match_config.read_bytes() == before
    export(workspace, "PMVS")


def test_mistakes_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a sirpy workspace"):
        export(Workspace(tmp_path), "MVSNET")
    with pytest.raises(InputError, match="num_sources = 0 is not possible"):
        export(Workspace(tmp_path), "MVSNET", num_sources=0)
    assert list(tmp_path.iterdir()) == []
