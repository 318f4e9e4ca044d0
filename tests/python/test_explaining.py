"""The picture of a small workspace whose maps are made up, so that every colour in it is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from sirpy import explaining
from sirpy.cli import app
from sirpy.errors import InputError
from sirpy.explaining import NOT_CUT_COLOUR, explain
from sirpy.filtering import Reason
from sirpy.native_images import NativeImage, SubImage
from sirpy.pictures import MISSING_COLOUR, REASON_COLOURS, Text, encoded_png, rgb, with_texts
from sirpy.rectangle import Grid, Rectangle
from sirpy.windows import write_map
from sirpy.workspace import Workspace
from typer.testing import CliRunner

SIZE = (240, 160)
OVERLAP = 8
LEFT, TOP = 15, 15 + 26  # of the first panel

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")


@dataclass
class Scene:
    workspace: Workspace
    pixels: np.ndarray  # (160, 240, 3)
    reason: np.ndarray


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    """One photograph, cut 2x2 with overlap: a facing plane, a column each of two reasons."""
    workspace = Workspace(tmp_path / "out")
    whole = Rectangle(0, 0, *SIZE)
    pixels = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    pixels[..., 0], pixels[..., 1] = np.arange(SIZE[0]), np.arange(SIZE[1])[:, None]
    reason = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    reason[:, 60:84] = Reason.SPECKLE  # a tenth
    reason[:, 84:96] = Reason.HIGH_COST | Reason.INCONSISTENT  # a twentieth
    subs = []
    for row, column, core in Grid(2, 2).cores(*SIZE):
        stored = core.padded(OVERLAP).intersection(whole)
        sub = SubImage(f"a_r{row}_c{column}.png", row, column, core, stored)
        workspace.image(sub).parent.mkdir(parents=True, exist_ok=True)
        part = stored.slices_in(whole)
        workspace.image(sub).write_bytes(encoded_png(pixels[part]))
        kept = (reason[part] == 0).astype(np.float32)
        write_map(workspace.depth_map(sub, "geometric"), kept * 10)
        write_map(
            workspace.normal_map(sub, "geometric"), kept * np.array([0, 0, -1], "f4")[:, None, None]
        )
        write_map(workspace.confidence_map(sub), kept * np.float32(0.9))
        write_map(workspace.sigma_map(sub), kept * np.float32(0.1))
        write_map(workspace.level_map(sub), kept * 0)
        write_map(workspace.reason_map(sub), reason[part].astype(np.float32))
        subs.append(sub)
    workspace.write_index([NativeImage("a.png", *SIZE, tuple(subs))], [])
    return Scene(workspace, pixels, reason)


@pytest.fixture
def words(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is written into pictures."""
    written: list[str] = []

    def recorded(image: np.ndarray, texts: list[Text], colour: tuple[int, int, int]) -> np.ndarray:
        written.extend(text.words for text in texts)
        return with_texts(image, texts, colour)

    monkeypatch.setattr(explaining, "with_texts", recorded)
    return written


def read(path: Path) -> np.ndarray:
    with rasterio.open(path) as file:
        return np.moveaxis(file.read(), 0, -1)


def panels(picture: np.ndarray, height: int, width: int, times: int) -> list[np.ndarray]:
    """The five panels, at the scale of the maps."""
    found = []
    across = (picture.shape[1] - LEFT) // 3
    down = (picture.shape[0] - 15) // 2
    for index in range(5):
        y, x = TOP + index // 3 * down, LEFT + index % 3 * across
        found.append(picture[y : y + height * times : times, x : x + width * times : times])
    return found


def test_a_whole_photograph_is_put_together_from_its_sub_images(scene: Scene) -> None:
    path = explain(scene.workspace, "a.png")
    assert path == scene.workspace.explanation("a.png")
    picture = read(path)
    assert picture.shape[1] <= 2400
    photograph, depth, normals, confidence, reasons = panels(picture, 160, 240, 3)
    np.testing.assert_array_equal(photograph, scene.pixels)
    missing = scene.reason != 0
    for panel in (depth, normals, confidence):
        assert (panel[missing] == MISSING_COLOUR).all()
        assert len(np.unique(panel[~missing], axis=0)) == 1
    assert abs(normals[0, 0].astype(int) - [127, 127, 255]).max() <= 1
    colour = {reason: rgb(colour) for reason, colour in zip(Reason, REASON_COLOURS, strict=True)}
    assert (reasons[:, 60:84] == colour[Reason.SPECKLE]).all()
    assert (reasons[:, 84:96] == colour[Reason.HIGH_COST]).all()
    assert len(np.unique(reasons[~missing], axis=0)) == 1


