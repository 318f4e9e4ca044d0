"""What a backend is given and what becomes of what it gives, on cases solved by hand."""

from __future__ import annotations

import sys
import threading
import weakref
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine_scenes import Notes, cut_town
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scenes import plane_scene
from scipy.ndimage import maximum_filter, minimum_filter
from sirpy import dense_stereo
from sirpy.cutting import cut
from sirpy.dense_stereo import stereo, stereo_passes
from sirpy.errors import BudgetError, InputError
from sirpy.judging import Judge
from sirpy.layout import Region
from sirpy.patch_match import PatchMatch
from sirpy.rectangle import Grid, Rectangle
from sirpy.stereo_backend import (
    GROUP,
    DepthMap,
    DepthRange,
    OutOfDeviceMemory,
    Prior,
    Setup,
    StereoBackend,
    StereoOptions,
    View,
    backend_names,
    check_depth_map,
    make_backends,
)
from sirpy.stereo_passes import at_level, read_pixels
from sirpy.view_fields import FieldSource, ViewField
from sirpy.view_selection import views
from sirpy.windows import read_map, read_window
from sirpy.workspace import Pass, Workspace

SIDE = 128


def depth_range(
    near: NDArray[np.float64], far: NDArray[np.float64], allowed: NDArray[np.uint32] | None = None
) -> DepthRange:
    """Of inverse depths of blocks."""
    min_depth, max_depth = ((1 / one).astype(np.float32) for one in (near, far))
    bits = np.ones(near.shape, np.uint32) if allowed is None else allowed
    field = ViewField("a.jpg", SIDE, (FieldSource("b.jpg", 0),), bits, min_depth, max_depth)
    height, width = near.shape
    return DepthRange(field, Rectangle(0, 0, width * SIDE, height * SIDE))


class Known(StereoBackend):
    """A last pass whose maps are functions of the native pixel and of those around it.

    Args:
        most_pixels: of a window that its device can hold.
    """

    kind: Pass = "geometric"
    margin: int = 12
    halo: int = 12
    step: int = 16  # no photograph of the town ends on it
    device: str = "a small device"
    reads_ahead: bool = False

    def __init__(self, most_pixels: int = 1 << 40) -> None:
        self.most_pixels = most_pixels
        self.estimated: list[tuple[str, Rectangle]] = []
        self._held: weakref.ref[View] | None = None

    def memory(self, reference_pixels: int, source_pixels: int) -> int:
        return reference_pixels + source_pixels

    def estimate(
        self, reference: View, sources: Sequence[View], depth_range: DepthRange, prior: Prior
    ) -> DepthMap:
        assert self._held is None or self._held() is None, "what did not fit is still held"
        window = reference.window
        assert window == window.aligned(self.step)
        if window.area > self.most_pixels:
            on_device = replace(reference)
            self._held = weakref.ref(on_device)
            raise OutOfDeviceMemory
        self.estimated.append((reference.name, window))
        x, y = np.arange(window.x0, window.x1) + 0.5, np.arange(window.y0, window.y1) + 0.5
        near, _ = depth_range.inverse(x, y)
        around = maximum_filter(reference.grey, 2 * self.margin + 1, mode="nearest")
        depth = 50 + 0.01 * x + 0.02 * y[:, None] + near + around / 1e4
        assert reference.image.shape == (*depth.shape, 3)
        for source in sources:
            assert source.window == source.window.aligned(self.step) and source.grey.any()
        numbers, counts = np.zeros_like(depth, np.float32), np.full(depth.shape, 5, np.uint8)
        return DepthMap(
            depth=depth.astype(np.float32),
            normal=np.stack([numbers, numbers, numbers - 1]),
            cost=numbers,
            texture=numbers + 1000,
            num_seeing=counts,
            num_consistent=counts,
            sigma=numbers + np.float32(0.1),
            motion=numbers + 1,
            level=np.zeros_like(counts),
        )


class Ahead(Known):
    """Reads the next window while one is estimated."""

    reads_ahead: bool = True

    def __init__(self, damaged: bool = False) -> None:
        super().__init__()
        self.damaged = damaged
        self.prepared: list[tuple[str, Rectangle]] = []

    def prepare(self, reference: View, sources: Sequence[View]) -> None:
        if self.damaged:
            raise InputError("a sub-image is damaged")
        assert threading.current_thread() is not threading.main_thread() and sources
        self.prepared.append((reference.name, reference.window))


