"""The compiled group-wise correlation against the same in torch, which GPUs run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch, of the extra `learned`, is not installed")

from sirpy._core import group_correlation  # noqa: E402
from sirpy.patchmatchnet.sampling import SourceMap, warped  # noqa: E402
from sirpy.patchmatchnet.stage import SETTINGS, PatchMatchStage  # noqa: E402

HEIGHT, WIDTH = 11, 37


def scene(channels: int) -> tuple[Any, SourceMap, Any]:
    """Rows of a reference [C, h, w], a source, and depths [D, h, w] of which some are seen nowhere."""
    random = torch.Generator().manual_seed(channels)

    def maps(*shape: int) -> Any:
        return torch.rand(shape, generator=random) * 2 - 1

    matrix = torch.tensor(
        [[1.01, 0.03, -3, 9], [-0.02, 0.98, 2, -4], [1e-3, 2e-3, 1, -1.5]], dtype=torch.float32
    )
    source = SourceMap(maps(channels, 29, 41), matrix, (41.0, 29.0))
    depth = 1 + 30 * maps(6, HEIGHT, WIDTH).square()
    return maps(channels, HEIGHT, WIDTH), source, depth


@pytest.mark.parametrize(("channels", "groups"), [(64, 8), (32, 8), (16, 4), (64, 4), (48, 12)])
@pytest.mark.parametrize("first_row", [0, 7])
def test_it_equals_torch(channels: int, groups: int, first_row: int) -> None:
    reference, source, depth = scene(channels)
    products = warped(source, depth, first_row) * reference[:, None]
    expected = products.reshape(groups, -1, *depth.shape).mean(dim=1).numpy()
    found = group_correlation(
        reference.permute(1, 2, 0).contiguous().numpy(),
        source.features.permute(1, 2, 0).contiguous().numpy(),
        source.source_from_reference.numpy(),
        depth.numpy(),
        first_row=first_row,
        behind=source.behind,
        groups=groups,
    )
    # Torch's positions go through -1 to 1 and back, which rounds them by some millionths of a pixel.
    np.testing.assert_allclose(found, expected, atol=1e-5)
    outside = (found == 0).all(axis=0)
    assert 0.05 < outside.mean() < 0.8


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda one: f"stage{one.stage}")
def test_a_stage_takes_channels_in_any_order(settings: Any) -> None:
    stage = PatchMatchStage(settings)
    reference, source, depth = scene({3: 64, 2: 32, 1: 16}[settings.stage])
    apart = stage.similarity(reference, source, depth, 3)
    by_pixel = [
        maps.permute(1, 2, 0).contiguous().permute(2, 0, 1) for maps in (reference, source.features)
    ]
    moved = SourceMap(by_pixel[1], source.source_from_reference, source.behind)
    assert torch.equal(stage.similarity(by_pixel[0], moved, depth, 3), apart)
    # A band of rows is that of the whole.
    rows = slice(4, 9)
    band = stage.similarity(reference[:, rows], source, depth[:, rows].contiguous(), 7)
    assert torch.equal(band, apart[:, :, rows])


def test_it_refuses_arrays_that_do_not_fit() -> None:
    good: dict[str, Any] = {
        "reference": np.zeros((3, 5, 16), np.float32),
        "source": np.zeros((4, 4, 16), np.float32),
        "source_from_reference": np.eye(3, 4, dtype=np.float32),
        "depth": np.ones((2, 3, 5), np.float32),
        "first_row": 0,
        "behind": (4.0, 4.0),
        "groups": 4,
    }
    assert group_correlation(**good).shape == (4, 2, 3, 5)
    for name, bad, error in (
        ("depth", np.ones((2, 5, 3), np.float32), ValueError),
        ("depth", np.ones((3, 5), np.float32), ValueError),
        ("depth", np.ones((2, 3, 5)), TypeError),
        ("source", np.zeros((4, 4, 32), np.float32), ValueError),
        ("source", np.zeros((16, 4, 4), np.float32).T, TypeError),
        ("reference", np.zeros((15, 16), np.float32), ValueError),
        ("source_from_reference", np.eye(3, dtype=np.float32), TypeError),
        ("groups", 3, ValueError),
        ("groups", 0, ValueError),
    ):
        with pytest.raises(error):
            group_correlation(**{**good, name: bad})
