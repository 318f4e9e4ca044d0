"""COLMAP's option names, from the command line and from a project file."""

from __future__ import annotations

from pathlib import Path

import pytest
from sirpy.errors import InputError
from sirpy.undistorter_options import Options, parse

PATHS = ["--image_path", "i", "--input_path", "m", "--output_path", "o"]

# As `colmap image_undistorter --help` of COLMAP 3.8 and 4.0 lists them.
COLMAP_3_8 = """
    --random_seed 1 --log_to_stderr 1 --log_level 2 --output_type COLMAP --copy_policy copy
    --num_patch_match_src_images 10 --blank_pixels 0.5 --min_scale 0.3 --max_scale 1.5
    --max_image_size 2000 --roi_min_x 0.1 --roi_min_y 0.2 --roi_max_x 0.8 --roi_max_y 0.9
"""
COLMAP_4 = """
    --default_random_seed=1 --log_target=stderr --log_path=/tmp --log_level=0 --log_severity=0
    --log_color=1 --copy_policy=COPY --jpeg_quality=80 --num_threads=2 --max_image_size=-1
"""


def test_all_options_of_image_undistorter_are_known() -> None:
    old = parse([*PATHS, *COLMAP_3_8.split()])
    assert (old.num_patch_match_src_images, old.max_image_size) == (10, 2000)
    assert (old.blank_pixels, old.min_scale, old.max_scale) == (0.5, 0.3, 1.5)
    assert (old.roi_min_x, old.roi_min_y, old.roi_max_x, old.roi_max_y) == (0.1, 0.2, 0.8, 0.9)
    assert ["--random_seed, --log_to_stderr, --log_level" in note for note in old.notes] == [True]
    new = parse([*PATHS, *COLMAP_4.split()])
    assert (new.jpeg_quality, new.num_threads, new.max_image_size) == (80, 2, -1)
    assert len(new.notes) == 1


def test_defaults_are_those_of_colmap() -> None:
    options = parse(PATHS)
    assert options == Options(
        image_path=Path("i"),
        input_path=Path("m"),
        output_path=Path("o"),
        image_list_path=None,
        mask_path=None,
        output_type="COLMAP",
        copy_policy=None,
        num_patch_match_src_images=20,
        min_points=1,
        few_points="keep",
        mvsnet_depths="range",
        blank_pixels=0.0,
        min_scale=0.2,
        max_scale=2.0,
        max_image_size=-1,
        roi_min_x=0.0,
        roi_min_y=0.0,
        roi_max_x=1.0,
        roi_max_y=1.0,
        jpeg_quality=95,
        jpeg_chroma="444",
        image_format=None,
        bands="color",
        interpolation="bilinear",
        num_threads=-1,
        sub_image_columns=None,
        sub_image_rows=None,
        max_sub_image_size=None,
        memory=None,
        sub_image_overlap=0,
        sub_image_column_cuts=None,
        sub_image_row_cuts=None,
        sub_image_roi=None,
        sub_image_roi_list=None,
        area=None,
        area_crs=None,
        model_crs=None,
        cluster_size=None,
        notes=(),
    )


def test_the_command_line_overrides_the_project_file(tmp_path: Path) -> None:
    project = tmp_path / "project.ini"
    project.write_text(
        "# a comment\nimage_path = i\ninput_path=m\noutput_path=o\njpeg_quality=70\n"
        "sub_image_columns=3\nimage_list_path=\n[ImageReader]\nsingle_camera=1\n"
    )
    options = parse(["--project_path", str(project), "--jpeg_quality", "80"])
    assert (options.jpeg_quality, options.sub_image_columns) == (80, 3)
    assert options.image_list_path is None
    assert any("ImageReader.single_camera" in note for note in options.notes)
    assert parse([f"--project_path={project}"]).jpeg_quality == 70


