"""PatchmatchNet on windows: what a pixel is given is a field over the photograph, so a window changes nothing.

The network has random weights here: what it computes does not matter, only that a window computes the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

torch = pytest.importorskip("torch", reason="torch, of the extra `learned`, is not installed")

from sirpy.native_scene import NativeCamera  # noqa: E402
from sirpy.patchmatchnet import PatchmatchNet, windows  # noqa: E402
from sirpy.patchmatchnet.backend import PatchmatchNetBackend  # noqa: E402
from sirpy.patchmatchnet.bands import Bands  # noqa: E402
from sirpy.patchmatchnet.windows import FeatureStore, drawn, estimate  # noqa: E402
from sirpy.rectangle import Rectangle  # noqa: E402
from sirpy.stereo_backend import DepthMap, DepthRange, View  # noqa: E402
from sirpy.view_fields import FieldSource, ViewField  # noqa: E402

SIZE = 500, 345  # no multiples of 8
NAMES = "reference.jpg", "left.jpg", "above.jpg"
BANDS = Bands(torch.device("cpu"), 2)


def random_net() -> PatchmatchNet:
    """Neighbours lie where they are fixed: learned offsets have no bound."""
    torch.manual_seed(1)
    net = PatchmatchNet()
    with torch.no_grad():
        for number in (1, 2, 3):
            for convolution in (net.stage(number).propa_conv, net.stage(number).eval_conv):
                convolution.weight.zero_()
                assert convolution.bias is not None
                convolution.bias.zero_()
    return net


def camera(name: str) -> NativeCamera:
    width, height = SIZE
    intrinsics = np.array([[400.0, 0, width / 2 + 3], [0, 400, height / 2 - 7], [0, 0, 1]])
    pose = np.eye(3, 4)
    pose[:, 3] = {"left.jpg": (0.3, 0, 0), "above.jpg": (0.02, 0.35, 0.01)}.get(name, (0, 0, 0))
    return NativeCamera(name, width, height, intrinsics, pose)


def picture(name: str) -> NDArray[np.uint8]:
    generator = np.random.default_rng(NAMES.index(name))
    coarse = generator.integers(0, 256, (SIZE[1] // 4 + 1, SIZE[0] // 4 + 1, 3), np.uint8)
    return coarse.repeat(4, axis=0).repeat(4, axis=1)[: SIZE[1], : SIZE[0]]


PICTURES = {name: picture(name) for name in NAMES}


def reader(
    name: str, read: list[Rectangle] | None = None
) -> Callable[[Rectangle, Literal["grey", "color"]], NDArray[np.uint8]]:
    def pixels(rectangle: Rectangle, kind: Literal["grey", "color"]) -> NDArray[np.uint8]:
        assert kind == "color"
        if read is not None:
            read.append(rectangle)
        rows = np.clip(np.arange(rectangle.y0, rectangle.y1), 0, SIZE[1] - 1)
        columns = np.clip(np.arange(rectangle.x0, rectangle.x1), 0, SIZE[0] - 1)
        return PICTURES[name][np.ix_(rows, columns)]

    return pixels


def view(name: str, window: Rectangle, index: int = -1) -> View:
    return View(camera(name), window, 0, Rectangle(0, 0, *SIZE), reader(name), index)


def depth_range() -> DepthRange:
    """Blocks of 128 pixels with depths and sources of their own."""
    shape = -(-SIZE[1] // 128), -(-SIZE[0] // 128)
    rows, columns = np.indices(shape)
    allowed = np.where((rows + columns) % 3 == 0, 1, 3).astype(np.uint32)
    near, far = 4 + 0.2 * rows + 0.1 * columns, 9 + 0.3 * columns
    field = ViewField(
        NAMES[0],
        128,
        tuple(FieldSource(name, 0) for name in NAMES[1:]),
        allowed,
        near.astype(np.float32),
        far.astype(np.float32),
    )
    return DepthRange(field, Rectangle(0, 0, *SIZE))


def depths(folder: Path, window: Rectangle, bands: Bands = BANDS) -> DepthMap:
    net = random_net()
    whole = Rectangle(0, 0, *SIZE).aligned(8)
    sources = [view(name, whole, index) for index, name in enumerate(NAMES[1:])]
    store = FeatureStore(net, folder, bands, half=False)
    return estimate(net, store, view(NAMES[0], window), sources, depth_range(), 7, bands)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> DepthMap:
    return depths(tmp_path_factory.mktemp("whole"), Rectangle(0, 0, *SIZE).aligned(8))


@pytest.mark.parametrize("core", [Rectangle(0, 0, 96, 80), Rectangle(448, 264, 52, 81)])
def test_within_the_margin_a_window_changes_nothing(
    tmp_path: Path, whole: DepthMap, core: Rectangle
) -> None:
    image = Rectangle(0, 0, *SIZE).aligned(8)

    def differences(margin: int) -> NDArray[np.floating]:
        window = core.padded(margin).aligned(8).intersection(image)
        found = depths(tmp_path, window)
        assert window.width < SIZE[0] and found.depth.shape == (window.height, window.width)
        inside, expected = found.depth[core.slices_in(window)], whole.depth[core.slices_in(image)]
        return np.abs(inside / expected - 1)

    assert differences(PatchmatchNetBackend.margin).max() < 1e-4
    assert np.percentile(differences(0), 99) > 1e-3  # otherwise this test shows nothing


def test_threads_change_no_byte(tmp_path: Path) -> None:
    window = Rectangle(64, 64, 200, 160)
    one, other = (
        depths(tmp_path / str(n), window, Bands(torch.device("cpu"), n, 1 << 16)) for n in (1, 3)
    )
    np.testing.assert_array_equal(one.depth, other.depth)


def test_features_of_tiles_are_those_of_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(windows, "TILE", 128)
    net = random_net()
    store = FeatureStore(net, tmp_path, BANDS, half=False)
    window = Rectangle(200, 120, 304, 232)  # over tiles, and up to the padded corner
    one = view(NAMES[0], window)
    store.find([one])
    padded = one.read(Rectangle(0, 0, *SIZE).aligned(8), "color")
    with torch.inference_mode():
        expected = net.feature(torch.from_numpy(padded.transpose(2, 0, 1).copy())[None] / 255)
    for stage in (1, 2, 3):
        inside = [slice(a >> stage, b >> stage) for a, b in ((120, 352), (200, 504))]
        part = expected[stage][(slice(None), *inside)].numpy()
        np.testing.assert_allclose(store.read(one, stage).numpy(), part, rtol=1e-3, atol=1e-3)


def test_features_are_found_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(windows, "TILE", 128)
    read: list[Rectangle] = []
    store = FeatureStore(random_net(), tmp_path, BANDS, half=False)
    one = replace(view(NAMES[0], Rectangle(0, 0, 256, 128)), read=reader(NAMES[0], read))
    store.find([one])
    assert read == [Rectangle(0, 0, 312, 184)]  # both tiles at once, with what has a say
    store.find([one, replace(one, window=Rectangle(128, 0, 256, 128))])
    assert read[1:] == [Rectangle(200, 0, 240, 184)]


def test_random_numbers_are_those_of_the_pixel() -> None:
    whole = drawn(Rectangle(0, 0, 40, 30), 5).numpy()
    part = drawn(Rectangle(7, 11, 13, 9), 5).numpy()
    np.testing.assert_array_equal(part, whole[:, 11:20, 7:20])
    assert whole.min() >= 0 and whole.max() < 1
    counts, _ = np.histogram(whole, 10, (0, 1))
    assert np.abs(counts / whole.size - 0.1).max() < 0.005
    neighbours: list[Any] = [(whole[:, :, 1:], whole[:, :, :-1]), (whole[:, 1:], whole[:, :-1])]
    for a, b in [*neighbours, (whole[1:], whole[:-1]), (whole, drawn(Rectangle(0, 0, 40, 30), 6))]:
        assert abs(np.corrcoef(np.ravel(a), np.ravel(b))[0, 1]) < 0.02
