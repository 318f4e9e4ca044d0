"""The plan: amounts of memory, and the coarsest grid that fits."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from scenes import plane_scene
from sirpy.area import Area
from sirpy.errors import BudgetError, InputError
from sirpy.layout import Layout, Region
from sirpy.memory import parse_memory
from sirpy.plan_table import print_plan
from sirpy.planning import _coarsest, grid_for_memory, plan
from sirpy.rectangle import Grid, Rectangle
from sirpy.sub_image_sets import of_one_size


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("8GB", 8_000_000_000),
        ("500MB", 500_000_000),
        ("1.5 GB", 1_500_000_000),
        ("2GiB", 2 * 1024**3),
        ("4g", 4_000_000_000),
        ("8000000000", 8_000_000_000),
    ],
)
def test_parse_memory(text: str, expected: int) -> None:
    assert parse_memory(text) == expected


@pytest.mark.parametrize("text", ["", "lots", "-1GB", "8XB", "GB"])
def test_parse_memory_refuses(text: str) -> None:
    with pytest.raises(InputError, match="is not an amount of memory"):
        parse_memory(text)


def test_less_memory_takes_a_finer_grid_with_a_lower_peak() -> None:
    scene = plane_scene(count=5, width=4000, height=3000)
    whole = plan(scene, memory=None)
    assert whole.grid == Grid(1, 1)
    half = plan(scene, memory=whole.peak // 2)
    assert half.grid.columns * half.grid.rows > 1
    assert half.peak <= whole.peak // 2


def test_a_budget_that_cannot_be_met_says_the_least_that_would_do() -> None:
    scene = plane_scene(count=5, width=4000, height=3000)
    with pytest.raises(BudgetError, match="least that would do is") as caught:
        plan(scene, memory=100_000_000)
    least = parse_memory(str(caught.value).split("would do is ")[1].split(",")[0])
    assert plan(scene, memory=least).peak <= least


def test_a_given_grid_is_kept_or_refused() -> None:
    scene = plane_scene(count=5, width=4000, height=3000)
    assert plan(scene, memory=None, grid=Grid(3, 2)).grid == Grid(3, 2)
    with pytest.raises(BudgetError, match="grid of 1x1 sub-images needs"):
        plan(scene, memory=600_000_000, grid=Grid(1, 1))


def test_a_plan_counts_what_is_cut() -> None:
    scene = plane_scene(count=5, width=4000, height=3000)
    whole = plan(scene, memory=None, grid=Grid(4, 3))
    assert (whole.photographs, whole.sub_images, whole.largest) == (5, 60, (1000, 1000))
    assert whole.megapixels == pytest.approx(60)
    with_overlap = plan(scene, memory=None, grid=Grid(4, 3), overlap=50)
    assert with_overlap.largest == (1100, 1100)
    assert with_overlap.predicted_peak["stereo"] > whole.predicted_peak["stereo"]
    half = Region(roi=Rectangle(0, 0, 2000, 3000))
    of_half = plan(scene, memory=None, grid=Grid(2, 3), region=half)
    assert (of_half.sub_images, of_half.megapixels) == (30, 30)
    assert of_half.source_megapixels[1] < whole.source_megapixels[1]
    cuts = plan(scene, memory=None, grid=Grid.with_cuts((100,)), region=half)
    assert (cuts.sub_images, cuts.largest) == (10, (1900, 3000))


def test_a_plan_of_an_area_has_the_photographs_that_see_it() -> None:
    # The cameras stand 20 apart and see 100 x 75; the area lies before the last two of them.
    scene = plane_scene(count=5, width=4000, height=3000)
    ring = np.array([[65, 0], [66, 0], [66, 1], [65, 1], [65, 0]], float)
    found = plan(scene, memory=None, grid=Grid(4, 3), region=Region(area=Area(((ring,),))))
    assert found.photographs == 2
    assert found.sub_images <= 4
    with pytest.raises(InputError, match="no photograph of the model sees the area"):
        plan(scene, memory=None, region=Region(area=Area(((ring + 500,),))))


def test_photographs_that_are_held_whole_count_in_the_peak_of_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = plane_scene(count=3, width=4000, height=3000)
    rows = plan(scene, memory=None, grid=Grid(2, 2))

    @dataclass
    class Held:
        width: int = 4000
        height: int = 3000
        held_bytes: int = 300_000_000

    def opened(path: Path) -> Held:
        if path.name == "001.jpg":
            raise InputError(f"{path.name} is damaged")
        return Held()

    monkeypatch.setattr("sirpy.planning.open_photograph", opened)
    held = plan(scene, memory=None, grid=Grid(2, 2), images=tmp_path)
    more = held.predicted_peak["cut"] - rows.predicted_peak["cut"]
    assert more == pytest.approx(1.1 * 300e6, rel=1e-6)
    assert "1 photographs would be left out" in held.notes[0]
    assert "2 photographs cannot be read row by row" in held.notes[1]


def test_the_table_says_what_the_plan_says() -> None:
    found = plan(plane_scene(count=3, width=4000, height=3000), memory=None, grid=Grid(4, 3))
    text = io.StringIO()
    print_plan(found, 8_000_000_000, Console(file=text, width=120))
    words = " ".join(text.getvalue().split())
    assert "4x3 sub-images of each photograph" in words
    assert "36 of at most 1000 x 1000 pixels" in words
    for stage in ("cut", "views", "stereo", "fuse", "report"):
        assert f"│ {stage} │" in words
    assert "of 8.00 GB" in words


@given(
    st.integers(300, 20_000),
    st.integers(300, 20_000),
    st.floats(1e8, 1e11),
    st.integers(0, 120),
    st.sampled_from([0, 1, 32]),
)
def test_grid_for_memory_fits_what_is_stored(
    width: int, height: int, memory: float, overlap: int, multiple: int
) -> None:
    found = grid_for_memory([(width, height)], int(memory), overlap=overlap, multiple=multiple)
    natives = [Layout(found, overlap).native_image("a.jpg", (width, height))]
    if multiple:
        natives = of_one_size(natives, multiple)
    assert 200 * max(sub.stored.area for sub in natives[0].sub_images) <= memory


def test_grid_for_memory_says_the_least_that_would_do() -> None:
    # 2 columns of 256 pixels and an overlap on one side, of 300 rows.
    with pytest.raises(BudgetError, match=r"the least that would do is 0\.02 GB"):
        grid_for_memory([(512, 300)], 10_000_000, overlap=20)
    assert grid_for_memory([(512, 300)], 200 * 276 * 300, overlap=20) == Grid(2, 1)
    with pytest.raises(BudgetError):
        grid_for_memory([(512, 300)], 200 * 276 * 300 - 1, overlap=20)


def test_small_regions_bound_the_grid() -> None:
    scene = plane_scene(count=6, width=9000, height=7000)
    with pytest.raises(BudgetError, match="the least that would do is"):
        plan(scene, memory=300_000_000)
    name = next(iter(scene.cameras))
    free = plan(scene, memory=1_000_000_000).grid
    assert free.columns > 2
    # One region of 2 x 3 pixels: no grid has more columns or rows.
    region = Region(rois={name: Rectangle(0, 0, 2, 3)})
    with pytest.raises(BudgetError):
        plan(scene, memory=1_000_000_000, region=region)
    with pytest.raises(InputError, match=f"{name}: a grid of 3x3"):
        plan(scene, memory=None, region=region, grid=Grid(3, 3))


def test_the_coarsest_grid_is_found_by_bisection() -> None:
    grids = [Grid(i, i) for i in range(1, 40)]
    for columns in (1, 2, 17, 38, 39):
        asked: list[int] = []

        def peak(grid: Grid, asked: list[int] = asked) -> int:
            asked.append(grid.columns)
            return 1000 // grid.columns

        found = grids[_coarsest(grids, peak, 1000 // columns)[0]].columns
        assert 1000 // found <= 1000 // columns
        assert found == 1 or 1000 // (found - 1) > 1000 // columns
        assert len(asked) <= 8
    assert _coarsest(grids, lambda grid: 1000 // grid.columns, 20) == (39, 25)


def test_a_plan_that_looks_at_some_photographs_fits_for_all() -> None:
    scene = plane_scene(count=45, width=4000, height=3000, spacing=8.0)
    peak = plan(scene, memory=None, grid=Grid(1, 1)).peak
    assert plan(scene, memory=peak).grid == Grid(1, 1)
    finer = plan(scene, memory=peak - 1)
    assert finer.peak < peak and finer.grid == Grid(2, 2)