def offer(folder: Path, monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """An installed package with the backend `other`, made by `make` of this code."""
    (folder / "other_backend.py").write_text(code)
    info = folder / "other-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{GROUP}]\nother = other_backend:make\n")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "other_backend", raising=False)


def setup_of(name: str) -> Setup:
    return Setup(2, StereoOptions(backend=name), None)


# Entry points.


def test_the_built_in_backends_are_listed_with_those_of_other_packages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert {"patch_match", "patchmatchnet"} <= set(backend_names())
    assert "other" not in backend_names()
    offer(tmp_path, monkeypatch, "")
    assert "other" in backend_names()


def test_an_unknown_name_is_answered_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"backend nothing: choose .*patch_match, patchmatchnet"):
        make_backends(setup_of("nothing"))


@pytest.mark.parametrize(
    ("module", "remedy"),
    [("torch", r"pip install 'sirpy\[learned\]'"), ("no_such_thing", "install no_such_thing")],
)
def test_what_a_backend_needs_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, remedy: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)  # as if it were not installed
    for code in (f"import {module}", f"def make(setup):\n    import {module}"):
        (tmp_path / code[:3]).mkdir()
        offer(tmp_path / code[:3], monkeypatch, code)
        with pytest.raises(
            InputError, match=f"^the stereo backend other needs {module}: {remedy}$"
        ):
            make_backends(setup_of("other"))


def test_a_package_gives_one_backend_or_a_list_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    imported = "from sirpy.patch_match import PatchMatch\n"
    offer(tmp_path, monkeypatch, imported + "def make(setup): return PatchMatch(0)\n")
    (one,) = make_backends(setup_of("other"))
    assert one == PatchMatch(0)
    # It does not look at the depths of the sources, so they are judged after it.
    passes = stereo_passes(2, 2, StereoOptions(backend="other"), None)
    assert passes[:1] == [PatchMatch(0)] and isinstance(passes[1], Judge) and passes[1].is_last

    (tmp_path / "list").mkdir()
    both = "def make(setup): return PatchMatch(0), PatchMatch(0, 'geometric')\n"
    offer(tmp_path / "list", monkeypatch, imported + both)
    expected = [PatchMatch(0), PatchMatch(0, "geometric")]
    assert stereo_passes(2, 2, StereoOptions(backend="other"), None) == expected


@pytest.mark.parametrize(
    ("made", "what"),
    [
        ("[]", "made of nothing"),
        ("[PatchMatch(0), PatchMatch(0)]", "each must have a name of its own"),
        ("PatchMatch(1)", "the last must be at level 0"),
        # Levels above the coarsest of the views show whole photographs too; 8 is no part of a block.
        ("[PatchMatch(8), PatchMatch(0)]", "levels \\[8, 0\\]"),
    ],
)
def test_passes_that_cannot_run_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: str, what: str
) -> None:
    imported = "from sirpy.patch_match import PatchMatch\n"
    offer(tmp_path, monkeypatch, f"{imported}def make(setup): return {made}\n")
    with pytest.raises(InputError, match=what):
        make_backends(setup_of("other"))


class OnlyDepth(StereoBackend):
    """As a network is."""

    def memory(self, reference_pixels: int, source_pixels: int) -> int:
        return 0

    def estimate(self, *given: Any) -> DepthMap:
        raise NotImplementedError


@pytest.mark.parametrize(
    ("found", "what"),
    [
        (DepthMap(np.ones((3, 4))), "depth as float64"),  # type: ignore[arg-type]
        (DepthMap(np.ones((4, 3), np.float32)), "depth as float32 \\(4, 3\\)"),
        (DepthMap(np.full((3, 4), np.nan, np.float32)), "no finite numbers"),
        (DepthMap([[1.0]]), "no depth"),  # type: ignore[arg-type]
    ],
)
def test_what_is_no_depth_map_is_refused(found: DepthMap, what: str) -> None:
    window, of_pass = Rectangle(0, 0, 4, 3), PatchMatch(0)
    with pytest.raises(InputError, match=what):
        check_depth_map(found, window, OnlyDepth())
    with pytest.raises(InputError, match="no level"):
        check_depth_map(DepthMap(np.ones((3, 4), np.float32)), window, of_pass)
    known = DepthMap(
        np.ones((3, 4), np.float32),
        sigma=np.ones((3, 4), np.float32),
        level=np.zeros((3, 4), np.uint8),
    )
    with pytest.raises(InputError, match="no normal"):
        check_depth_map(known, window, of_pass)


