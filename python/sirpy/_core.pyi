"""Types of the C++ core; arrays are C-contiguous unless said otherwise."""

import numpy as np
from numpy.typing import NDArray

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

def nearest_distances(
    queries: NDArray[np.float64], points: NDArray[np.float64], limit: float
) -> NDArray[np.float64]:
    """Distance from each query to the nearest point; infinity above `limit`."""
