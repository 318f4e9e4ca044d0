"""The workspace: the one class that knows the folder (docs/formats.md); no other file joins its paths.

OUT/sir.json             native images, their sub-images, what was left out
OUT/stages.json          fingerprint of inputs and options of each stage: what makes resume safe
OUT/sfm/                 decimated photographs, database and model of structure from motion; that model
                         refined at native resolution
OUT/native/              COLMAP model of the whole undistorted images (PINHOLE, native resolution)
OUT/images/              the sub-images NAME_rRR_cCC.ext
OUT/masks/               their masks NAME_rRR_cCC.ext.png, where the photographs have some
OUT/sparse/              COLMAP model of the sub-images
OUT/clusters.json, OUT/clusters/   groups of sub-images, when asked for
OUT/views.json           sources, depth range and source windows of each sub-image
OUT/stereo/              COLMAP's dense folder: depth_maps, normal_maps, patch-match.cfg, fusion.cfg
OUT/explained/           pictures of what stereo found, on request
OUT/fusion/              the points of each sub-image
OUT/fused.ply, OUT/cloud.png, OUT/report.html, OUT/run.json
OUT/georeference.json    where on the Earth the model lies, when asked for
OUT/fused.laz, OUT/cloud.ply, OUT/dsm.tif, OUT/ortho.tif, OUT/mesh.ply, OUT/mesh.glb, OUT/tiles3d/
                         products, when asked for; OUT/tiles/: what is made of them tile by tile
OUT/mesh-pieces/         the surfaces of single tiles that the mesh was joined of

For other engines, on request (they number the sub-images):
OUT/cams/, OUT/pair.txt, OUT/images/00000000.jpg ...   MVSNet and its relatives
OUT/pmvs/, OUT/run-pmvs.sh                             PMVS
OUT/00001.jpg, OUT/00001_P.txt ...                     CMP-MVS
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Literal

from sirpy import __version__
from sirpy.errors import InputError, OutputError
from sirpy.files import read_json, write_json
from sirpy.native_images import LeftOut, NativeImage, SubImage, read_index, write_index

Pass = Literal["photometric", "geometric"]
MapFolder = Literal["depth_maps", "normal_maps", "consistency_graphs"]

# Names of `files.written_whole` and of the core's writers: .STEM.PID.tmp.EXT
_UNFINISHED = re.compile(r"\..+\.(\d+)\.tmp(\.[^.]*)?", re.DOTALL)

# A stage that has to be done again takes with it what later stages made of its output. Names may be
# patterns.
_STAGE_OUTPUTS: dict[str, tuple[str, ...]] = {
    "sparse": ("sfm",),
    "refine": ("sfm/native", "sfm/.native.patches", "sfm/refinement.json"),
    "cut": (
        "sir.json",
        "native",
        "georeference.json",
        "images",
        "masks",
        "sparse",
        "clusters.json",
        "clusters",
        "cams",
        "pair.txt",
        "pmvs",
        "run-pmvs.sh",
        "[0-9][0-9][0-9][0-9][0-9].jpg",
        "[0-9][0-9][0-9][0-9][0-9]_P.txt",
    ),
    "views": (
        "views.json",
        "stereo/patch-match.cfg",
        "stereo/fusion.cfg",
        "stereo/few-points",
        "run-colmap-geometric.sh",
        "run-colmap-photometric.sh",
    ),
    "stereo": (
        "stereo/depth_maps",
        "stereo/normal_maps",
        "stereo/reason_maps",
        "stereo/passes",
        "stereo/confidence_maps",
        "stereo/sigma_maps",
        "stereo/level_maps",
        "explained",
        "stereo/consistency_graphs",
    ),
    "fuse": ("fusion", "fused.ply", "fused.ply.vis", "meshed-poisson.ply", "run.json"),
    "report": ("report.html", "cloud.png"),
    "products": (
        "fused.laz",
        "cloud.ply",
        "dsm.tif",
        "ortho.tif",
        "mesh.ply",
        "mesh.glb",
        "mesh-pieces",
        "tiles3d",
        "tiles",
    ),
}


# Of these nothing else is made: they leave each other alone.
_LEAVES = ("report", "products")


class Workspace:
    """Paths and indices of a workspace folder; nothing is created until something is written."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)

    def __repr__(self) -> str:
        return f"Workspace({str(self.folder)!r})"

    # ---- paths
    @property
    def index(self) -> Path:
        return self.folder / "sir.json"

    @property
    def sfm(self) -> Path:
        return self.folder / "sfm"

    @property
    def sfm_model(self) -> Path:
        """The model of structure from motion, in native pixels (distorted cameras)."""
        return self.sfm / "sparse"

    @property
    def sfm_images(self) -> Path:
        """The decimated photographs, numbered in the order of their names."""
        return self.sfm / "images"

    @property
    def sfm_database(self) -> Path:
        return self.sfm / "database.db"

    @property
    def sfm_task(self) -> Path:
        return self.sfm / "task.json"

    @property
    def sfm_log(self) -> Path:
        return self.sfm / "log.txt"

    @property
    def sfm_left_out(self) -> Path:
        """Photographs that are not in `sfm_model`, and why; written when that stage is complete."""
        return self.sfm / "left_out.json"

    @property
    def sfm_components(self) -> Path:
        """Names of the photographs that could be related to each other, first those of
        `sfm_model`."""
        return self.sfm / "components.json"

    @property
    def refined_model(self) -> Path:
        """`sfm_model` refined at native resolution."""
        return self.sfm / "native"

    @property
    def refinement(self) -> Path:
        """Residuals before and after the refinement."""
        return self.sfm / "refinement.json"

    @property
    def is_refined(self) -> bool:
        return _is_whole(self.refined_model) and self.refinement.is_file()

    @property
    def is_solved(self) -> bool:
        return _is_whole(self.sfm_model)

    @property
    def solved_model(self) -> Path:
        """The best model of the photographs (distorted cameras) that was made here."""
        return self.refined_model if self.is_refined else self.sfm_model

    @property
    def native_model(self) -> Path:
        return self.folder / "native"

    @property
    def images(self) -> Path:
        return self.folder / "images"

    @property
    def sparse(self) -> Path:
        return self.folder / "sparse"

    @property
    def clusters_index(self) -> Path:
        """The clusters and their sub-images."""
        return self.folder / "clusters.json"

    @property
    def clusters(self) -> Path:
        """The lists of the clusters."""
        return self.folder / "clusters"

    def cluster(self, name: str) -> Path:
        """The names of a cluster's sub-images, one a line."""
        return self.clusters / f"{name}.txt"

    @property
    def views(self) -> Path:
        return self.folder / "views.json"

    @property
    def has_views(self) -> bool:
        """Whether view selection belongs to it, rather than maps of another program."""
        return True

    @property
    def stereo(self) -> Path:
        return self.folder / "stereo"

    def stereo_folder(self, kind: MapFolder) -> Path:
        return self.stereo / kind

    @property
    def patch_match_config(self) -> Path:
        return self.stereo / "patch-match.cfg"

    @property
    def fusion_config(self) -> Path:
        return self.stereo / "fusion.cfg"

    def few_points_config(self, number: int) -> Path:
        """A list as `patch_match_config`, of sub-images that need a depth range given."""
        return self.stereo / "few-points" / f"{number:04}.cfg"

    def run_script(self, of_pass: Pass) -> Path:
        """Dense reconstruction by COLMAP, for those who prefer it."""
        return self.folder / f"run-colmap-{of_pass}.sh"

    def image(self, sub_image: SubImage) -> Path:
        return self.images / sub_image.name

    @property
    def masks(self) -> Path:
        return self.folder / "masks"

    def mask(self, sub_image: SubImage) -> Path:
        """Black where pixels are not to be used; named as COLMAP names masks."""
        return self.masks / f"{sub_image.name}.png"

    def mvsnet_image(self, number: int) -> Path:
        return self.images / f"{number:08}.jpg"

    def mvsnet_camera(self, number: int) -> Path:
        return self.folder / "cams" / f"{number:08}_cam.txt"

    @property
    def mvsnet_pairs(self) -> Path:
        return self.folder / "pair.txt"

    @property
    def pmvs(self) -> Path:
        """The data folder of PMVS; what else is in it is named by `pmvs.py` alone."""
        return self.folder / "pmvs"

    @property
    def pmvs_groups(self) -> list[Path]:
        """The options of PMVS for single clusters, as far as there are some."""
        return sorted(self.pmvs.glob("option-[0-9]*"))

    @property
    def pmvs_script(self) -> Path:
        return self.folder / "run-pmvs.sh"

    def cmp_mvs_image(self, number: int) -> Path:
        return self.folder / f"{number:05}.jpg"

    def cmp_mvs_camera(self, number: int) -> Path:
        return self.folder / f"{number:05}_P.txt"

    def depth_map(self, sub_image: SubImage, of_pass: Pass) -> Path:
        return self.stereo / "depth_maps" / f"{sub_image.name}.{of_pass}.bin"

    def normal_map(self, sub_image: SubImage, of_pass: Pass) -> Path:
        return self.stereo / "normal_maps" / f"{sub_image.name}.{of_pass}.bin"

    def reason_map(self, sub_image: SubImage) -> Path:
        return self.stereo / "reason_maps" / f"{sub_image.name}.bin"

    def stereo_maps(self, sub_image: SubImage) -> tuple[Path, ...]:
        """All that stereo makes of a sub-image."""
        return (
            self.reason_map(sub_image),
            self.confidence_map(sub_image),
            self.sigma_map(sub_image),
            self.level_map(sub_image),
            self.normal_map(sub_image, "geometric"),
            self.depth_map(sub_image, "geometric"),
        )

    @property
    def passes(self) -> Path:
        """What stereo starts its next pass from; removed when it is done."""
        return self.stereo / "passes"

    def pass_map(self, name: str, of_pass: str) -> Path:
        return self.passes / of_pass / f"{name}.npy"

    def confidence_map(self, sub_image: SubImage) -> Path:
        return self.stereo / "confidence_maps" / f"{sub_image.name}.bin"

    def sigma_map(self, sub_image: SubImage) -> Path:
        return self.stereo / "sigma_maps" / f"{sub_image.name}.bin"

    def level_map(self, sub_image: SubImage) -> Path:
        return self.stereo / "level_maps" / f"{sub_image.name}.bin"

    def explanation(self, name: str) -> Path:
        """A picture of what stereo found in a sub-image or a native image."""
        return self.folder / "explained" / f"{name}.png"

    @property
    def fused_parts(self) -> Path:
        """Which sub-images have given points, written when all have."""
        return self.folder / "fusion" / "parts.json"

    def fused_part(self, sub_image: SubImage) -> Path:
        return self.folder / "fusion" / f"{sub_image.name}.npy"

    @property
    def fused(self) -> Path:
        return self.folder / "fused.ply"

    @property
    def georeference(self) -> Path:
        return self.folder / "georeference.json"

    @property
    def fused_laz(self) -> Path:
        return self.folder / "fused.laz"

    @property
    def cloud_ply(self) -> Path:
        """The cloud in the frame of the products; `fused` is in that of the model."""
        return self.folder / "cloud.ply"

    @property
    def surface_model(self) -> Path:
        return self.folder / "dsm.tif"

    @property
    def orthophoto(self) -> Path:
        return self.folder / "ortho.tif"

    @property
    def mesh(self) -> Path:
        return self.folder / "mesh.ply"

    @property
    def mesh_glb(self) -> Path:
        return self.folder / "mesh.glb"

    def mesh_pieces(self, fingerprint: str) -> Path:
        """The surfaces of single tiles that a mesh of these options is joined of."""
        return self.folder / "mesh-pieces" / fingerprint

    @property
    def tiles3d(self) -> Path:
        """3D Tiles of the cloud; their root is tileset.json in it."""
        return self.folder / "tiles3d"

    def tile(self, name: str, extension: str) -> Path:
        """A product of one tile of the ground: tiles/NAME.laz, tiles/NAME.dsm.tif ..."""
        return self.folder / "tiles" / f"{name}.{extension}"

    def tiles_made(self, extension: str) -> list[Path]:
        """The products of that kind that tiles of the ground have."""
        # The name of a tile has no dot: NAME.ply is not NAME.mesh.ply.
        made = self.tile("*", extension)
        return sorted(
            p for p in made.parent.glob(made.name) if "." not in p.name[: -len(extension) - 1]
        )

    @property
    def report(self) -> Path:
        return self.folder / "report.html"

    @property
    def cloud_picture(self) -> Path:
        return self.folder / "cloud.png"

    @property
    def log(self) -> Path:
        return self.folder / "log.txt"

    @property
    def run(self) -> Path:
        return self.folder / "run.json"

    # ---- what was cut
    def write_index(self, natives: list[NativeImage], left_out: list[LeftOut]) -> None:
        """Writes sir.json."""
        self._forget_index()
        write_index(self.index, natives, left_out)

    @cached_property
    def _index(self) -> tuple[tuple[NativeImage, ...], tuple[LeftOut, ...]]:
        try:
            return read_index(self.index)
        except FileNotFoundError:
            raise InputError(
                f"{self.folder} is not a sirpy workspace (it has no sir.json): "
                "run `sirpy cut` or `sirpy reconstruct` first"
            ) from None

    @property
    def natives(self) -> tuple[NativeImage, ...]:
        """The native images, in order of their names."""
        return self._index[0]

    def native(self, name: str) -> NativeImage:
        """Raises InputError when the workspace has no native image of that name."""
        try:
            return self._natives_by_name[name]
        except KeyError:
            raise InputError(
                f"{self.folder} has no photograph {name}: give a name that its sir.json has"
            ) from None

    @cached_property
    def _natives_by_name(self) -> dict[str, NativeImage]:
        return {native.name: native for native in self.natives}

    @cached_property
    def white(self) -> int:
        """The sample value that shows as white in 8 bit: the brightest native image's."""
        return max(native.white for native in self.natives)

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        return self._index[1]

    def sub_images(self) -> Iterator[tuple[NativeImage, SubImage]]:
        for native in self.natives:
            for sub_image in native.sub_images:
                yield native, sub_image

    def remove_clusters(self) -> None:
        """Also the groups of PMVS, which are made of them."""
        for path in (self.clusters_index, self.clusters, *self.pmvs_groups):
            _remove(path)

    # ---- stages
    def begin_stage(self, stage: str, fingerprint: str) -> bool:
        """Readies the folder for a stage; True when earlier output of the same inputs and options stays.

        Output of other inputs or options is removed, with that of the later stages.

        Raises:
            OutputError: the folder holds something under the name of an output that no stage made, or
                earlier output cannot be removed.
        """
        fingerprint = f"{__version__} {fingerprint}"
        known = self._known_stages()
        if known.get(stage) == fingerprint:
            self._remove_unfinished(stage)
            return True
        stages = list(_STAGE_OUTPUTS)
        stale = [stage] if stage in _LEAVES else stages[stages.index(stage) :]
        for name in stale:
            if name not in known and (foreign := self._outputs(name)):
                raise OutputError(
                    f"{foreign[0]} is in the way, and not of this workspace: "
                    "choose another folder for the output, or move it away"
                )
        for name in known.keys() & stale:
            self._remove_unfinished(name)
            for made in self._outputs(name):
                _remove(made)
        self._forget_index()
        kept = {name: value for name, value in known.items() if name not in stale}
        write_json(self.folder / "stages.json", {**kept, stage: fingerprint})
        return False

    def check_apart(self, first_stage: str, *sources: Path | None) -> None:
        """Raises InputError where an input lies among what `first_stage` and later ones remove."""
        stages = list(_STAGE_OUTPUTS)
        for stage in stages[stages.index(first_stage) :]:
            for output in _STAGE_OUTPUTS[stage]:
                target = (self.folder / output).resolve()
                for source in sources:
                    if source is not None and source.resolve().is_relative_to(target):
                        raise InputError(
                            f"{source} lies where this workspace keeps its own files, which are removed "
                            "when options change: choose another output folder, or move it"
                        )

    def _known_stages(self) -> dict[str, str]:
        """The stages that were begun, with their fingerprints."""
        try:
            return read_json(
                self.folder / "stages.json",
                lambda stages: {str(name): str(value) for name, value in stages.items()},
                f"delete {self.folder}, or choose another folder",
            )
        except FileNotFoundError:
            return {}

    def _remove_unfinished(self, stage: str) -> None:
        """Files under temporary names that a killed run of the stage left behind."""
        for output in _STAGE_OUTPUTS[stage]:
            path = self.folder / output
            hidden = [*path.parent.glob(f".{path.stem}.*.tmp*"), *path.rglob(".*.tmp*")]
            for found in hidden:
                unfinished = _UNFINISHED.fullmatch(found.name)
                # Products may be made side by side.
                if unfinished and not (stage in _LEAVES and _is_running(int(unfinished[1]))):
                    _remove(found)

    def _outputs(self, stage: str) -> list[Path]:
        """What there is of a stage's outputs."""
        found: list[Path] = []
        for output in _STAGE_OUTPUTS[stage]:
            if "[" in output:
                found += sorted(self.folder.glob(output))
            elif os.path.lexists(self.folder / output):
                found.append(self.folder / output)
        return found

    def _forget_index(self) -> None:
        for derived in ("_index", "_natives_by_name", "white"):
            self.__dict__.pop(derived, None)

    def fingerprint_of(self, stage: str) -> str:
        """The fingerprint that `stage` was begun with; empty when it never was."""
        return self._known_stages().get(stage, "")


def _is_running(process: int) -> bool:
    """Whether another process of that number runs, which may still be writing."""
    if process == os.getpid():
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _is_whole(model: Path) -> bool:
    """Whether all files of a COLMAP model are there."""
    return all((model / f"{name}.bin").is_file() for name in ("cameras", "images", "points3D"))


def check_writable(folder: Path) -> None:
    """Raises OutputError unless `folder` exists, or can be made, and takes files. Leaves nothing behind."""
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    probe = existing / f".sirpy-{os.getpid()}.tmp"
    try:
        if not existing.is_dir():
            raise NotADirectoryError(20, f"{existing} is not a folder")
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(
            f"the output folder {folder} cannot be written ({error.strerror}): "
            "choose another with --output"
        ) from error


def _remove(path: Path) -> None:
    """Raises OutputError that names what cannot be removed."""
    try:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot remove {path}: {error.strerror or error}; mend that, then run the same command again"
        ) from error
