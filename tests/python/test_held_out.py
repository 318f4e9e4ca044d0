"""Models without the photographs that a cloud is judged by."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from sirpy.errors import InputError
from sirpy.held_out import hold_out
from sirpy.model_arrays import PosedImage, SparseModel, read_arrays, write_model


def small_model(seen: list[list[int]]) -> SparseModel:
    """Image i has the name i.jpg and sees the points `seen[i]`, of which number p has x = p."""
    camera = pycolmap.Camera(
        camera_id=1, model="PINHOLE", width=100, height=80, params=[90, 90, 50, 40]
    )
    count = 1 + max(max(one) for one in seen if one)
    point = np.array([p for one in seen for p in one], np.int32)
    return SparseModel(
        {1: camera},
        tuple(PosedImage(i + 1, 1, f"{i}.jpg", (1.0, 0, 0, 0, 0, 0, 0)) for i in range(len(seen))),
        np.arange(1, count + 1, dtype=np.uint64),
        np.column_stack([np.arange(count), np.zeros(count), np.ones(count)]).astype(np.float64),
        np.zeros((count, 3), np.uint8),
        np.zeros(count),
        np.cumsum([0, *map(len, seen)], dtype=np.int64),
        np.column_stack([point, np.zeros(len(point))]).astype(np.float64),
        point,
    )


def test_points_seen_once_go_with_the_photograph(tmp_path: Path) -> None:
    model = small_model([[0, 1, 2], [0, 1], [1, 2, 3], [1, 3]])
    write_model(model, tmp_path / "whole")
    assert hold_out(tmp_path / "whole", tmp_path / "kept", names=["1.jpg"]) == ["1.jpg"]
    kept = read_arrays(tmp_path / "kept")
    assert [image.name for image in kept.images] == ["0.jpg", "2.jpg", "3.jpg"]
    assert kept.points[:, 0].tolist() == [1, 2, 3]  # 0 is seen by 0.jpg alone
    seen = [kept.points[kept.point[kept.seen(i)], 0].tolist() for i in range(3)]
    assert seen == [[1, 2], [1, 2, 3], [1, 3]]
    np.testing.assert_array_equal(kept.xy[:, 0], kept.points[kept.point, 0])


def test_every_nth_by_name_from_the_middle_of_the_first_n(tmp_path: Path) -> None:
    write_model(small_model([[0]] * 10), tmp_path / "whole")
    assert hold_out(tmp_path / "whole", tmp_path / "kept") == ["4.jpg"]
    assert hold_out(tmp_path / "whole", tmp_path / "kept", every=4) == ["2.jpg", "6.jpg"]


def test_what_cannot_be_held_out(tmp_path: Path) -> None:
    whole, kept = tmp_path / "whole", tmp_path / "kept"
    write_model(small_model([[0, 1], [0, 1], [0], [1]]), whole)
    for options, words in (
        ({"names": ["none.jpg"]}, "has no photograph none.jpg"),
        ({"names": ["0.jpg", "1.jpg", "2.jpg"]}, "1 photographs and 0 points .* hold out fewer"),
        ({"names": ["0.jpg", "1.jpg"]}, "2 photographs and 0 points"),
        ({"every": 1}, "--every 1 is not possible"),
        ({"every": 9}, "holds out none"),
    ):
        with pytest.raises(InputError, match=words):
            hold_out(whole, kept, **options)
    with pytest.raises(InputError, match="choose another folder"):
        hold_out(whole, whole, names=["0.jpg"])
    assert not kept.exists()
