"""Types of the C++ core; arrays are C-contiguous unless said otherwise."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

# ---- sub_image: reading photographs, undistorting and cutting them, reading windows

def image_header(
    path: Path, bands: Literal["color", "all"]
) -> tuple[tuple[int, int, int, int], bool, float]:
    """Of a JPEG or PNG: (width, height, channels, bytes of a sample) as it will be read; has an
    alpha channel; bytes per pixel that its decoder holds of the whole image. Raises InputError."""

def count_samples(path: Path) -> NDArray[np.int64]:
    """How often each value of 0 .. 65535 occurs in a JPEG or PNG, (65536,). Raises InputError."""

class LensMap:
    """Positions in the photograph of the pixels of the undistorted image of `size` (width,
    height)."""

    def __init__(self, nodes: NDArray[np.float64], size: tuple[int, int]) -> None:
        """nodes: rows x columns x (x, y), evenly spaced from the first to the last pixel centre."""

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """n x 2 positions in the photograph of n x 2 positions in the undistorted image."""

class Recapture:
    """Photograph rows go in, sub-image files (path, x0, y0, width, height) come out."""

    def __init__(
        self,
        *,
        photograph: tuple[int, int, int, int],
        lens: LensMap | None,
        interpolation: Literal["nearest", "bilinear", "bicubic", "lanczos"],
        size: tuple[int, int],
        files: Sequence[tuple[Path, int, int, int, int]],
        jpeg_quality: int,
        jpeg_chroma: Literal["444", "422", "420"],
        last_is_alpha: bool,
        in_memory: bool,
        white: int,
    ) -> None:
        """photograph: (width, height, channels, bytes of a sample); size: (width, height) of the
        image that is cut; in_memory: the only file is not written; white: of 16 bits, written as 8 bit
        so that it is 255, or 0 for as they are."""

    @property
    def first_row(self) -> int:
        """Of the photograph, the first that is needed: the first to push."""

    @property
    def done(self) -> bool:
        """No later row is needed."""

    def push(self, rows: NDArray[Any]) -> None:
        """The next rows, n x width x channels. Raises InputError, OutputError."""

    def finish(self) -> None:
        """After the last row."""

    def read(self, path: Path, bands: Literal["color", "all"]) -> None:
        """All of that from a JPEG or PNG. Raises InputError (damaged), OutputError."""

    def take_pixels(self) -> NDArray[Any]:
        """What was kept in memory, height x width x channels; once, at the end."""

def read_window(
    path: Path,
    x0: int,
    y0: int,
    width: int,
    height: int,
    pixels: Literal["grey", "color", "all"],
    white: int,
) -> NDArray[Any]:
    """A rectangle of a JPEG or PNG: 8-bit height x width grey or height x width x 3 RGB, with 16
    bits scaled so that `white` is 255; or all channels as stored, height x width x n."""

def convert_pixels(
    stored: NDArray[Any], pixels: Literal["grey", "color", "all"], white: int
) -> NDArray[Any]:
    """The same of pixels in memory, height x width x channels."""

# ---- tie_points: squares of photographs, and where they are in others

class PatchCutter:
    """Squares of `side` pixels with the top-left pixels `origins` (n, 2: x, y), cut from a photograph of shape
    (width, height, channels, bytes of a sample) while its rows go by."""

    def __init__(
        self, photograph: tuple[int, int, int, int], origins: NDArray[np.int64], side: int
    ) -> None: ...
    @property
    def first_row(self) -> int:
        """The first row that is to be pushed."""
    @property
    def done(self) -> bool: ...
    def push(self, rows: NDArray[Any]) -> None:
        """The next rows, n x width x channels."""

    def read(self, path: Path) -> None:
        """Reads all that is needed from a JPEG or PNG. Raises InputError."""

    def take(self, side: int) -> NDArray[np.uint16]:
        """Luma (n, side, side), 8 bit times 256. Once."""

class MatchingOptions:
    """Pixels; see cpp/src/tie_points/least_squares_matching.h."""

    min_correlation: float
    max_rival: float
    max_deviation: float
    max_distortion: float
    max_saturated: float
    def __init__(self, radius: int, search_radius: int, grey_level: float) -> None: ...

def best_textured(
    patches: NDArray[np.uint16],
    starts: NDArray[np.int32],
    radius: int,
    window_radius: int,
    threads: int,
) -> NDArray[np.int32]:
    """(n, 2) pixels with the most texture within `radius` of `starts` (n, 2), each in its patch."""

def match_patches(
    references: NDArray[np.uint16],
    centres: NDArray[np.int32],
    targets: NDArray[np.uint16],
    positions: NDArray[np.float64],
    affines: NDArray[np.float64],
    whites: NDArray[np.int32],
    threads: int,
    options: MatchingOptions,
) -> tuple[
    NDArray[np.uint8],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]:
    """(status (n,), position (n, 2), affine (n, 2, 2), covariance (n, 2, 2), correlation (n,)) of the pixels
    `centres` of square patches in target patches; predicted at `positions`, with target_from_reference `affines`.
    Positions are in pixels of the patch, the centre of its first at (0, 0). `whites` (n, 2): luma from which on
    reference and target are saturated."""

# ---- sub_image: sparse models (sirpy.model_arrays)

# id, COLMAP's number of the camera model, width, height, parameters
Camera = tuple[int, int, int, int, list[float]]
# id, camera id, name, cam_from_world as quaternion w x y z and translation
Image = tuple[int, int, str, Sequence[float]]
# cameras; images; point ids (n,), positions (n, 3), colours (n, 3), errors (n,); where each image's
# observations start (images + 1,), their pixels (m, 2), the indices of their points (m,)
Model = tuple[
    list[Camera],
    list[Image],
    NDArray[np.uint64],
    NDArray[np.float64],
    NDArray[np.uint8],
    NDArray[np.float64],
    NDArray[np.int64],
    NDArray[np.float64],
    NDArray[np.int32],
]

def num_camera_parameters(model: int) -> int:
    """By COLMAP's number of the camera model; -1 when there is none."""

