"""Clusters: no more sub-images than asked for, every point covered, nothing lost."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from engine_scenes import cut_town
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import plane_scene
from sirpy.cli import app
from sirpy.clustering import (
    Visibility,
    add_pointless,
    clusters,
    cover,
    read_clusters,
    visibility,
)
from sirpy.cutting import cut
from sirpy.errors import InputError
from sirpy.exporting import export
from sirpy.layout import Layout
from sirpy.native_images import NativeImage
from sirpy.native_scene import NativeCamera, NativeScene, Observations
from sirpy.rectangle import Grid
from sirpy.workspace import Workspace
from typer.testing import CliRunner


def seen_by(*points: dict[int, float]) -> Visibility:
    """Points by the GSD with which sub-images see them, all above one photograph each."""
    cameras, observations, natives = {}, {}, []
    count = 1 + max(max(point) for point in points)
    for node in range(count):
        name = f"{node:03}.jpg"
        seen = [i for i, point in enumerate(points) if node in point]
        depth = np.array([points[i][node] for i in seen])
        # A focal length of 1: the depth is the GSD.
        pose = np.eye(3, 4)
        cameras[name] = NativeCamera(name, 10, 10, np.eye(3), pose)
        pixels = np.full((len(seen), 2), 5.0)
        observations[name] = Observations(np.array(seen, np.int64), pixels, depth)
        natives.append(Layout(Grid(1, 1)).native_image(name, (10, 10)))
    return visibility(
        tuple(natives), NativeScene(cameras, np.zeros((len(points), 3)), observations)
    )


def check_covered(scene: NativeScene, natives: list[NativeImage], groups: list[list[int]]) -> None:
    """The rule in the head of the module, point by point, without its code."""
    views: dict[int, list[tuple[float, int]]] = {}
    node = 0
    for native in natives:
        seen = scene.observations[native.name]
        focal = scene.cameras[native.name].intrinsics[0, 0]
        for sub in native.sub_images:
            x0, y0, x1, y1 = sub.core.x0, sub.core.y0, sub.core.x1, sub.core.y1
            for point, (x, y), depth in zip(seen.point, seen.pixel, seen.depth, strict=True):
                if x0 <= x < x1 and y0 <= y < y1:
                    views.setdefault(int(point), []).append((depth / focal, node))
            node += 1
    checked = 0
    for seeing in views.values():
        if len(seeing) < 2:
            continue
        finest = min(seeing)[0]
        fine = {one for gsd, one in seeing if gsd <= 1.1 * finest}
        every = {one for _, one in seeing}
        needed = min(3, len(every))
        assert any(fine & set(group) and len(every & set(group)) >= needed for group in groups)
        checked += 1
    assert checked > 0


def test_two_separate_places_are_two_clusters() -> None:
    here = [{0: 1.0, 1: 1.0, 2: 1.0}, {0: 1.0, 1: 1.0}]
    there = [{3: 1.0, 4: 1.0, 5: 1.0}, {4: 1.0, 5: 1.0}]
    assert cover(seen_by(*here, *there), 20) == [[0, 1, 2], [3, 4, 5]]


def test_a_small_group_takes_in_the_finest_view() -> None:
    # 0, 1, 2 share most points, so they are a group; 3 sees one of them nearest, and is added there.
    far = [{0: 2.0, 1: 2.0, 2: 2.0}] * 10
    near = [{3: 2.0, 4: 2.0, 5: 2.0}] * 10
    groups = cover(seen_by(*far, *near, {0: 2.0, 1: 2.0, 3: 1.0}), 5)
    assert sorted(map(sorted, groups)) == [[0, 1, 2, 3], [3, 4, 5]]


def test_as_fine_within_ten_percent_is_enough() -> None:
    far = [{0: 2.0, 1: 2.0, 2: 2.0}] * 10
    near = [{3: 2.0, 4: 2.0, 5: 2.0}] * 10
    groups = cover(seen_by(*far, *near, {0: 2.0, 1: 2.0, 2: 2.0, 3: 1.9}), 5)
    assert sorted(map(sorted, groups)) == [[0, 1, 2], [3, 4, 5]]


def test_points_that_one_photograph_sees_bind_nothing() -> None:
    assert cover(seen_by({0: 1.0}, {1: 1.0}), 20) == []


@given(st.integers(0, 2**32 - 1), st.integers(3, 12))
@settings(max_examples=80, deadline=None)
def test_any_visibility_is_covered_within_the_size(seed: int, size: int) -> None:
    random = np.random.default_rng(seed)
    points = [
        {int(node): float(random.uniform(1, 2)) for node in random.choice(14, views, replace=False)}
        for views in random.integers(1, 9, 40)
    ]
    seen = seen_by(*points)
    groups = cover(seen, size)
    assert max(map(len, groups)) <= size
    assert all(len(set(group)) == len(group) for group in groups)
    for point in points:
        if len(point) < 2:
            continue
        fine = {node for node, gsd in point.items() if gsd <= 1.1 * min(point.values())}
        needed = min(3, len(point))
        assert any(fine & set(g) and len(point.keys() & set(g)) >= needed for g in groups)


@pytest.mark.parametrize("size", [3, 8, 20])
def test_a_flight_is_covered_without_much_twice(size: int) -> None:
    scene = plane_scene(count=8, width=800, height=600, spacing=15)
    layout = Layout(Grid(4, 3), overlap=20)
    natives = [layout.native_image(name, (800, 600)) for name in scene.cameras]
    groups = cover(visibility(tuple(natives), scene), size)
    assert max(map(len, groups)) <= size
    check_covered(scene, natives, groups)
    if size == 20:
        assert sum(map(len, groups)) < 2 * 8 * 12
    assert groups == cover(visibility(tuple(natives), scene), size)


def test_a_point_seen_twice_by_a_photograph_counts_once() -> None:
    observations = Observations(np.array([0, 0]), np.array([[2.0, 5], [8, 5]]), np.ones(2))
    camera = NativeCamera("a.jpg", 10, 10, np.eye(3), np.eye(3, 4))
    scene = NativeScene({"a.jpg": camera}, np.zeros((1, 3)), {"a.jpg": observations})
    native = Layout(Grid(2, 1)).native_image("a.jpg", (10, 10))
    assert len(visibility((native,), scene).point) == 0


def test_the_workspace_lists_every_sub_image(town: Path, tmp_path: Path) -> None:
    workspace = cut(town / "images", town / "sparse", tmp_path / "out", grid=Grid(6, 5))
    found = clusters(workspace, cluster_size=12)
    names = [sub.name for _, sub in workspace.sub_images()]
    assert {name for group in found for name in group} == set(names)
    assert max(map(len, found)) <= 12
    index = json.loads(workspace.clusters_index.read_text())
    assert index["cluster_size"] == 12
    assert [one["sub_images"] for one in index["clusters"]] == found
    listed = sorted(workspace.clusters.iterdir())
    assert [path.name for path in listed[:2]] == ["cluster_0000.txt", "cluster_0001.txt"]
    assert [path.read_text().splitlines() for path in listed] == found
    # Fewer and larger ones leave nothing of the earlier lists behind; another cut none at all.
    larger = clusters(workspace, cluster_size=200)
    assert len(larger) == len(list(workspace.clusters.iterdir())) < len(found)
    again = cut(town / "images", town / "sparse", tmp_path / "out", grid=Grid(2, 2))
    assert not again.clusters_index.exists() and not again.clusters.exists()


def test_pmvs_keeps_no_group_of_earlier_clusters(town: Path, tmp_path: Path) -> None:
    workspace = cut_town(town, tmp_path / "out")
    clusters(workspace, cluster_size=8)
    export(workspace, "PMVS")
    before = len(read_clusters(workspace))
    assert len(workspace.pmvs_groups) == before
    done = CliRunner().invoke(app, ["clusters", str(workspace.folder), "--cluster_size=36"])
    assert done.exit_code == 0
    assert f"run `sirpy export {workspace.folder} PMVS`" in done.output
    assert workspace.pmvs_groups == [] and (workspace.pmvs / "option-all").exists()
    export(workspace, "PMVS")
    assert len(workspace.pmvs_groups) == len(read_clusters(workspace)) < before


def test_sub_images_without_points_join_their_neighbours() -> None:
    # The points lie in the left quarter of both photographs; the rest follows from left to right.
    scene, natives = plane_scene(count=2, width=800, height=600), []
    for name, seen in scene.observations.items():
        left = seen.pixel[:, 0] < 200
        scene.observations[name] = Observations(
            seen.point[left], seen.pixel[left], seen.depth[left]
        )
        natives.append(Layout(Grid(4, 1)).native_image(name, (800, 600)))
    groups = cover(visibility(tuple(natives), scene), 6)
    assert groups == [[0, 4]]
    add_pointless(groups, tuple(natives), 6)
    assert [sorted(group) for group in groups] == [[0, 1, 2, 3, 4, 5], [6, 7]]


def test_a_size_that_cannot_cover_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--cluster_size 2 is not possible"):
        clusters(Workspace(tmp_path), cluster_size=2)
    with pytest.raises(InputError, match="is not a sirpy workspace"):
        clusters(Workspace(tmp_path))
