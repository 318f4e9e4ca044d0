"""Clouds and workspaces with points, for the tests of what is made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sirpy.cloud import POINT, Cloud, Points
from sirpy.files import write_json
from sirpy.frame import Frame
from sirpy.native_images import NativeImage, SubImage
from sirpy.npy import write_npy
from sirpy.rectangle import Rectangle
from sirpy.workspace import Workspace

# A model of which one unit is 2 m, turned a quarter around the vertical, in the UTM zone of Munich.
UTM = Frame(
    "EPSG:32632",
    2.0,
    np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([691000.25, 5335000.5, 520.0]),
)


def ground(count: int = 20_000, seed: int = 0, gsd: float = 0.05) -> Points:
    """Points of a hilly square of 40 units, in random order, the model's frame."""
    random = np.random.default_rng(seed)
    points = np.zeros(count, POINT)
    points["x"], points["y"] = random.uniform(-20, 20, (2, count))
    points["z"] = 2 * np.sin(points["x"] / 5) * np.cos(points["y"] / 7)
    points["nz"] = 1
    for name in ("red", "green", "blue"):
        points[name] = random.integers(0, 256, count)
    points["views"] = random.integers(2, 9, count)
    points["confidence"] = random.uniform(0, 1, count)
    points["gsd"] = gsd * random.integers(1, 4, count)
    return points


def cloud_of(folder: Path, parts: list[Points], frame: Frame = UTM) -> Cloud:
    paths = []
    for number, points in enumerate(parts):
        paths.append(folder / f"{number}.npy")
        write_npy(paths[-1], points)
    return Cloud(paths, frame)


def fused_workspace(
    folder: Path, points: Points, monkeypatch: pytest.MonkeyPatch, frame: Frame = UTM
) -> Workspace:
    """A workspace whose two sub-images have the points, and whose frame is `frame`."""
    workspace = Workspace(folder)
    halves = [Rectangle(0, 0, 50, 80), Rectangle(50, 0, 50, 80)]
    subs = tuple(SubImage(f"a_r00_c0{i}.jpg", 0, i, half, half) for i, half in enumerate(halves))
    workspace.begin_stage("cut", "test")
    workspace.begin_stage("fuse", "test")
    workspace.write_index([NativeImage("a.jpg", 100, 80, subs)], [])
    for sub_image, part in zip(subs, np.array_split(points, 2), strict=True):
        write_npy(workspace.fused_part(sub_image), part)
    write_json(workspace.fused_parts, [sub_image.name for sub_image in subs])
    monkeypatch.setattr("sirpy.products.read_frame", lambda _: frame)
    return workspace