def read_model(folder: Path) -> Model:
    """Of a binary model. InputError names the file that is damaged."""

def write_model(model: Model, folder: Path) -> None:
    """Replaces `folder` when all is written. Raises OutputError."""

def sub_image_model(
    native: Model, sub_images: Sequence[tuple[str, int, int, int, int, int]]
) -> Model:
    """sub_images: (name, index of the native image, x0, y0, width, height)."""

# ---- stereo (sirpy.dense_stereo); maps of normals are (3, height, width)

class PatchMatchOptions:
    """Units and bounds: cpp/src/patch_match_sir.h."""

    iterations: int
    offers: int
    largest_step: float
    top_views: int
    color_sigma: float
    space_sigma: float
    geometric_weight: float
    max_geometric_error: float
    consistency: float
    agreement: float
    prior_weight: float
    noise: list[float]
    everywhere: bool
    seed: int
    threads: int
    def __init__(self) -> None: ...
    def validate(self) -> None:
        """ValueError names field, value and bound."""

class ViewWindow:
    """A window of a native image at a level (pixels of that level), its camera and its depths.

    inverse_depth: of sources in a geometric pass, 0 where there is none; deviation: its standard deviation.
    """

    def __init__(
        self,
        *,
        intrinsics: NDArray[np.float64],
        cam_from_world: NDArray[np.float64],
        level: int,
        x0: int,
        y0: int,
        grey: NDArray[np.uint8],
        inverse_depth: NDArray[np.float32] | None = None,
        deviation: NDArray[np.float32] | None = None,
    ) -> None: ...

class StartMaps:
    """What the pass before found: depth, normal (3 planes), views (bits of sources); standard deviation of the
    depth and the level that it comes from, both or neither."""

    def __init__(
        self,
        *,
        level: int,
        x0: int,
        y0: int,
        depth: NDArray[np.float32],
        normal: NDArray[np.float32],
        views: NDArray[np.uint32],
        sigma: NDArray[np.float32] | None = None,
        level_of: NDArray[np.uint8] | None = None,
    ) -> None: ...

