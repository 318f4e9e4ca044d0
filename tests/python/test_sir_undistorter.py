"""`colmap sir_undistorter` from photographs and a model to a workspace that COLMAP takes."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from bumpy_ground import FOCAL, HEIGHT, WIDTH, write_photographs
from sirpy.errors import InputError
from sirpy.rectangle import Grid
from sirpy.sir_undistorter import grid_for_side, main
from sub_image_scenes import write_raster


@pytest.fixture
def inputs(tmp_path: Path) -> list[str]:
    """The path options of two photographs whose points lie in their left halves."""
    names = ["1.jpg", "2.jpg"]
    write_photographs(tmp_path / "photographs", names)
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", FOCAL, WIDTH, HEIGHT)
    model.add_camera_with_trivial_rig(camera)
    generator = np.random.default_rng(5)
    points = generator.uniform([-2.5, -2, 9], [-1, 2, 11], (30, 3))
    for image_id, name in enumerate(names, start=1):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0.0, 0.7 * image_id, 0.0]))
        pixels = np.array([camera.img_from_cam(pose * point) for point in points])
        image = pycolmap.Image(name=name, camera_id=1, image_id=image_id, keypoints=pixels)
        model.add_image_with_trivial_frame(image, pose)
    for index, point in enumerate(points):
        track = pycolmap.Track()
        for image_id in (1, 2):
            track.add_element(image_id, index)
        model.add_point3D(point, track)
    (tmp_path / "model").mkdir()
    model.write_binary(tmp_path / "model")
    folders = {"image": "photographs", "input": "model", "output": "out"}
    return [f"--{option}_path={tmp_path / folder}" for option, folder in folders.items()]


def test_the_workspace_is_colmaps(
    inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    arguments = ["--sub_image_columns=2", "--sub_image_overlap=8", "--num_patch_match_src_images=3"]
    assert main([*inputs, *arguments]) == 0
    images = sorted(path.name for path in (out / "images").iterdir())
    assert len(images) == 4
    model = pycolmap.Reconstruction(out / "sparse")
    assert sorted(model.image(i).name for i in model.reg_image_ids()) == images
    assert {camera.width for camera in model.cameras.values()} == {WIDTH // 2 + 8}
    # The right halves see no point, so COLMAP could not tell their depth range.
    left = [name for name in images if "c00" in name]
    stereo = out / "stereo"
    lines = (stereo / "patch-match.cfg").read_text().splitlines()
    assert lines == [line for name in left for line in (name, "__auto__, 3")]
    for number, other in enumerate((2, 1)):
        head, name, sources = (stereo / "few-points" / f"{number:04}.cfg").read_text().splitlines()
        assert name == f"{number + 1}_r00_c01.jpg"
        assert sources.split(", ")[0] == f"{other}_r00_c01.jpg"
        low, high = float(head.split()[2]), float(head.split()[4])
        # Where the plane of the left halves goes on, and some room.
        assert 6 < low < 9.5 and 10.5 < high < 25
    assert (stereo / "fusion.cfg").read_text().splitlines() == images
    assert "2 sub-images (1_r00_c01.jpg, 2_r00_c01.jpg) see fewer" in capsys.readouterr().err
    for folder in ("depth_maps", "normal_maps", "consistency_graphs"):
        assert list((out / "stereo" / folder).iterdir()) == []


def _commands(script: Path, tmp_path: Path) -> list[tuple[str, dict[str, str]]]:
    """What a run script calls of COLMAP: the command and its options."""
    fake = tmp_path / "fake colmap"
    fake.write_text('#!/bin/sh\nfor word in "$@"; do printf "%s|" "$word"; done\necho\n')
    fake.chmod(0o755)
    done = subprocess.run(
        [script],
        cwd="/",
        env={**os.environ, "COLMAP": str(fake)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    calls = [line.split("|")[:-1] for line in done.stdout.splitlines()]
    return [(words[0], dict(zip(words[1::2], words[2::2], strict=True))) for words in calls]


@pytest.mark.parametrize("kind", ["geometric", "photometric"])
def test_the_run_scripts_call_colmap_at_full_resolution(
    inputs: list[str], tmp_path: Path, kind: str
) -> None:
    assert main(inputs) == 0
    out = tmp_path / "out"
    stereo, fusion, mesher = _commands(out / f"run-colmap-{kind}.sh", tmp_path)
    consistency = "true" if kind == "geometric" else "false"
    assert stereo == (
        "patch_match_stereo",
        {
            "--workspace_path": str(out),
            "--workspace_format": "COLMAP",
            "--PatchMatchStereo.max_image_size": "-1",
            "--PatchMatchStereo.geom_consistency": consistency,
        },
    )
    assert fusion[0] == "stereo_fusion"
    assert fusion[1]["--input_type"] == kind
    assert fusion[1]["--StereoFusion.max_image_size"] == "-1"
    assert "--StereoFusion.mask_path" not in fusion[1]
    assert mesher[0] == "poisson_mesher"


def test_the_run_scripts_hand_over_the_masks(inputs: list[str], tmp_path: Path) -> None:
    (tmp_path / "black").mkdir()
    mask = pycolmap.Bitmap.from_array(np.zeros((HEIGHT, WIDTH), np.uint8))
    assert mask.write(tmp_path / "black" / "1.jpg.png")
    assert main([*inputs, f"--mask_path={tmp_path / 'black'}"]) == 0
    out = tmp_path / "out"
    _, (command, options), _ = _commands(out / "run-colmap-geometric.sh", tmp_path)
    assert command == "stereo_fusion"
    assert options["--StereoFusion.mask_path"] == str(out / "masks")


@pytest.mark.parametrize("kind", ["geometric", "photometric"])
def test_the_run_scripts_give_sub_images_without_points_their_depths(
    inputs: list[str], tmp_path: Path, kind: str
) -> None:
    assert main([*inputs, "--sub_image_columns=2"]) == 0
    out = tmp_path / "out"
    calls = _commands(out / f"run-colmap-{kind}.sh", tmp_path)
    stereo = [options for command, options in calls if command == "patch_match_stereo"]
    lists = [str(out / "stereo" / "few-points" / f"{number:04}.cfg") for number in (0, 1)]
    passes = [
        (options.get("--config_path"), options["--PatchMatchStereo.geom_consistency"])
        for options in stereo
    ]
    first = [(path, "false") for path in lists]
    if kind == "geometric":
        # The maps of all sources are there before the first geometric pass, which wants them.
        assert passes == [*first, (None, "true"), *[(path, "true") for path in lists]]
        assert [options.get("--PatchMatchStereo.filter") for options in stereo[:2]] == ["false"] * 2
    else:
        assert passes == [*first, (None, "false")]
    for options in stereo:
        assert options["--PatchMatchStereo.max_image_size"] == "-1"
        if path := options.get("--config_path"):
            head = Path(path).read_text().split()
            assert options["--PatchMatchStereo.depth_min"] == head[2]
            assert options["--PatchMatchStereo.depth_max"] == head[4]
        else:
            assert "--PatchMatchStereo.depth_min" not in options


def test_sub_images_without_points_are_dropped_as_asked(
    inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*inputs, "--sub_image_columns=2", "--few_points=drop"]) == 0
    out = tmp_path / "out"
    left = ["1_r00_c00.jpg", "2_r00_c00.jpg"]
    assert sorted(path.name for path in (out / "images").iterdir()) == left
    model = pycolmap.Reconstruction(out / "sparse")
    assert sorted(model.image(i).name for i in model.reg_image_ids()) == left
    assert (out / "stereo" / "fusion.cfg").read_text().splitlines() == left
    assert not (out / "stereo" / "few-points").exists()
    assert "2 sub-images see fewer than 1 sparse points and are left out" in capsys.readouterr().err


def test_another_output_type_cuts_png_into_jpeg_of_one_size(
    inputs: list[str], tmp_path: Path
) -> None:
    photographs = tmp_path / "photographs"
    for number in (1, 2):
        image = pycolmap.Bitmap.read(photographs / f"{number}.jpg", True)
        image.write(tmp_path / "png.png")
        (tmp_path / "png.png").rename(photographs / f"{number}.jpg")  # by content a PNG
    grid = ["--sub_image_columns=3", "--sub_image_overlap=5"]
    assert main([*inputs, *grid, "--output_type=MVSNET", "--copy_policy=soft-link"]) == 0
    out = tmp_path / "out"
    for number in range(6):
        image = out / "images" / f"{number:08}.jpg"
        assert image.is_symlink() and image.read_bytes()[:2] == b"\xff\xd8"
        assert pycolmap.Bitmap.read(image, True).width == 192
    assert len(list((out / "cams").iterdir())) == 6
    # The next cut takes away what was made of this one.
    assert main([*inputs, "--output_type=CMP-MVS"]) == 0
    assert not (out / "cams").exists() and not (out / "pair.txt").exists()
    assert sorted(path.name for path in out.glob("0*")) == [
        *("00001.jpg", "00001_P.txt", "00002.jpg", "00002_P.txt")
    ]
    assert main([*inputs, "--output_type=PMVS", "--sub_image_rows=2"]) == 0
    assert not list(out.glob("0*"))
    assert len(list((out / "pmvs" / "txt").iterdir())) == 4


def test_only_the_listed_images_are_cut(inputs: list[str], tmp_path: Path) -> None:
    names = tmp_path / "names.txt"
    names.write_text("2.jpg\n\n")
    assert main([*inputs, f"--image_list_path={names}"]) == 0
    (image,) = (tmp_path / "out" / "images").iterdir()
    assert image.name.startswith("2_")


def test_regions_uneven_grids_and_clusters(inputs: list[str], tmp_path: Path) -> None:
    regions = tmp_path / "regions.txt"
    regions.write_text("2.jpg 40,30,60,50\n")
    arguments = [
        "--sub_image_roi=10,20,100,80",
        f"--sub_image_roi_list={regions}",
        "--sub_image_column_cuts=50",
        "--sub_image_rows=2",
        "--cluster_size=3",
    ]
    assert main([*inputs, *arguments]) == 0
    model = pycolmap.Reconstruction(tmp_path / "out" / "sparse")
    sizes = {
        image.name: (camera.width, camera.height)
        for image in model.images.values()
        for camera in [model.cameras[image.camera_id]]
    }
    assert sizes == {
        "1_r00_c00.jpg": (40, 40),
        "1_r00_c01.jpg": (60, 40),
        "1_r01_c00.jpg": (40, 40),
        "1_r01_c01.jpg": (60, 40),
        "2_r00_c00.jpg": (10, 25),
        "2_r00_c01.jpg": (50, 25),
        "2_r01_c00.jpg": (10, 25),
        "2_r01_c01.jpg": (50, 25),
    }
    lists = [path.read_text().split() for path in (tmp_path / "out" / "clusters").iterdir()]
    assert {name for names in lists for name in names} == set(sizes)
    assert max(map(len, lists)) <= 3


def test_the_same_again_keeps_the_depth_maps_and_another_grid_does_not(
    inputs: list[str], tmp_path: Path
) -> None:
    assert main(inputs) == 0
    made_by_colmap = tmp_path / "out" / "stereo" / "depth_maps" / "1.jpg.photometric.bin"
    made_by_colmap.touch()
    assert main(inputs) == 0
    assert made_by_colmap.exists()
    assert main([*inputs, "--sub_image_rows=2"]) == 0
    assert not made_by_colmap.exists()


def test_the_same_without_clusters_has_none(inputs: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = [*inputs, "--output_type=PMVS", "--sub_image_rows=4", "--sub_image_columns=2"]
    assert main([*arguments, "--cluster_size=5"]) == 0
    assert len(list((out / "pmvs").glob("option-0*"))) == len(list((out / "clusters").iterdir()))
    assert main(arguments) == 0
    assert [path.name for path in (out / "pmvs").glob("option-*")] == ["option-all"]
    assert not (out / "clusters").exists() and not (out / "clusters.json").exists()


def test_after_colmap_has_run_it_can_be_cut_again(inputs: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(inputs) == 0
    scripts = [out / f"run-colmap-{kind}.sh" for kind in ("geometric", "photometric")]
    made = [
        *(out / name for name in ("fused.ply", "fused.ply.vis", "meshed-poisson.ply")),
        out / "stereo" / "consistency_graphs" / "1_r00_c00.jpg.geometric.bin",
        out / "stereo" / "depth_maps" / "1_r00_c00.jpg.geometric.bin",
    ]
    assert all(f'"$workspace/{path.name}"' in scripts[0].read_text() for path in made[:3:2])
    for path in made:
        path.touch()
    assert main(inputs) == 0
    assert all(path.exists() for path in made)
    assert main([*inputs, "--num_patch_match_src_images=3"]) == 0
    assert not any(path.exists() for path in made)
    for path in made:
        path.touch()
    assert main([*inputs, "--sub_image_rows=2"]) == 0
    assert not any(path.exists() for path in made)
    assert all(path.exists() for path in scripts)
    # An engine that has no use for them leaves nothing of theirs behind.
    assert main([*inputs, "--output_type=PMVS"]) == 0
    assert not any(path.exists() for path in [*scripts, out / "stereo" / "patch-match.cfg"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--image_list_path=LIST"], "lists nowhere.jpg, which is not in the model"),
        (["--roi_min_x=0.9", "--roi_max_x=0.1"], "roi_m"),
        (["--sub_image_columns=1000"], "larger than an image"),
        (["--sub_image_roi=0,0,9999,10"], "outside the undistorted image of 1.jpg"),
        (["--sub_image_roi_list=LIST"], "has no name"),
        (["--sub_image_column_cuts=9999"], "column cut at 9999 is outside"),
        (["--area=LIST"], "cannot be read as GeoJSON"),
        (["--area_crs=EPSG:4326"], "give --area too"),
        (["--cluster_size=2"], "must be at least 3"),
        (["--max_sub_image_size=100", "--sub_image_overlap=50"], "at least 101"),
        (["--input_path=/nowhere"], "/nowhere"),
    ],
)
def test_mistakes_are_one_sentence_and_status_2(
    inputs: list[str],
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "list").write_text("nowhere.jpg\n")
    words = [word.replace("LIST", str(tmp_path / "list")) for word in arguments]
    assert main([*inputs, *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out" / "sir.json").exists()


def test_grid_for_side_counts_the_overlap() -> None:
    sizes = [(1000, 500), (900, 700)]
    assert grid_for_side(sizes, 1000, 50) == Grid(1, 1)
    assert grid_for_side(sizes, 500, 0) == Grid(2, 2)
    assert grid_for_side(sizes, 500, 10) == Grid(3, 2)
    with pytest.raises(InputError, match="at least 21"):
        grid_for_side(sizes, 20, 10)


def test_grid_for_side_keeps_to_it_when_files_are_grown() -> None:
    sizes = [(91, 70)]
    assert grid_for_side(sizes, 40, 0, 32) == Grid(3, 3)
    assert grid_for_side(sizes, 95, 4, 32) == Grid(2, 2)
    assert grid_for_side(sizes, 91, 0, 1) == Grid(1, 1)
    with pytest.raises(InputError, match=r"leaves no pixel in sides that .* 32: give at least 32"):
        grid_for_side(sizes, 31, 0, 32)
    with pytest.raises(InputError, match=r"overlaps of 16 pixels in sides .* give at least 64"):
        grid_for_side(sizes, 63, 16, 32)


@pytest.mark.parametrize("overlap", [0, 3])
def test_no_mvsnet_image_is_larger_than_asked_for(
    inputs: list[str], tmp_path: Path, overlap: int
) -> None:
    size = ["--max_sub_image_size=40", f"--sub_image_overlap={overlap}"]
    assert main([*inputs, *size, "--output_type=MVSNET"]) == 0
    for image in (tmp_path / "out" / "images").glob("0*"):
        assert pycolmap.Bitmap.read(image, True).to_array().shape[:2] == (32, 32)


@pytest.mark.parametrize(
    "extra",
    [
        [],
        ["--sub_image_overlap=12"],
        ["--output_type=MVSNET"],
        ["--output_type=MVSNET", "--sub_image_overlap=5", "--sub_image_roi=20,10,190,150"],
    ],
)
def test_the_memory_is_for_what_is_stored(
    inputs: list[str], tmp_path: Path, extra: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another engine holds 200 bytes for each pixel of a file."""
    monkeypatch.setattr("sirpy.planning._SMALLEST_SIDE", 32)
    for side in (128, 140, 400):
        assert main([*inputs, f"--memory={200 * side * side}", *extra]) == 0
        model = pycolmap.Reconstruction(tmp_path / "out" / "sparse")
        largest = max(camera.width * camera.height for camera in model.cameras.values())
        assert largest <= side * side


def test_16_bit_photographs_are_8_bit_where_the_engine_takes_jpeg(
    inputs: list[str], tmp_path: Path
) -> None:
    deep = np.full((HEIGHT, WIDTH, 3), 500, np.uint16)
    deep[:, WIDTH // 2 :] = 1000
    for number in (1, 2):
        write_raster(tmp_path / "deep.tif", deep)
        (tmp_path / "deep.tif").rename(tmp_path / "photographs" / f"{number}.jpg")
    assert main([*inputs, "--output_type=PMVS"]) == 0
    image = pycolmap.Bitmap.read(tmp_path / "out" / "pmvs" / "visualize" / "00000000.jpg", True)
    pixels = np.asarray(image.to_array()).astype(int)
    # The photograph's white becomes 255.
    assert abs(pixels[:, 10 : WIDTH // 2 - 10] - 127.5).max() <= 2
    assert pixels[:, WIDTH // 2 + 10 :].min() >= 253
