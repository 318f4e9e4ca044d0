"""What estimates depths: the protocol of a stereo backend, what it is given, and what it gives.

A backend is one pass over all sub-images, or photographs, at one level of the pyramid. PatchMatch is a list of them
from coarse to native; a network is mostly one, at native resolution. Packages offer theirs as entry points of the
group `sirpy.stereo`: functions that take a `Setup` and return a backend, or a list of them (docs/backends.md).

Level l has pixels of 2^l native ones, counted from the corner of the native image; rectangles are in pixels of their
level.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.depth_range import DepthRange as DepthRange  # also for packages
from sirpy.errors import InputError, SirpyError
from sirpy.filtering import CONFIDENCE, FilterOptions, check_bounds
from sirpy.native_scene import NativeCamera
from sirpy.rectangle import Rectangle
from sirpy.view_windows import LEAST_COARSEST, MOST_LEVEL
from sirpy.workspace import Pass

if TYPE_CHECKING:
    import torch

FloatMap = npt.NDArray[np.float32]
Plane = Literal["depth", "normal", "views", "sigma", "level", "cost", "texture", "counts"]
GROUP = "sirpy.stereo"
DEFAULT_BACKEND = "patch_match"
TORCH_BYTES = 320_000_000  # that torch adds to a process, when it has worked
DEVICES = ("auto", "cpu", "cuda")


class OutOfDeviceMemory(Exception):
    """A backend's device cannot hold the window: a smaller one may do."""


@dataclass(frozen=True)
class StereoOptions(FilterOptions):
    """Options of `stereo`; those of PatchMatch carry the names and defaults of the C++ core."""

    backend: str = DEFAULT_BACKEND  # a name of the entry points `sirpy.stereo`
    device: str = "auto"  # of networks: auto is a GPU where torch sees one
    min_depth: float | None = (
        None  # of the scene, unit of the model; None: by the sparse points, generously
    )
    max_depth: float | None = None
    top_views: int = 4  # sources that a pixel is matched against, at most
    native_iterations: int = 3  # sweeps at native resolution, photometric pass
    geometric_iterations: int = 1  # sweeps of the geometric pass there
    seed: int = 0
    threads: int = 0  # 0: one for each core

    def __post_init__(self) -> None:
        super().__post_init__()
        bounds = {
            "top_views": (1, 32),
            "native_iterations": (1, 100),
            "geometric_iterations": (1, 100),
            "threads": (0, 1024),
        }
        check_bounds(self, bounds)
        near, far = self.min_depth, self.max_depth
        if not (near is None or 0 < near < float("inf")) or not (
            far is None or (near or 0) < far < float("inf")
        ):
            raise InputError(
                f"depths from {near} to {far} are not possible: choose a nearest one above 0 and a "
                "farthest one above it"
            )
        if self.device not in DEVICES:
            raise InputError(f"--device {self.device} is not possible: choose {', '.join(DEVICES)}")


@dataclass(frozen=True)
class View:
    """A window of an undistorted photograph at a level.

    Attributes:
        camera: of the whole photograph, native pixels, pixel centres at .5.
        window: pixels of the level; it may reach beyond the photograph, where the nearest pixels go on.
        extent: what there is of the photograph, pixels of the level.
        read: the pixels of any rectangle of the level, "grey" (height, width) or "color"
            (height, width, 3), 8 bit.
        index: of a source, in the field's table; its bit in `ViewField.allowed`.
        depth: of a source in a geometric pass, (height, width); 0 where there is none.
        sigma: its standard deviation; None where the pass before does not say.
        noise: of the reference, variance of its grey levels by 16 steps of brightness, at the level.
    """

    camera: NativeCamera
    window: Rectangle
    level: int
    extent: Rectangle
    read: Callable[[Rectangle, Literal["grey", "color"]], npt.NDArray[np.uint8]]
    index: int = -1
    depth: FloatMap | None = None
    sigma: FloatMap | None = None
    noise: FloatMap | None = None

    @property
    def name(self) -> str:
        return self.camera.name

    @cached_property
    def grey(self) -> npt.NDArray[np.uint8]:
        """(height, width)."""
        return self.read(self.window, "grey")

    @cached_property
    def image(self) -> npt.NDArray[np.uint8]:
        """(height, width, 3), RGB."""
        return self.read(self.window, "color")

    @property
    def intrinsics(self) -> npt.NDArray[np.float64]:
        """(3, 3) of the window as an image of its own, pixel centres at whole numbers."""
        return self.camera.window_intrinsics(self.window, self.level)


