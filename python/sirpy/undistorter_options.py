"""The options of `colmap sir_undistorter`: those of `colmap image_undistorter`, 3.8 and 4.x, and
the grid.

Written as COLMAP writes them: `--name value` or `--name=value`, or `name=value` lines in the file
that `--project_path` names, which the command line overrides.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, NoReturn, get_args

from sirpy.engine_options import CopyPolicy, Engine, FewPoints, MvsnetDepths
from sirpy.errors import InputError, first_few

_LOGGING = (
    "log_to_stderr",
    "log_level",
    "log_target",
    "log_path",
    "log_severity",
    "log_color",
)
_RANDOM = ("random_seed", "default_random_seed")
_JPEG_QUALITY = 95
# COLMAP 3.8 writes soft-link, 4.x SOFT_LINK.
_COPY_POLICIES: dict[str, CopyPolicy] = {
    "copy": "copy",
    "hardlink": "hard-link",
    "softlink": "soft-link",
}


@dataclass(frozen=True)
class Options:
    """What the command line says, checked on its own; sizes in pixels, `roi_*` and `blank_pixels`
    are fractions."""

    image_path: Path
    input_path: Path
    output_path: Path
    image_list_path: Path | None
    mask_path: Path | None
    output_type: Engine
    copy_policy: CopyPolicy | None
    num_patch_match_src_images: int
    min_points: int
    few_points: FewPoints
    mvsnet_depths: MvsnetDepths
    blank_pixels: float
    min_scale: float
    max_scale: float
    max_image_size: int
    roi_min_x: float
    roi_min_y: float
    roi_max_x: float
    roi_max_y: float
    jpeg_quality: int
    jpeg_chroma: Literal["444", "422", "420"]
    image_format: Literal["jpg", "png", "tif"] | None
    bands: Literal["color", "all"]
    interpolation: Literal["nearest", "bilinear", "bicubic", "lanczos"]
    num_threads: int
    sub_image_columns: int | None
    sub_image_rows: int | None
    max_sub_image_size: int | None
    memory: str | None
    sub_image_overlap: int
    sub_image_column_cuts: str | None
    sub_image_row_cuts: str | None
    sub_image_roi: str | None
    sub_image_roi_list: Path | None
    area: Path | None
    area_crs: str | None
    model_crs: str | None
    cluster_size: int | None
    notes: tuple[str, ...]


def parse(arguments: list[str]) -> Options:
    """The options of a command line and of its project file.

    Raises:
        InputError: an option is unknown, missing, or has an impossible value.
        SystemExit: after `--help`.
    """
    parser = _parser()
    project = _project_file(arguments)
    # The project file comes first, so that the command line has the last word.
    defaults = vars(parser.parse_args([]))
    known = {name: value for name, value in project.items() if name in defaults}
    given = [f"--{name}={value}" for name, value in known.items()] + arguments
    values = vars(parser.parse_args(given))
    notes = _notes(values, defaults)
    if others := [name for name in project if name not in known]:
        some = first_few(others)
        notes.append(f"not used from the project file, being of other commands: {some}")
    return _checked(values, notes)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}: see colmap sir_undistorter --help")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="colmap sir_undistorter",
        allow_abbrev=False,  # or --project would be taken for --project_path, and not be read
        description="Undistorts the photographs of a sparse model and cuts them into sub-images, "
        "each with its own recapture camera: the workspace of dense reconstruction at native "
        "resolution.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    paths = parser.add_argument_group("input and output")
    paths.add_argument("--project_path", type=Path, help="file of name=value options (.ini)")
    paths.add_argument("--image_path", type=Path, help="folder of the photographs (required)")
    paths.add_argument("--input_path", type=Path, help="folder of the sparse model (required)")
    paths.add_argument("--output_path", type=Path, help="folder of the workspace (required)")
    paths.add_argument("--output_type", default="COLMAP", help=", ".join(get_args(Engine)))
    paths.add_argument("--image_list_path", type=Path, help="file of the names to use, one a line")
    paths.add_argument(
        "--copy_policy",
        help="copy, soft-link or hard-link: how PMVS, CMP-MVS, MVSNET get their numbered images; "
        "hard-link if not given",
    )
    paths.add_argument("--mask_path", type=Path, help="folder of masks NAME.png, cut with them")
    pixels = parser.add_argument_group("pixels")
    pixels.add_argument("--jpeg_quality", type=int, default=-1, help="1 to 100; -1 is 95")
    pixels.add_argument("--jpeg_chroma", default="444", choices=("444", "422", "420"))
    pixels.add_argument(
        "--image_format", choices=("jpg", "png", "tif"), help="of sub-images; JPEG stays JPEG"
    )
    pixels.add_argument(
        "--bands", default="color", choices=("color", "all"), help="all keeps alpha and infrared"
    )
    pixels.add_argument(
        "--interpolation",
        default="bilinear",
        choices=("nearest", "bilinear", "bicubic", "lanczos"),
        help="COLMAP's is bilinear",
    )
    paths.add_argument(
        "--num_patch_match_src_images",
        type=int,
        default=20,
        help="in patch-match.cfg, or in MVSNET's pair.txt",
    )
    paths.add_argument(
        "--mvsnet_depths",
        default="range",
        help="in MVSNET's cams: range (DEPTH_MIN DEPTH_MAX: PatchmatchNet) or interval (DEPTH_MIN "
        "DEPTH_INTERVAL DEPTH_NUM DEPTH_MAX: MVSNet, CasMVSNet)",
    )
    paths.add_argument("--num_threads", type=int, default=-1, help="-1 is one per core")
    grid = parser.add_argument_group("sub-images (one of the three; without any, 1 x 1)")
    grid.add_argument("--sub_image_columns", type=int, help="columns of sub-images per photograph")
    grid.add_argument("--sub_image_rows", type=int, help="rows of sub-images per photograph")
    grid.add_argument("--max_sub_image_size", type=int, help="longest side in pixels")
    grid.add_argument("--memory", help="what dense stereo may take, e.g. 8GB")
    grid.add_argument("--sub_image_overlap", type=int, default=0, help="pixels on every side")
    grid.add_argument("--sub_image_column_cuts", help="uneven columns: where they begin: 3000,8000")
    grid.add_argument("--sub_image_row_cuts", help="uneven rows: where they begin: 3000,8000")
    grid.add_argument(
        "--cluster_size", type=int, help="also write clusters of at most so many sub-images"
    )
    region = parser.add_argument_group("what is cut, in pixels of the undistorted photographs")
    region.add_argument("--sub_image_roi", help="X0,Y0,WIDTH,HEIGHT of all photographs")
    region.add_argument(
        "--sub_image_roi_list", type=Path, help="file of lines NAME X0,Y0,WIDTH,HEIGHT"
    )
    region.add_argument(
        "--area", type=Path, help="GeoJSON polygons: only sub-images that see them are cut"
    )
    region.add_argument("--area_crs", help="of the area, e.g. EPSG:25832; else what the file says")
    region.add_argument("--model_crs", help="of the model; without, the area is in its coordinates")
    points = parser.add_argument_group("sub-images that see few sparse points")
    points.add_argument("--min_points", type=int, default=1, help="few are fewer than these")
    points.add_argument(
        "--few_points",
        default="keep",
        help="keep: with the depth range of the sparse points around; drop: not written at all",
    )
    camera = parser.add_argument_group("the undistorted camera, as in image_undistorter")
    camera.add_argument("--blank_pixels", type=float, default=0.0)
    camera.add_argument("--min_scale", type=float, default=0.2)
    camera.add_argument("--max_scale", type=float, default=2.0)
    camera.add_argument("--max_image_size", type=int, default=-1, help="decimates; -1 does not")
    for name, default in (("min_x", 0.0), ("min_y", 0.0), ("max_x", 1.0), ("max_y", 1.0)):
        camera.add_argument(f"--roi_{name}", type=float, default=default)
    harmless = parser.add_argument_group("accepted for COLMAP's sake, without effect")
    for name in (*_RANDOM, *_LOGGING):
        harmless.add_argument(f"--{name}")
    return parser


def _project_file(arguments: list[str]) -> dict[str, str]:
    """The options in the file of `--project_path`, if there is one."""
    finder = _Parser(add_help=False, allow_abbrev=False)
    finder.add_argument("--project_path", type=Path)
    path: Path | None = finder.parse_known_args(arguments)[0].project_path
    if path is None:
        return {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"the project file {path} cannot be read ({error})") from None
    options: dict[str, str] = {}
    section = ""
    for number, line in enumerate(lines, start=1):
        text = line.split("#", 1)[0].strip()
        if text.startswith("[") and text.endswith("]"):
            section = text[1:-1]
        elif text:
            name, equals, value = (part.strip() for part in text.partition("="))
            if not equals:
                raise InputError(f"{path}, line {number}: {text!r} is not a name=value option")
            if section:
                name = f"{section}.{name}"
            if value:
                options[name] = value
    return options


def _checked(values: dict[str, Any], notes: list[str]) -> Options:
    for name in ("image_path", "input_path", "output_path"):
        if values[name] is None:
            raise InputError(f"--{name} is missing: see colmap sir_undistorter --help")
    _check_choice(values, "output_type", Engine)
    if values["output_type"] != "COLMAP":
        if values["image_format"] not in (None, "jpg"):
            raise InputError(
                f"--output_type {values['output_type']} takes JPEG: leave --image_format out, or "
                "give jpg"
            )
        values["image_format"] = "jpg"
    _check_choice(values, "few_points", FewPoints)
    _check_choice(values, "mvsnet_depths", MvsnetDepths)
    if values["copy_policy"] is not None:
        policy = values["copy_policy"].lower().replace("-", "").replace("_", "")
        if policy not in _COPY_POLICIES:
            raise InputError(
                f"--copy_policy {values['copy_policy']} is not possible: "
                "give one of copy, soft-link, hard-link"
            )
        values["copy_policy"] = _COPY_POLICIES[policy]
    if values["jpeg_quality"] == -1:  # COLMAP's word for its default
        values["jpeg_quality"] = _JPEG_QUALITY
    _check_range(values, "jpeg_quality", 1, 100)
    for name in (
        "num_patch_match_src_images",
        "min_points",
        "sub_image_columns",
        "sub_image_rows",
    ):
        _check_range(values, name, 1)
    _check_range(values, "max_sub_image_size", 1)
    _check_range(values, "sub_image_overlap", 0)
    _check_range(values, "cluster_size", 3)
    by_count = any(
        values[f"sub_image_{name}"] is not None
        for name in ("columns", "rows", "column_cuts", "row_cuts")
    )
    ways = [by_count, values["max_sub_image_size"] is not None, values["memory"] is not None]
    if sum(ways) > 1:
        raise InputError(
            "--sub_image_columns with --sub_image_rows, --max_sub_image_size, --memory are three "
            "ways to choose the grid: give one of them"
        )
    return Options(
        **{field.name: values[field.name] for field in fields(Options) if field.name != "notes"},
        notes=tuple(notes),
    )


def _check_choice(values: dict[str, Any], name: str, literal: Any) -> None:
    choices = get_args(literal)
    if values[name] not in choices:
        raise InputError(
            f"--{name} {values[name]} is not possible: give one of {', '.join(choices)}"
        )


def _check_range(values: dict[str, Any], name: str, least: int, most: int | None = None) -> None:
    value = values[name]
    if value is not None and (value < least or (most is not None and value > most)):
        bound = f"at least {least}" if most is None else f"{least} to {most}"
        raise InputError(f"--{name} = {value}: it must be {bound}")


def _notes(values: dict[str, Any], defaults: dict[str, Any]) -> list[str]:
    """What is accepted and does nothing."""
    notes = []
    output_type = values["output_type"]
    policy = values["copy_policy"]
    if output_type == "COLMAP" and policy is not None and policy.lower() != "copy":
        notes.append(f"--copy_policy {policy} has no effect: every sub-image is a new file")
    drops = values["few_points"] == "drop"
    for name, used, where in (
        ("num_patch_match_src_images", output_type in ("COLMAP", "MVSNET"), "COLMAP and MVSNET"),
        ("mvsnet_depths", output_type == "MVSNET", "MVSNET"),
        ("min_points", output_type == "COLMAP" or drops, "COLMAP and --few_points drop"),
    ):
        if not used and values[name] != defaults[name]:
            notes.append(
                f"--{name} {values[name]} has no effect with --output_type {output_type}: it is "
                f"for {where}"
            )
    if without := [name for name in (*_RANDOM, *_LOGGING) if values[name] is not None]:
        verb = "has" if len(without) == 1 else "have"
        notes.append(
            ", ".join(f"--{name}" for name in without)
            + f" {verb} no effect: nothing is random here, and messages go to stderr"
        )
    return notes
