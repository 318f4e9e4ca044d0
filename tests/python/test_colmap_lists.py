"""Names that COLMAP would read as something else."""

from __future__ import annotations

from pathlib import Path

import pycolmap
from engine_scenes import Notes
from hypothesis import given
from hypothesis import strategies as st
from sirpy.clustering import clusters
from sirpy.colmap_lists import is_listable, is_source, names_note
from sirpy.colmap_workspace import write_dense_folder
from sirpy.cutting import cut
from sirpy.rectangle import Grid
from sirpy.view_selection import views
from sirpy.workspace import Workspace
from sub_image_scenes import HEIGHT, WIDTH, camera, model_of, noise, write_image


def read_problems(text: str) -> list[tuple[str, list[str]]]:
    """patch-match.cfg by the rules of COLMAP's reader."""
    blanks = " \t\n\v\f\r"
    lines = [line.strip(blanks) for line in text.split("\n")]
    lines = [line for line in lines if line and not line.startswith("#")]
    split = [[name.strip(blanks) for name in line.replace(";", ",").split(",")] for line in lines]
    return list(zip(lines[::2], split[1::2], strict=True))


NAMES = st.text(st.sampled_from("ab#,; \t\r"), max_size=5).map(lambda start: f"{start}.jpg")


@given(st.lists(st.tuples(NAMES, st.lists(NAMES, min_size=1))))
def test_what_is_listed_is_what_is_read(problems: list[tuple[str, list[str]]]) -> None:
    listed = [
        (name, kept)
        for name, sources in problems
        if is_listable(name) and (kept := list(filter(is_source, sources)))
    ]
    text = "".join(f"{name}\n{', '.join(sources)}\n" for name, sources in listed)
    assert read_problems(text) == listed


def test_only_names_that_are_lost_are_said() -> None:
    assert names_note(["a b.jpg", "a#,;.jpg"], sources=False) == ""
    note = names_note(["a.jpg", "#c.jpg", " d.jpg", "e,.jpg"], sources=True)
    assert "names of 3 sub-images ('#c.jpg', ' d.jpg', 'e,.jpg')" in note
    assert "2 sub-images" in names_note(["#c.jpg", " d.jpg", "e,.jpg"], sources=False)


def _cut(folder: Path) -> Workspace:
    names = ["#c.jpg", "a,b.jpg", "d.jpg", "e.jpg"]
    for seed, name in enumerate(names):
        write_image(folder / "photographs" / name, noise((HEIGHT, WIDTH, 3), seed))
    (folder / "model").mkdir()
    model: pycolmap.Reconstruction = model_of(names, [camera("PINHOLE")] * 4)
    model.write_binary(folder / "model")
    return cut(folder / "photographs", folder / "model", folder / "out", grid=Grid(2, 1))


def test_the_lists_of_a_workspace_keep_their_pairs(tmp_path: Path) -> None:
    made = _cut(tmp_path)
    named = {sub.name for _, sub in made.sub_images()}
    good = {name for name in named if not name.startswith("#")}
    assert len(named) == 8 and len(good) == 6

    # COLMAP chooses the sources: a comma does no harm.
    notes = Notes()
    write_dense_folder(made, 5, progress=notes)
    assert {name for name, _ in read_problems(made.patch_match_config.read_text())} == good
    assert set(made.fusion_config.read_text().splitlines()) == good
    (note,) = notes.notes
    assert "the names of 2 sub-images ('#c_r00_c00.jpg', '#c_r00_c01.jpg')" in note

    notes = Notes()
    assert write_dense_folder(made, 5, min_points=10_000, progress=notes).unlisted == ()
    problems = [
        problem
        for path in sorted((made.stereo / "few-points").iterdir())
        for problem in read_problems(path.read_text())
    ]
    _only_good(problems, good)
    assert "the names of 4 sub-images" in notes.notes[-1]

    notes = Notes()
    views(made, progress=notes)
    _only_good(read_problems(made.patch_match_config.read_text()), good)
    assert set(made.fusion_config.read_text().splitlines()) == good
    assert "the names of 4 sub-images" in notes.notes[-1]

    notes = Notes()
    groups = clusters(made, progress=notes)
    assert {name for group in groups for name in group} == named
    listed = {name for path in made.clusters.iterdir() for name in path.read_text().splitlines()}
    assert listed == good
    assert "the names of 2 sub-images" in notes.notes[-1]


def _only_good(problems: list[tuple[str, list[str]]], good: set[str]) -> None:
    assert {name for name, _ in problems} == good
    sources = {name for _, sources in problems for name in sources}
    assert sources == {name for name in good if "," not in name}