def test_the_legend_names_each_reason_and_its_share(scene: Scene, words: list[str]) -> None:
    explain(scene.workspace, "a.png")
    assert {"a.png", "with depth 85.0%", "speckle 10.0%", "high cost 5.0%"} <= set(words)
    assert "inconsistent 0.0%" in words  # counted under the first reason


def test_what_is_not_cut_has_a_colour_and_words_of_its_own(scene: Scene, words: list[str]) -> None:
    native = scene.workspace.natives[0]
    scene.workspace.write_index([replace(native, sub_images=native.sub_images[:3])], [])
    *_, reasons = panels(read(explain(scene.workspace, "a.png")), 160, 240, 3)
    left_out = np.zeros((160, 240), bool)
    left_out[80:, 120:] = True
    np.testing.assert_array_equal((reasons == NOT_CUT_COLOUR).all(axis=-1), left_out)
    # Shares are of what was cut: 36 columns of 160 rows have no depth.
    assert {"not cut (25.0% of the photograph)", "with depth 80.0%"} <= set(words)


def test_a_sub_image_is_shown_with_all_that_it_stores(scene: Scene, tmp_path: Path) -> None:
    output = tmp_path / "elsewhere" / "b.png"
    done = CliRunner().invoke(
        app,
        ["stereo", str(scene.workspace.folder), "--explain", "a_r0_c1.png", "-o", str(output)],
    )
    assert done.output == f"picture: {output}\n"
    photograph, *_ = panels(read(output), 88, 128, 6)
    np.testing.assert_array_equal(photograph, scene.pixels[:88, 112:])


def test_a_sub_image_without_any_depth(scene: Scene) -> None:
    _, sub = next(iter(scene.workspace.sub_images()))
    shape = (sub.stored.height, sub.stored.width)
    write_map(scene.workspace.depth_map(sub, "geometric"), np.zeros(shape, np.float32))
    write_map(scene.workspace.reason_map(sub), np.full(shape, 8, np.float32))
    *_, depth, _, _, reasons = panels(read(explain(scene.workspace, sub.name)), *shape, 6)
    assert (depth == MISSING_COLOUR).all()
    assert (reasons == rgb(REASON_COLOURS[3])).all()


def test_mistakes_are_said_in_a_sentence(scene: Scene) -> None:
    with pytest.raises(
        InputError, match=r"no image b: give one of a_r0_c0\.png, .* \.\.\., or one of"
    ):
        explain(scene.workspace, "b")
    with pytest.raises(InputError, match="the picture is a PNG"):
        explain(scene.workspace, "a.png", Path("a.jpg"))
    sub = scene.workspace.natives[0].sub_images[3]
    scene.workspace.confidence_map(sub).unlink()
    explain(scene.workspace, "a_r0_c0.png")
    for name in (sub.name, "a.png"):
        with pytest.raises(InputError, match=f"{name} is not estimated yet .*: run `sirpy stereo"):
            explain(scene.workspace, name)
    with pytest.raises(InputError, match=r"has no image without a name: give one of a_r0_c0\.png"):
        explain(scene.workspace, "")
    for options, sentence in [
        (["-o", "maps"], "--output belongs to --explain"),
        (["--explain", "a.png", "--max-cost", "0.8"], "--max-cost belongs to the estimate, and"),
        (["--explain", "a.png", "--threads", "2"], "--threads belongs to the estimate, and"),
        (["--explain", ""], "has no image without a name"),
    ]:
        done = CliRunner().invoke(app, ["stereo", str(scene.workspace.folder), *options])
        assert isinstance(done.exception, InputError) and sentence in str(done.exception)


def test_text_is_shortened_to_fit() -> None:
    paper = np.full((30, 400, 3), 255, np.uint8)
    long = Text(2, 2, "a very long name of a photograph " * 4, 18, 150)
    inked = np.flatnonzero((with_texts(paper, [long], (0, 0, 0)) < 128).any(axis=(0, 2)))
    assert 100 < inked.max() <= 152
    right = Text(390, 2, "99.9 %", 18, 150, anchor=1)
    inked = np.flatnonzero((with_texts(paper, [right], (0, 0, 0)) < 128).any(axis=(0, 2)))
    assert 300 < inked.min() < inked.max() <= 390