def patch_match(
    *,
    reference: ViewWindow,
    sources: Sequence[ViewWindow | None],
    block_side: int,
    allowed: NDArray[np.uint32],
    min_depth: NDArray[np.float32],
    max_depth: NDArray[np.float32],
    points: NDArray[np.float64],
    start: StartMaps | None,
    options: PatchMatchOptions,
) -> dict[str, NDArray[Any]]:
    """depth, normal, views, cost, texture, num_seeing, num_consistent, sigma, motion, level of the reference
    window; points: n x (x, y, depth)."""

class PlanarCompletionOptions:
    """Units and bounds: cpp/src/patch_match/planar_completion.h."""

    grey_step: float
    edge_texture: float
    weak_texture: float
    min_consistent: int
    tolerance: float
    min_share: float
    min_samples: int
    max_error: float
    rounds: int
    threads: int

def complete_planes(
    *,
    level: int,
    x0: int,
    y0: int,
    intrinsics: NDArray[np.float64],
    grey: NDArray[np.uint8],
    depth: NDArray[np.float32],
    normal: NDArray[np.float32],
    views: NDArray[np.uint32],
    texture: NDArray[np.float32],
    num_consistent: NDArray[np.uint8],
    source_centres: NDArray[np.float64],
    options: PlanarCompletionOptions,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """depth, normal and 1 where they are those of a plane around; source_centres: n x 3, in the
    camera frame."""

PLANAR_COMPLETION_MARGIN: int  # pixels of the level around a pixel that `complete_planes` looks at

def patch_match_margin(iterations: int) -> int:
    """Pixels of the level around a pixel that its result depends on."""

def shrunk(grey: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """The mean of each block of factor x factor pixels."""

def patch_match_bytes_per_pixel() -> tuple[int, int, int]:
    """Of the reference window, of each source window, and of the former at the end, when nothing is held
    of the sources; beside what is given."""

def find_speckles(
    depth: NDArray[np.float32],
    normal: NDArray[np.float32],
    sigma: NDArray[np.float32],
    *,
    intrinsics: NDArray[np.float64],
    x0: int,
    y0: int,
    step: float,
    deviations: float,
    min_pixels: int,
) -> NDArray[np.uint8]:
    """1 for each pixel of a speckle, (height, width); normal: 3 planes; step: pixels' worth of depth, or so many
    standard deviations of it, whichever is more."""

def coplanar_shares(
    depth: NDArray[np.float32],
    normal: NDArray[np.float32],
    sigma: NDArray[np.float32],
    *,
    intrinsics: NDArray[np.float64],
    x0: int,
    y0: int,
) -> NDArray[np.float32]:
    """Share of the pixels around each that lie on its plane, (height, width); normal: 3 planes."""

def box_means(plane: NDArray[np.float32], radius: int) -> NDArray[np.float32]:
    """The mean of what lies within `radius` across and down of each pixel, inside the map."""

def instruction_set() -> str: ...
def group_correlation(
    reference: NDArray[np.float32],
    source: NDArray[np.float32],
    source_from_reference: NDArray[np.float32],
    depth: NDArray[np.float32],
    *,
    first_row: int,
    behind: tuple[float, float],
    groups: int,
) -> NDArray[np.float32]:
    """Groups x hypotheses x height x width, of PatchmatchNet: mean products of the channels of each
    group. reference: rows from `first_row` on, height x width x channels; source: the same of any
    size; source_from_reference: 3 x 4; depth: hypotheses x height x width; behind: the (x, y) of
    what lies behind the source. A multiple of 16 channels, of 4 in a group. Releases the GIL."""

# ---- fusion (sirpy.fusion)

class FusionOptions:
    """Units and bounds: cpp/src/fusion.h."""

    min_consistent: int
    consistency: float
    yield_shift: float
    yield_footprint: float
    see_through: float
    agreement: float
    thin: bool
    keep_duplicates: bool
    threads: int
    def __init__(self) -> None: ...
    def validate(self) -> None:
        """ValueError names field, value and bound."""

class DepthView:
    """A window of depths of a native image, their standard deviations, its camera and its rank (the lower
    emits)."""

    def __init__(
        self,
        *,
        intrinsics: NDArray[np.float64],
        cam_from_world: NDArray[np.float64],
        x0: int,
        y0: int,
        rank: int,
        depth: NDArray[np.float32],
        sigma: NDArray[np.float32] | None = None,
    ) -> None: ...

def fuse(
    reference: DepthView,
    normal: NDArray[np.float32],
    color: NDArray[np.uint8],
    confidence: NDArray[np.float32] | None,
    level: NDArray[np.uint8] | None,
    sources: Sequence[DepthView | None],
    *,
    block_side: int,
    allowed: NDArray[np.uint32],
    options: FusionOptions,
) -> tuple[NDArray[np.uint8], tuple[int, int, int, int]]:
    """(the bytes of the points, as cloud.POINT; pixels that are (invalid, inconsistent, seen through,
    yielded))."""

NORMAL_REACH: int  # pixels around a window that its normals depend on

def normals_of_depth(
    depth: NDArray[np.float32],
    *,
    intrinsics: NDArray[np.float64],
    x0: int,
    y0: int,
    threads: int = 0,
) -> NDArray[np.float32]:
    """(3, height, width) of a window at (x0, y0), of a map with NORMAL_REACH more pixels on each side."""

# ---- the surface model (sirpy.surface_model)

class SurfaceOptions:
    """Units and bounds: cpp/src/surface_model.h."""

    cell: float
    reach: float
    thickness: float
    share: float
    near: float
    support: int
    def __init__(self) -> None: ...
    @property
    def margin(self) -> int:
        """Cells around a window whose points count in it."""
    def validate(self) -> None:
        """ValueError names field, value and bound."""

def surface_heights(
    points: NDArray[np.void],
    *,
    column: int,
    row: int,
    width: int,
    height: int,
    options: SurfaceOptions,
) -> NDArray[np.float32]:
    """Heights (height, width) of a window of the lattice; NaN where there is none. points: of
    sirpy.cloud.POINT. Releases the GIL."""

class GapOptions:
    """Units and bounds: cpp/src/surface_model.h."""

    longest: float
    cell: float
    step: float
    def __init__(self) -> None: ...
    @property
    def margin(self) -> int:
        """Cells around a window whose heights count in it."""

def fill_gaps(heights: NDArray[np.float32], *, options: GapOptions) -> NDArray[np.float32]:
    """The heights of a window, narrow gaps filled from their lower side, of those of the window and
    its margin. Releases the GIL."""

# ---- synthetic scenes (sirpy.synthetic, sirpy.truth)

class Surface:
    """Triangles in world coordinates; a ray or a point is asked for by rows of (n, 3) float64."""

    def __init__(self, vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> None: ...
    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def triangles(self) -> NDArray[np.int32]: ...
    def cast(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """t of the first hit at origin + t * direction for each; infinity where there is none."""

    def sees(
        self, viewpoint: NDArray[np.float64], points: NDArray[np.float64], tolerance: float
    ) -> NDArray[np.bool_]: ...
    def distances(self, points: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
        """Distance to the surface; infinity above `limit`."""

    def sample(
        self,
        spacing: float,
        seed: int,
        minimum: NDArray[np.float64],
        maximum: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points and normals, one for each spacing^2 of area with minimum <= (x, y) < maximum."""

class SceneOptions:
    seed: int
    half_extent: float
    terrain_step: float
    finest_detail: float
    tall: float
    def __init__(self) -> None: ...

class RenderOptions:
    samples: int
    sun: NDArray[np.float64]
    noise: float
    seed: int
    threads: int
    def __init__(self) -> None: ...

class Scene:
    def __init__(self, options: SceneOptions) -> None: ...
    @property
    def surface(self) -> Surface: ...
    def render(
        self,
        nodes: NDArray[np.float64],
        first_row: int,
        centre: NDArray[np.float64],
        world_from_cam: NDArray[np.float64],
        options: RenderOptions,
    ) -> NDArray[np.uint8]:
        """RGB (rows, columns, 3) from rays at pixel corners, (rows + 1, columns + 1, 2)."""

def terrain_heights(seed: int, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the ground of the scene of that seed, (n,), at places (n, 2)."""

def nearest_distances(
    queries: NDArray[np.float64], points: NDArray[np.float64], limit: float
) -> NDArray[np.float64]:
    """Distance from each query to the nearest point; infinity above `limit`."""