@pytest.mark.parametrize("policy", ["soft-link", "hard-link", "SOFT_LINK", "HARD_LINK"])
def test_links_are_for_numbered_images_and_else_said_to_do_nothing(policy: str) -> None:
    (note,) = parse([*PATHS, "--copy_policy", policy]).notes
    assert policy in note
    made = parse([*PATHS, "--output_type=MVSNET", "--copy_policy", policy])
    assert made.copy_policy == policy.lower().replace("_", "-")
    assert not made.notes


@pytest.mark.parametrize(
    ("option", "of", "not_of"),
    [
        ("--min_points=3", ["COLMAP"], ["PMVS", "CMP-MVS", "MVSNET"]),
        ("--mvsnet_depths=interval", ["MVSNET"], ["COLMAP", "PMVS", "CMP-MVS"]),
        ("--num_patch_match_src_images=5", ["COLMAP", "MVSNET"], ["PMVS", "CMP-MVS"]),
    ],
)
def test_options_of_other_output_types_are_said_to_do_nothing(
    option: str, of: list[str], not_of: list[str]
) -> None:
    for output_type in of:
        assert parse([*PATHS, option, f"--output_type={output_type}"]).notes == ()
    for output_type in not_of:
        (note,) = parse([*PATHS, option, f"--output_type={output_type}"]).notes
        assert f"{option.replace('=', ' ')} has no effect with --output_type {output_type}" in note
    assert parse([*PATHS, "--min_points=3", "--few_points=drop", "--output_type=PMVS"]).notes == ()


def test_a_name_is_not_completed(tmp_path: Path) -> None:
    """Else the file of `--project` would be taken and never read."""
    (tmp_path / "p.ini").write_text("jpeg_quality=70\n")
    for words in (["--project", str(tmp_path / "p.ini")], ["--jpeg_q=3"], ["--sub_image_col=2"]):
        with pytest.raises(InputError, match=f"unrecognized arguments: {words[0]}"):
            parse([*PATHS, *words])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (PATHS[:4], "--output_path is missing"),
        ([*PATHS, "--grid", "3"], "--grid"),
        ([*PATHS, "extra"], "extra"),
        ([*PATHS, "--jpeg_quality", "101"], "--jpeg_quality = 101: it must be 1 to 100"),
        ([*PATHS, "--jpeg_quality", "good"], "invalid int value: 'good'"),
        ([*PATHS, "--output_type", "NVM"], "NVM is not possible: give one of COLMAP, PMVS, CMP"),
        ([*PATHS, "--output_type=PMVS", "--image_format=png"], "--output_type PMVS takes JPEG"),
        ([*PATHS, "--few_points", "lose"], "lose is not possible: give one of keep, drop"),
        ([*PATHS, "--mvsnet_depths", "x"], "x is not possible: give one of range, interval"),
        ([*PATHS, "--min_points", "0"], "--min_points = 0: it must be at least 1"),
        ([*PATHS, "--copy_policy", "move"], "--copy_policy move"),
        ([*PATHS, "--sub_image_rows", "0"], "--sub_image_rows = 0"),
        ([*PATHS, "--sub_image_overlap", "-1"], "--sub_image_overlap = -1"),
        ([*PATHS, "--num_patch_match_src_images", "0"], "num_patch_match_src_images = 0"),
        ([*PATHS, "--sub_image_rows", "2", "--memory", "8GB"], "give one of them"),
        ([*PATHS, "--max_sub_image_size", "9", "--memory", "8GB"], "give one of them"),
        (["--project_path", "/nowhere/p.ini"], "/nowhere/p.ini cannot be read"),
    ],
)
def test_mistakes_are_one_sentence(arguments: list[str], message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(arguments)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_line_that_is_no_option_is_named(tmp_path: Path) -> None:
    project = tmp_path / "project.ini"
    project.write_text("image_path=i\nnonsense\n")
    with pytest.raises(InputError, match="line 2"):
        parse(["--project_path", str(project)])
