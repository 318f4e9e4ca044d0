"""Data flows one way: a module imports only from the stages before it."""

from __future__ import annotations

import ast
from pathlib import Path

import sirpy

PACKAGE = Path(sirpy.__file__).parent
# Each line may import from the lines above it, and from modules to its left.
LAYERS = """
    child_process engine_options errors crs files memory npy rectangle resources
    native_images workspace progress
    weights
    _core _adjustment
    photographs exif ply pictures left_out noise resolution detail
    flight truth synthetic
    model_files model_arrays initial_cameras
    feature_selection feature_tiles feature_extraction features
    patch_store tie_point_views tie_points
    adjustment_arrays bundle_adjustment refinement_record native_refinement
    sfm_options lens_models mapping pairing position_priors rigs self_calibration structure_from_motion
    survey sparse_model sfm
    lens recapturing sub_image_model native_scene
    colmap_lists ground view_fields view_windows view_selection windows photograph_detail
    filtering depth_range depth_search stereo_backend stereo_passes settling patch_match judging
    dense_stereo patchmatchnet
    area layout planning sub_image_sets
    cut_tasks cutting
    clustering
    engine_views
    cmp_mvs mvsnet pmvs colmap_workspace
    exporting
    undistorter_options sir_undistorter colmap_launcher
    frame cloud depth_maps colmap_dense
    fusion
    similarity local_frame point_tables places camera_positions ground_control alignment aligning
    georeference tiles products
    laz point_selection cloud_files tiles3d tiles3d_worker
    lattice block_store raster_files surface_model best_views orthophoto
    mesh_cutting mesh_files point_groups mesh_tiles mesh_matching mesh_joints mesh
    overview cloud_picture explaining residual_plot camera_report survey_pictures survey_report html_report
    posed_camera coloured_points rephotography common_ground held_out judged_cloud
    rephotograph_score rephotograph evaluation_picture evaluation
    deliverables pipeline demo plan_table
    evaluation_cli weights_cli sfm_cli features_cli georeference_cli mesh_cli rasters_cli tiles3d_cli cli __main__
"""
PLACES = {name: place for place, name in enumerate(["__init__", *LAYERS.split()])}


def imports(module: str) -> set[str]:
    """The modules of this package that `module` imports, at its top or inside its functions."""
    files = [PACKAGE / f"{module}.py", *PACKAGE.glob(f"{module}/*.py")]
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in files if path.exists()]
    found = set()
    for node in (node for tree in trees for node in ast.walk(tree)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module == "sirpy":
            names = [f"sirpy.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}.py imports relative to itself: write sirpy.NAME"
            names = [node.module or ""]
        found |= {name.split(".")[1] for name in names if name.startswith("sirpy.")}
    return found & PLACES.keys() - {module}


def test_every_module_has_its_place() -> None:
    modules = {path.stem for path in PACKAGE.glob("*.py")}
    modules |= {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    missing = modules - PLACES.keys()
    assert not missing, f"say in LAYERS ({__file__}) which stages {sorted(missing)} come after"


def test_modules_import_only_from_stages_before_them() -> None:
    backwards = [
        f"{module} imports {imported}"
        for module in sorted(PLACES.keys() - {"__init__", "_core", "_adjustment"})
        for imported in sorted(imports(module))
        if PLACES.get(imported, -1) >= PLACES.get(module, len(PLACES))
    ]
    assert not backwards