class Maps(Protocol):
    """What the pass before found, in any rectangle of the reference."""

    level: int

    def read(self, native: str, rectangle: Rectangle, kind: Plane) -> npt.NDArray[Any]:
        """(height, width), of the normals (3, height, width); 0 where nothing was estimated."""

    def start(self, native: str, rectangle: Rectangle, level: int) -> _core.StartMaps | None:
        """What PatchMatch starts from in a rectangle of a level."""


@dataclass(frozen=True)
class Prior:
    """What is known of the reference before.

    Attributes:
        points: sparse points (n, 3): x and y in native pixels, depth.
        maps: of the pass before; None in the first.
        coarser: of the last pass of the next coarser level; None where there is none.
    """

    points: npt.NDArray[np.float64]
    maps: Maps | None
    coarser: Maps | None = None


_KINDS = {
    "views": np.dtype(np.uint32),
    "num_seeing": np.dtype(np.uint8),
    "num_consistent": np.dtype(np.uint8),
    "level": np.dtype(np.uint8),
}


@dataclass
class DepthMap:
    """What a backend finds in the window of the reference, (height, width); None: it does not say.

    Depth is z in the reference camera, 0 where there is none. What is kept of it needs the last seven;
    where the last backend of a list is not geometric, they are found by `sirpy.judging`.
    """

    depth: FloatMap
    normal: FloatMap | None = None  # (3, height, width), camera frame, towards the camera
    views: npt.NDArray[np.uint32] | None = None  # bit j: source j was used
    cost: FloatMap | None = None  # 1 - NCC over the sources used
    texture: FloatMap | None = None  # variance of the grey levels in the patch
    num_seeing: npt.NDArray[np.uint8] | None = None
    num_consistent: npt.NDArray[np.uint8] | None = None
    sigma: FloatMap | None = None  # standard deviation of the depth
    motion: FloatMap | None = None  # change of depth that moves it by a pixel in the sources
    level: npt.NDArray[np.uint8] | None = None  # of the pixels that the depth comes from


def check_depth_map(found: DepthMap, window: Rectangle, of_pass: StereoBackend) -> None:
    """Raises InputError where a backend gives what it must not: a package of others may be at fault."""
    shape = window.height, window.width
    needed: set[str] = {"depth", *of_pass.planes}
    if "counts" in needed:
        needed = needed - {"counts"} | {"num_seeing", "num_consistent"}
    if of_pass.is_last:
        needed |= {
            "normal",
            "cost",
            "texture",
            "num_seeing",
            "num_consistent",
            "sigma",
            "motion",
            "level",
        }
    for name in sorted(needed):
        plane = getattr(found, name, None)
        kind = _KINDS.get(name, np.dtype(np.float32))
        if not isinstance(plane, np.ndarray):
            what = f"no {name}"
        elif plane.dtype != kind or plane.shape[-2:] != shape:
            what = f"{name} as {plane.dtype} {plane.shape}"
        elif name == "depth" and not np.isfinite(plane).all():
            what = "depths that are no finite numbers"
        else:
            continue
        raise InputError(
            f"the stereo backend found {what} for a window of {shape} pixels (pass {of_pass.name}): its "
            f"package has to give {name} as {kind}, 0 where there is none"
        )


class StereoBackend(Protocol):
    """Estimates depths of a window of a photograph. Whatever has a default here can be a plain attribute."""

    @property
    def level(self) -> int:
        """Of the pyramid; the coarsest of the views and those above are worked on by whole photographs, others
        by sub-images."""
        return 0

    @property
    def kind(self) -> Pass:
        """Geometric: the sources come with the depths that the pass before has found in them."""
        return "photometric"

    @property
    def margin(self) -> int:
        """Pixels of the level around a pixel that can have a say in its depth: more are not estimated
        around a sub-image."""
        return 0

    @property
    def halo(self) -> int:
        """Pixels that are estimated around a sub-image at least; otherwise it is the halo of the views."""
        return 0

    @property
    def step(self) -> int:
        """Windows begin and end on multiples of so many pixels, also beyond the photograph."""
        return 1

    @property
    def planes(self) -> tuple[Plane, ...]:
        """Of the depth map that are written for the next pass."""
        return ("depth",)

    @property
    def device(self) -> str:
        """For the report."""
        return "cpu"

    @property
    def device_bytes(self) -> int | None:
        """What a device with a memory of its own holds; None: `memory` is of this process."""
        return None

    @property
    def loaded_bytes(self) -> int:
        """What loading it adds to the process for good: libraries, weights."""
        return 0

    @property
    def reads_ahead(self) -> bool:
        """Whether `prepare` is called for the next window while one is estimated, by another thread."""
        return False

    @property
    def confidence(self) -> npt.NDArray[np.float64]:
        """Log-odds of a right depth, of the last pass: as `filtering.CONFIDENCE`."""
        return CONFIDENCE

    @property
    def cpu_us(self) -> tuple[float, float]:
        """CPU microseconds for a pixel, and for each of its sources: for the plan."""
        return 3.5, 1.3

    @property
    def name(self) -> str:
        """Of its files."""
        return f"level{self.level}.{self.kind}"

    @property
    def title(self) -> str:
        return f"stereo, 1/{1 << self.level}, {self.kind}" if self.level else f"stereo, {self.kind}"

    @property
    def is_last(self) -> bool:
        return self.level == 0 and self.kind == "geometric"

    @abstractmethod
    def memory(self, reference_pixels: int, source_pixels: int) -> int:
        """Bytes at the peak of `estimate`, on its device, with what it is given, beside `loaded_bytes`: for
        pixels of the reference window, and of all source windows together."""

    @abstractmethod
    def estimate(
        self, reference: View, sources: Sequence[View], depth_range: DepthRange, prior: Prior
    ) -> DepthMap:
        """The depths of the reference's window.

        Args:
            sources: the best first; where they are allowed is said by the range. None where no source
                can see anything of the window.

        Raises:
            OutOfDeviceMemory: it is called again with two halves of the window.
        """

    def prepare(self, reference: View, sources: Sequence[View]) -> None:
        """Reads what `estimate` will need."""
        return