# What it is given.


def test_depths_are_linear_between_the_corners_of_blocks_and_go_on_beyond() -> None:
    # What is common to the nearest inverse depths of blocks is the least, to the farthest the greatest.
    near, far = np.array([[2.0, 4, 3], [6, 8, 5]]), np.array([[1.0, 1.5, 1], [0.5, 2, 1]])
    limits = depth_range(near, far)
    x, y = SIDE * np.arange(4.0), SIDE * np.arange(3.0)
    found = limits.inverse(x, y)
    np.testing.assert_allclose(found[0], [[2, 2, 3, 3], [2, 2, 3, 3], [6, 6, 5, 5]], rtol=1e-6)
    np.testing.assert_allclose(found[1], [[1, 1.5, 1.5, 1], [1, 2, 2, 1], [0.5, 2, 2, 1]])
    between = limits.inverse(SIDE * np.array([1.25, 1.5]), SIDE * np.array([1.0, 1.5]))[0]
    np.testing.assert_allclose(between, [[2.25, 2.5], [4.0, 4.0]], rtol=1e-6)
    beyond = limits.inverse(np.array([-50.0, 3 * SIDE + 9]), np.array([-3.0, 2 * SIDE + 1]))[0]
    np.testing.assert_allclose(beyond, [[2, 3], [6, 5]], rtol=1e-6)
    single = depth_range(np.array([[2.0]]), np.array([[1.0]]))
    np.testing.assert_allclose(single.inverse(x, y)[1], np.ones((3, 4)))


SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 6))
FIELDS = SHAPES.flatmap(lambda shape: arrays(np.float64, (2, *shape), elements=st.floats(0.01, 10)))


