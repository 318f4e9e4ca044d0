"""The folder: what it reads back, and whose files it removes."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sirpy.cli import app
from sirpy.clustering import clusters, read_clusters
from sirpy.errors import InputError, OutputError
from sirpy.rectangle import Rectangle
from sirpy.view_selection import read_views, views
from sirpy.workspace import LeftOut, NativeImage, SubImage, Workspace
from sub_image_scenes import HEIGHT, WIDTH, camera, model_of
from typer.testing import CliRunner

NAMES = ["a.jpg", "b.jpg"]
DAMAGED = ["", "[", "[]", "{}", "null", "3", '{"version": 1}', '{"version": 2}', "\0", "[" * 99999]


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    """Two photographs of one sub-image each, as `cut` leaves them, without the pixels."""
    made = Workspace(tmp_path / "out")
    made.begin_stage("cut", "one")
    model = model_of(NAMES, [camera("PINHOLE")] * 2)
    for folder in (made.native_model, made.sparse):
        folder.mkdir()
        model.write_binary(folder)
    whole = Rectangle(0, 0, WIDTH, HEIGHT)
    natives = [
        NativeImage(name, WIDTH, HEIGHT, (SubImage(name, 0, 0, whole, whole),), 255, True)
        for name in NAMES
    ]
    made.write_index(natives, [LeftOut("c.jpg", "it is lost")])
    return made


def test_the_index_is_read_as_it_was_written(workspace: Workspace) -> None:
    written = workspace.natives, workspace.left_out
    again = Workspace(workspace.folder)
    assert (again.natives, again.left_out) == written
    assert [native.masked for native in again.natives] == [True, True]
    assert again.left_out == (LeftOut("c.jpg", "it is lost"),)


def _one_sentence(path: Path, read: Callable[[], object]) -> str:
    with pytest.raises(InputError) as caught:
        read()
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    return message


@pytest.mark.parametrize("text", DAMAGED)
def test_damaged_files_are_one_sentence(workspace: Workspace, text: str) -> None:
    folder = workspace.folder
    views(workspace)
    clusters(workspace)
    for path, read in (
        (workspace.clusters_index, lambda: read_clusters(workspace)),
        (workspace.views, lambda: read_views(workspace)),
        (workspace.index, lambda: Workspace(folder).natives),
        (workspace.index, lambda: Workspace(folder).left_out),
    ):
        path.write_text(text)
        assert path.name in _one_sentence(path, read)
    if text not in ("{}", '{"version": 1}', '{"version": 2}'):  # these are stages
        stages = folder / "stages.json"
        stages.write_text(text)
        assert "is damaged" in _one_sentence(stages, lambda: workspace.fingerprint_of("cut"))
        assert "is damaged" in _one_sentence(stages, lambda: workspace.begin_stage("cut", "one"))
    done = CliRunner().invoke(app, ["views", str(folder)])
    assert isinstance(done.exception, InputError)


def test_a_file_that_lacks_any_part_is_one_sentence(workspace: Workspace) -> None:
    """Each value in turn taken away, or of another kind."""
    views(workspace)
    clusters(workspace)
    for path, read in (
        (workspace.clusters_index, lambda: read_clusters(workspace)),
        (workspace.views, lambda: read_views(workspace)),
        (workspace.index, lambda: Workspace(workspace.folder).natives),
    ):
        whole = json.loads(path.read_text())
        for variant in _variants(whole):
            path.write_text(json.dumps(variant))
            try:
                read()
            except InputError as error:
                assert str(error).startswith(str(path))
        path.write_text(json.dumps(whole))
        read()


def _variants(value: Any) -> list[Any]:
    """`value` with one part of it missing or replaced."""
    changed: list[Any] = [None, "x", 1e999, [], {}]
    if isinstance(value, dict):
        for key in value:
            changed.append({k: v for k, v in value.items() if k != key})
            changed += [{**value, key: variant} for variant in _variants(value[key])]
    if isinstance(value, list):
        for i in range(len(value)):
            changed.append(value[:i] + value[i + 1 :])
            changed += [[*value[:i], variant, *value[i + 1 :]] for variant in _variants(value[i])]
    return changed


def test_an_index_of_another_version_is_said_and_cut_again(workspace: Workspace) -> None:
    index = json.loads(workspace.index.read_text())
    for image in index["images"]:
        del image["white"], image["masked"]
    workspace.index.write_text(json.dumps({**index, "version": 1}))
    message = _one_sentence(workspace.index, lambda: Workspace(workspace.folder).natives)
    assert "was made by another version of sirpy: delete it and cut again" in message


def test_what_others_hide_in_the_folder_stays(workspace: Workspace, tmp_path: Path) -> None:
    ours = [
        workspace.folder / ".sir.12.tmp.json",
        workspace.folder / ".sparse.12.tmp",
        workspace.images / ".a.12.tmp.jpg",
        workspace.images / "strip" / ".b.c.12.tmp",
    ]
    theirs = [
        workspace.folder / ".sparse.tmp",
        workspace.images / ".draft.tmp",
        workspace.images / ".a.tmp.jpg",
        workspace.images / "strip" / "a.12.tmp.jpg",
    ]
    for path in ours + theirs:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert workspace.begin_stage("cut", "one")
    assert [path.exists() for path in ours] == [False] * 4
    assert [path.exists() for path in theirs] == [True] * 4


def test_nothing_is_removed_from_a_folder_of_others(tmp_path: Path) -> None:
    left = [tmp_path / "images" / name for name in ("a.jpg", ".a.12.tmp.jpg", ".draft.tmp")]
    left.append(tmp_path / ".sir.12.tmp.json")
    (tmp_path / "images").mkdir()
    for path in left:
        path.touch()
    with pytest.raises(OutputError, match="images is in the way, and not of this workspace"):
        Workspace(tmp_path).begin_stage("cut", "one")
    assert all(path.exists() for path in left)
    assert not (tmp_path / "stages.json").exists()


def test_what_cannot_be_removed_is_said(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path) -> None:
        raise PermissionError(13, "Permission denied", path.name)

    monkeypatch.setattr(shutil, "rmtree", refused)
    sentence = f"cannot remove {workspace.native_model}: Permission denied; mend that"
    with pytest.raises(OutputError, match=sentence):
        workspace.begin_stage("cut", "two")
    monkeypatch.undo()
    assert not workspace.begin_stage("cut", "two")
    assert not workspace.native_model.exists()


def test_report_and_products_leave_each_other_alone(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    workspace.begin_stage("fuse", "a")
    workspace.begin_stage("products", "b")
    workspace.surface_model.write_bytes(b"heights")
    workspace.begin_stage("report", "c")
    workspace.report.write_text("page")
    workspace.begin_stage("products", "b")
    assert workspace.surface_model.exists()
    workspace.begin_stage("products", "of another frame")
    assert workspace.report.exists()
    assert not workspace.surface_model.exists()
    workspace.begin_stage("fuse", "d")
    assert not workspace.report.exists()


def test_what_another_process_is_writing_stays(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    workspace.begin_stage("products", "a")
    running, dead = (tmp_path / f".dsm.{number}.tmp.tif" for number in (os.getppid(), 2**22 + 1))
    running.write_bytes(b"")
    dead.write_bytes(b"")
    workspace.begin_stage("products", "a")
    assert running.exists()
    assert not dead.exists()