@dataclass(frozen=True)
class Setup:
    """What a function of the group `sirpy.stereo` is given.

    Attributes:
        coarsest: the finest level at which whole photographs are worked on.
        options: of the run.
        scratch: folder for files that are kept while stereo runs; None where only a plan is made.
        top: the coarsest level at which a photograph still shows something; no more than `coarsest` if 0.
    """

    coarsest: int
    options: StereoOptions
    scratch: Path | None
    top: int = 0


def backend_names() -> list[str]:
    """Of all installed packages."""
    return sorted({entry.name for entry in entry_points(group=GROUP)})


def make_backends(setup: Setup) -> list[StereoBackend]:
    """The passes of the backend that the options name.

    Raises:
        InputError: there is none of this name, or what it needs is not installed.
    """
    name = setup.options.backend
    found = [entry for entry in entry_points(group=GROUP) if entry.name == name]
    if not found:
        raise InputError(
            f"there is no stereo backend {name}: choose {', '.join(backend_names())}, or install the "
            "package that has it"
        )
    try:
        made = found[0].load()(setup)
    except SirpyError:
        raise
    except ModuleNotFoundError as error:
        what = "pip install 'sirpy[learned]'" if error.name == "torch" else f"install {error.name}"
        raise InputError(f"the stereo backend {name} needs {error.name}: {what}") from error
    except (ImportError, OSError, AttributeError) as error:
        raise InputError(
            f"the stereo backend {name} cannot be loaded ({error}): install its package anew"
        ) from error
    passes = list(made) if isinstance(made, Sequence) else [made]
    _check_passes(name, passes)
    return passes


def _check_passes(backend: str, passes: list[StereoBackend]) -> None:
    names = [one.name for one in passes]
    if not passes or len(set(names)) < len(names):
        what = (
            f"passes {', '.join(names)}: each must have a name of its own" if passes else "nothing"
        )
    elif passes[-1].level != 0 or not all(0 <= one.level <= MOST_LEVEL for one in passes):
        what = f"passes at levels {[one.level for one in passes]}: the last must be at level 0"
    else:
        return
    raise InputError(f"the stereo backend {backend} is made of {what}; mend its package")


def backend_identity(name: str) -> str:
    """What changes with another version of a backend's package."""
    (*_, entry) = [entry for entry in entry_points(group=GROUP) if entry.name == name]
    return f"{entry.value} {entry.dist.version if entry.dist else ''}"


def check_backend(options: StereoOptions) -> None:
    """Raises InputError where `make_backends` would, before anything is done."""
    make_backends(Setup(LEAST_COARSEST, options, None))


def torch_device(name: str) -> torch.device:
    """The device of a network, by `StereoOptions.device`.

    Raises:
        InputError: it is a GPU, and torch sees none.
    """
    import torch

    available = torch.cuda.is_available()
    if name == "cuda" and not available:
        raise InputError(
            "--device cuda: torch sees no GPU here; install a build of torch for it, or leave the "
            "option away"
        )
    return torch.device("cuda" if available and name != "cpu" else "cpu")


def torch_device_bytes(device: torch.device) -> int | None:
    """The memory of a GPU; None of the processor."""
    import torch

    if device.type == "cpu":
        return None
    return int(torch.cuda.get_device_properties(device).total_memory)