@given(FIELDS, st.data())
def test_depths_hold_what_a_block_needs_and_lie_in_its_range(
    own: NDArray[np.float64], data: st.DataObject
) -> None:
    # A range of the field is the union of a block's own and those of the blocks around it.
    near, far = maximum_filter(own.max(axis=0), 3), minimum_filter(own.min(axis=0), 3)
    height, width = near.shape
    x = data.draw(st.floats(0, width * SIDE - 0.5))
    y = data.draw(st.floats(0, height * SIDE - 0.5))
    found = [float(one[0, 0]) for one in depth_range(near, far).inverse(np.r_[x], np.r_[y])]
    row, column = int(y // SIDE), int(x // SIDE)
    assert own[:, row, column].max() * (1 - 1e-6) <= found[0] <= near[row, column] * (1 + 1e-6)
    assert own[:, row, column].min() * (1 + 1e-6) >= found[1] >= far[row, column] * (1 - 1e-6)


def test_nearest_and_farthest_of_a_window_are_those_of_the_blocks_it_touches() -> None:
    near = np.array([[2.0, 4, 5], [10, 8, 20]])
    limits = replace(depth_range(near, near / 2), window=Rectangle(100, 10, 28, 200))
    assert (limits.minimum, limits.maximum) == (np.float32(0.1), 1)
    limits = replace(limits, window=Rectangle(100, 10, 29, 100))
    assert (limits.minimum, limits.maximum) == (0.25, 1)


def test_sources_are_allowed_block_by_block() -> None:
    bits = np.array([[0b01, 0b10], [1 << 31, 0b11]], np.uint32)
    limits = depth_range(np.ones((2, 2)), np.ones((2, 2)), bits)
    x, y = np.array([-3.0, 127.5, 128.5, 300]), np.array([0.5, 128.5, 400])
    for index, expected in [
        (0, [[1, 1, 0, 0], [0, 0, 1, 1], [0, 0, 1, 1]]),
        (1, [[0, 0, 1, 1], [0, 0, 1, 1], [0, 0, 1, 1]]),
        (31, [[0, 0, 0, 0], [1, 1, 0, 0], [1, 1, 0, 0]]),
    ]:
        np.testing.assert_array_equal(limits.allowed(x, y, index), np.array(expected, bool))


@pytest.mark.parametrize("level", [0, 1, 2])
def test_intrinsics_are_those_of_the_window_with_centres_at_whole_numbers(level: int) -> None:
    camera = plane_scene(count=1, width=800, height=600).cameras["000.jpg"]
    window = Rectangle(30, -8, 60, 50)

    def read(*_: object) -> NDArray[np.uint8]:
        raise AssertionError("nothing is read before it is used")

    view = View(camera, window, level, at_level(Rectangle(0, 0, 800, 600), level), read)
    # The middle of the block of native pixels that pixel (47, 12) of the level is the mean of.
    native = np.array([[47.5, 12.5]]) * 2**level
    point = camera.in_camera(camera.world(native, np.array([80.0])))[0]
    x, y, w = view.intrinsics @ point
    np.testing.assert_allclose([x / w, y / w], [47 - 30, 12 + 8], atol=1e-9)
    np.testing.assert_array_equal(view.intrinsics, camera.window_intrinsics(window, level))
    assert camera.intrinsics[0, 2] == 400  # the camera is left as it was


@pytest.mark.parametrize("level", [0, 1])
def test_beyond_what_is_cut_the_nearest_pixels_go_on(
    town: Path, tmp_path: Path, level: int
) -> None:
    region = Region(roi=Rectangle(10, 6, 121, 90))
    workspace = cut(town / "images", town / "sparse", tmp_path, grid=Grid(2, 2), region=region)
    native = workspace.natives[0]
    grey = read_window(workspace, native.name, native.covered, "grey")
    if level:  # the last column is half inside
        wide = np.pad(grey.astype(float), [(0, 0), (0, 1)], mode="edge")
        blocks = wide.reshape(45, 2, 61, 2).mean(axis=(1, 3))
    else:
        blocks = grey
    inside = at_level(native.covered, level)
    window = Rectangle.from_corners(inside.x0 - 5, inside.y0 - 3, inside.x1 + 7, inside.y1 + 2)
    expected = np.pad(blocks, [(3, 2), (5, 7)], mode="edge")
    found = read_pixels(workspace, native, window, level, "grey")
    assert found.dtype == np.uint8 and found.shape == expected.shape
    last = slice(
        0, 5 + inside.width - level
    )  # what a half column is filled with is not of interest
    assert np.abs(found[:, last] - expected[:, last].astype(float)).max() <= 0.5
    np.testing.assert_array_equal(found[:, -8:], np.repeat(found[:, -8:-7], 8, axis=1))
    color = read_pixels(workspace, native, window, level, "color")
    core = read_pixels(workspace, native, inside, level, "color")
    np.testing.assert_array_equal(color, np.pad(core, [(3, 2), (5, 7), (0, 0)], mode="edge"))


# What becomes of it.


@pytest.fixture(scope="module")
def prepared(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """The town in 3 x 2 sub-images, ready for stereo."""
    workspace = cut_town(town, tmp_path_factory.mktemp("cut"))
    views(workspace, num_sources=2)
    return workspace


def maps_of(
    workspace: Workspace, backend: StereoBackend, monkeypatch: pytest.MonkeyPatch, notes: Notes
) -> list[NDArray[np.float32]]:
    """The depth maps that are made of what a backend finds, of all sub-images."""
    monkeypatch.setattr(dense_stereo, "make_backends", lambda setup: [backend])
    for _, sub in workspace.sub_images():
        for path in workspace.stereo_maps(sub):
            path.unlink(missing_ok=True)
    stereo(workspace, progress=notes)
    return [read_map(workspace.depth_map(sub, "geometric")) for _, sub in workspace.sub_images()]


def test_a_device_that_is_too_small_gets_halves_and_the_maps_are_the_same(
    prepared: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes = Notes()
    expected = maps_of(prepared, Known(), monkeypatch, notes)
    assert not notes.notes and min((depth > 50).mean() for depth in expected) > 0.9
    small = Known(most_pixels=6000)
    for found, depth in zip(maps_of(prepared, small, monkeypatch, notes), expected, strict=True):
        np.testing.assert_array_equal(found, depth)
    assert len(small.estimated) > 2 * len(expected)
    assert any("needs more memory than a small device has" in note for note in notes.notes)


def test_a_device_that_holds_nothing_ends_in_one_sentence(
    prepared: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(BudgetError, match=r"^a small device has too little memory for \d+x\d+ pix"):
        maps_of(prepared, Known(most_pixels=0), monkeypatch, Notes())


def test_the_next_window_is_prepared_while_one_is_estimated(
    prepared: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead = Ahead()
    maps_of(prepared, ahead, monkeypatch, Notes())
    assert len(ahead.estimated) == 36
    assert ahead.prepared == ahead.estimated[1:]
    with pytest.raises(InputError, match="a sub-image is damaged"):
        maps_of(prepared, Ahead(damaged=True), monkeypatch, Notes())
