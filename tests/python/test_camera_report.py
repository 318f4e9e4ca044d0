"""Residuals of refined cameras in the report: arrows where they point, and what each photograph has."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sirpy.camera_report import camera_section, plot, read_residuals
from sirpy.errors import InputError
from sirpy.workspace import Workspace

COLUMNS, ROWS, WIDTH, HEIGHT = 16, 12, 1920, 1440


def radial(largest: float) -> np.ndarray:
    """(ROWS, COLUMNS, 2), px: what a third-order error of the lens leaves; most in the corners."""
    x, y = np.meshgrid((np.arange(COLUMNS) + 0.5) / 8 - 1, (np.arange(ROWS) + 0.5) / 8 - 0.75)
    out = np.stack([x, y], axis=2)
    error = out * (x**2 + y**2)[..., None]
    return largest * error / np.linalg.norm(error, axis=2).max()


def refinement(*, cameras: int = 1, photographs: int = 3) -> dict[str, Any]:
    """A lens whose radial error went; the top left of its frame has no observations, one cell has two."""
    random = np.random.default_rng(0)
    count = random.integers(20, 90, (ROWS, COLUMNS))
    count[:3, :4] = 0
    count[5, 5] = 2
    noise = random.normal(0, 0.05, (ROWS, COLUMNS, 2)) / np.sqrt(np.maximum(count, 1))[..., None]
    noise[5, 5] = [3.0, 0.0]
    before, after = radial(0.6) + noise, radial(0.02) + noise
    before[count == 0] = after[count == 0] = 0
    return {
        "version": 1,
        "points": 1234,
        "observations": int(count.sum()),
        "rms_before": 0.612,
        "rms_after": 0.098,
        "images": [
            {
                "name": f"<{i}>.jpg",
                "camera_id": 1 + i % cameras,
                "observations": 4000 + i,
                "rejected": 17,
                "rms_before": 0.6,
                "rms_after": 0.1,
            }
            for i in range(photographs)
        ],
        "cameras": [
            {
                "camera_id": i + 1,
                "model": "OPENCV",
                "width": WIDTH,
                "height": HEIGHT,
                "columns": COLUMNS,
                "rows": ROWS,
                "count": (count * (i + 1)).ravel().tolist(),
                "mean_residual": after.reshape(-1, 2).tolist(),
                "mean_residual_before": before.reshape(-1, 2).tolist(),
            }
            for i in range(cameras)
        ],
    }


def workspace_with(folder: Path, value: object) -> Workspace:
    workspace = Workspace(folder)
    workspace.refinement.parent.mkdir(parents=True)
    workspace.refinement.write_text(json.dumps(value), encoding="utf-8")
    return workspace


def drawn(svg: str, colour: str) -> np.ndarray:
    """(n, 2, 2): the beginnings and the tips of the arrows of a colour."""
    paths = re.findall(rf'<path d="([^"]*)"[^>]*stroke="{colour}"[^>]*stroke-width="1.2"', svg)
    shafts = re.findall(r"M(-?[\d.]+),(-?[\d.]+)L(-?[\d.]+),(-?[\d.]+)(?=M)", "".join(paths))
    return np.array(shafts, float).reshape(-1, 2, 2)


def dots(svg: str, colour: str) -> np.ndarray:
    """(n, 2), of a colour."""
    paths = re.findall(rf'<path d="([^"]*)" stroke="{colour}" stroke-width="2.6"', svg)
    return np.array(re.findall(r"M([\d.]+),([\d.]+)h0", "".join(paths)), float)


def scale(svg: str) -> float:
    """Units of the plot in a pixel, as its legend says."""
    (begin, tip) = drawn(svg, "#1d2530")[0]
    pixels = re.search(r">([\d.e-]+) px</text>", svg)
    assert pixels is not None
    return float((tip - begin)[0]) / float(pixels[1])


def test_arrows_are_the_residuals_at_the_scale_of_the_legend(tmp_path: Path) -> None:
    found = read_residuals(workspace_with(tmp_path, refinement()))
    assert found is not None
    (lens,) = found.lenses
    svg = plot(lens, lens.before)
    sure = lens.count >= 10
    arrows = drawn(svg, "#2f6fb5")
    middles = (np.argwhere(sure)[:, ::-1] + 0.5) * 30  # 480 units are 16 columns
    np.testing.assert_allclose(arrows[:, 0], middles, atol=0.051)
    vectors = (arrows[:, 1] - arrows[:, 0]) / scale(svg)
    np.testing.assert_allclose(vectors, lens.before[sure], atol=0.02 * 0.6)
    # The longest of them stays in its cell; two observations do not set the scale.
    assert np.linalg.norm(arrows[:, 1] - arrows[:, 0], axis=1).max() == pytest.approx(28.5, abs=0.2)
    assert len(dots(svg, "#b9c6d4")) == 1


def test_the_frame_has_the_form_of_the_photograph_and_empty_cells_stay_empty(
    tmp_path: Path,
) -> None:
    found = read_residuals(workspace_with(tmp_path, refinement()))
    assert found is not None
    (lens,) = found.lenses
    svg = plot(lens, lens.after)
    assert re.search(r'<rect [^>]*width="480" height="360.0"', svg)
    begins = np.concatenate([dots(svg, colour) for colour in ("#2f6fb5", "#b9c6d4")])
    assert len(begins) == ROWS * COLUMNS - 12
    assert not ((begins[:, 0] < 120) & (begins[:, 1] < 90)).any()


@pytest.mark.parametrize("count", [0, 5])
def test_no_observations_or_no_residuals_draw_no_arrow_of_any_length(
    tmp_path: Path, count: int
) -> None:
    value = refinement()
    camera = value["cameras"][0]
    camera["count"] = [count] * (ROWS * COLUMNS)
    camera["mean_residual"] = camera["mean_residual_before"] = [[0, 0]] * (ROWS * COLUMNS)
    page = camera_section(workspace_with(tmp_path, value))
    assert "no residuals" in page
    assert "nan" not in page


def test_the_section_says_what_each_photograph_has(tmp_path: Path) -> None:
    page = camera_section(workspace_with(tmp_path, refinement()))
    assert "1,234 tie points" in page
    assert "0.612" in page
    row = re.search(r"<tr><td>&lt;1&gt;\.jpg</td>(.*?)</tr>", page)
    assert row is not None
    assert re.findall(r">([^<]+)</td>", row[1]) == ["4,001", "17", "0.600", "0.100"]
    before, after = (float(one) for one in re.findall(r"rms of the means ([\d.]+) px", page))
    assert before > 4 * after > 0


def test_many_photographs_are_folded_and_of_many_cameras_the_best_seen_shown(
    tmp_path: Path,
) -> None:
    page = camera_section(workspace_with(tmp_path, refinement(cameras=9, photographs=31)))
    assert "All 31 photographs" in page
    assert "Of 9 cameras, those with most observations." in page
    assert re.findall(r"Camera (\d+), OPENCV, 1920 × 1440", page) == list("456789")


def test_without_refinement_there_is_no_section(tmp_path: Path) -> None:
    assert camera_section(Workspace(tmp_path)) == ""


def test_cameras_that_were_kept_are_said_to_be(tmp_path: Path) -> None:
    said = "The features contradict the cameras (1 < 2 px): the decimated cameras are kept."
    value = {**refinement(), "kept": said[0].lower() + said[1:-1]}
    page = camera_section(workspace_with(tmp_path / "kept", value))
    assert f"<p>{said.replace('<', '&lt;')}</p>" in page
    assert "kept" not in camera_section(workspace_with(tmp_path / "refined", refinement()))


@pytest.mark.parametrize(
    ("key", "value"), [("version", 2), ("cameras", [{}]), ("images", None), ("points", "many")]
)
def test_a_damaged_file_is_named(tmp_path: Path, key: str, value: object) -> None:
    with pytest.raises(InputError, match=r"refinement\.json is damaged"):
        camera_section(workspace_with(tmp_path, {**refinement(), key: value}))


def test_a_grid_of_another_size_is_damaged(tmp_path: Path) -> None:
    value = refinement()
    value["cameras"][0]["rows"] = 5
    with pytest.raises(InputError, match=r"refinement\.json is damaged"):
        camera_section(workspace_with(tmp_path, value))
