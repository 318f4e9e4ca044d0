"""View selection: windows hold every match, depth ranges hold the points, sources are ranked."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import plane_scene
from sirpy.native_images import NativeImage, SubImage
from sirpy.rectangle import Grid, Rectangle
from sirpy.view_selection import ALIGNMENT, aligned, source_window, sub_image_views

SCENE = plane_scene(count=7, width=800, height=600)
CAMERAS = list(SCENE.cameras.values())
WHOLE = Rectangle(0, 0, 800, 600)


def _native(name: str) -> NativeImage:
    return NativeImage(name, 800, 600, ())


@settings(max_examples=50)
@given(
    st.integers(0, 700),
    st.integers(0, 500),
    st.integers(8, 100),
    st.floats(60, 99),
    st.floats(100, 160),
    st.integers(0, 6),
    st.integers(0, 6),
    st.randoms(use_true_random=False),
)
def test_a_source_window_holds_every_point_of_the_frustum(
    x0: int, y0: int, size: int, near: float, far: float, ref: int, src: int, random: object
) -> None:
    window = Rectangle(x0, y0, size, size).intersection(WHOLE)
    reference, source = CAMERAS[ref], CAMERAS[src]
    found = source_window(reference, window, (near, far), source)
    rng = np.random.default_rng(random.randrange(2**32))  # type: ignore[attr-defined]
    pixel = rng.uniform([window.x0, window.y0], [window.x1, window.y1], (200, 2))
    seen = source.project(reference.world(pixel, rng.uniform(near, far, 200)))
    inside = ((seen >= 0) & (seen < [800, 600])).all(axis=1)
    low, high = [found.x0, found.y0], [found.x1, found.y1]
    assert ((seen[inside] >= low) & (seen[inside] <= high)).all()


@given(st.integers(-50, 850), st.integers(-50, 650), st.integers(1, 300), st.integers(1, 300))
def test_aligned_windows_hold_the_window_on_the_lattice(x: int, y: int, w: int, h: int) -> None:
    window = Rectangle(x, y, w, h)
    found = aligned(window, WHOLE)
    inside = window.intersection(WHOLE)
    assert found.area == 0 if inside.area == 0 else found.contains(inside)
    if found.area:
        assert found.x0 % ALIGNMENT == 0 and found.y0 % ALIGNMENT == 0
        assert found.x1 % ALIGNMENT == 0 or found.x1 == WHOLE.x1


def test_sources_are_the_neighbours_and_depths_hold_the_points() -> None:
    name = "003.jpg"
    for row, column, core in Grid(3, 2).cores(800, 600):
        sub_image = SubImage("s", row, column, core, core)
        found = sub_image_views(SCENE, _native(name), sub_image, num_sources=4, halo=16)
        names = [source.name for source in found.sources]
        assert name not in names
        # 20 to the side at a height of 100 is 11 degrees: the best; 60 is 31 and comes last.
        assert {"002.jpg", "004.jpg"} <= set(names)
        assert found.min_depth < 98.1 and found.max_depth > 101.9
        assert found.window.contains(core)


def test_a_whole_photograph_has_the_sources_of_all_its_parts() -> None:
    native = _native("003.jpg")

    def sources(core: Rectangle) -> set[str]:
        sub_image = SubImage("s", 0, 0, core, core)
        found = sub_image_views(SCENE, native, sub_image, num_sources=2, halo=0)
        return {source.name for source in found.sources}

    whole = sources(WHOLE)
    parts = [sources(core) for _, _, core in Grid(3, 3).cores(800, 600)]
    assert set.union(*parts) <= whole
    assert len(whole) > 2  # the left part is seen by other cameras than the right one


def test_a_sub_image_without_points_takes_those_around_it() -> None:
    seen = SCENE.observations["003.jpg"]
    keep = seen.pixel[:, 0] > 600
    observations = dict(SCENE.observations)
    observations["003.jpg"] = type(seen)(seen.point[keep], seen.pixel[keep], seen.depth[keep])
    scene = type(SCENE)(SCENE.cameras, SCENE.points, observations)
    core = Rectangle(0, 0, 200, 200)
    found = sub_image_views(
        scene, _native("003.jpg"), SubImage("s", 0, 0, core, core), num_sources=4, halo=16
    )
    assert found.min_depth < 98.1 and found.max_depth > 101.9
    assert found.sources


def test_a_tiny_sub_image_takes_the_points_around_it() -> None:
    core = Rectangle(400, 300, 3, 3)
    sub_image = SubImage("s", 0, 0, core, core)
    found = sub_image_views(SCENE, _native("003.jpg"), sub_image, num_sources=4, halo=0)
    assert found.min_depth < found.max_depth


def test_an_image_without_points_has_no_sources() -> None:
    seen = SCENE.observations["003.jpg"]
    observations = dict(SCENE.observations)
    observations["003.jpg"] = type(seen)(seen.point[:0], seen.pixel[:0], seen.depth[:0])
    scene = type(SCENE)(SCENE.cameras, SCENE.points, observations)
    core = Rectangle(0, 0, 200, 200)
    sub_image = SubImage("s", 0, 0, core, core)
    assert (
        sub_image_views(scene, _native("003.jpg"), sub_image, num_sources=4, halo=16).sources == ()
    )


def test_same_pixels_whatever_the_grid() -> None:
    """The window of a source covers what the windows of a finer grid cover."""
    name = "002.jpg"
    core = Rectangle(0, 0, 800, 600)
    whole = sub_image_views(
        SCENE, _native(name), SubImage("s", 0, 0, core, core), num_sources=6, halo=16
    )
    windows = {source.name: source.window for source in whole.sources}
    for row, column, part in Grid(2, 2).cores(800, 600):
        found = sub_image_views(
            SCENE, _native(name), SubImage("s", row, column, part, part), num_sources=3, halo=16
        )
        for source in found.sources:
            if source.name in windows:
                # Depth ranges differ by what the points around show, a few pixels here.
                assert windows[source.name].padded(16).contains(source.window)
