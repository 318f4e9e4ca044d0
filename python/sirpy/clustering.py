"""Clusters: groups of overlapping sub-images, small enough to be worked on alone, that together cover every
surface at its best resolution. For other engines, and for workers.

After Furukawa, Curless, Seitz, Szeliski: Towards Internet-scale Multi-view Stereo (CVPR 2010): sub-images are
grouped by the sparse points that they share, then images are added until every point is covered. Here both bounds
are hard: no cluster has more than `cluster_size` sub-images, and every sparse point that at least two photographs
see is covered by at least one cluster. A cluster covers a point if it holds a sub-image that sees it with the
finest GSD (depth / focal length, within 10 %), and three that see it in all, or two where there are no more.
"""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import numpy as np
import numpy.typing as npt

from sirpy.colmap_lists import is_listable, names_note
from sirpy.errors import InputError
from sirpy.files import read_json, write_json, written_whole
from sirpy.native_images import NativeImage
from sirpy.native_scene import Floats, Indices, NativeScene, read_native_scene
from sirpy.progress import Progress
from sirpy.workspace import Workspace

_ENOUGH = 3  # sub-images of different photographs that see a point: the finest and two to match it against
_AS_FINE = 1.1  # times the finest GSD counts as finest
_FILLED = 0.7  # of the cluster size before images are added for coverage
_POINTS_OF_AFFINITY = 200_000  # evenly chosen when there are more

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Visibility:
    """Which sub-images, by their position in the workspace, see which sparse points in their cores.

    Entry i says that sub-image node[i] sees the point point[i]; sorted by point, then sub-image. Only
    points that at least two photographs see, numbered from 0.
    """

    sub_images: int
    point: Indices
    node: Indices
    fine: Bools  # as fine as the finest, within 10 %

    @cached_property
    def start(self) -> Indices:
        """The entries of point p are start[p] to start[p + 1]."""
        return _starts(self.point, int(self.point[-1]) + 1 if len(self.point) else 0)

    @cached_property
    def enough(self) -> Indices:
        """Sub-images that a cluster needs to cover each point."""
        return np.minimum(np.diff(self.start), _ENOUGH)

    @cached_property
    def _by_node(self) -> tuple[Indices, Indices]:
        return np.argsort(self.node, kind="stable"), _starts(np.sort(self.node), self.sub_images)

    def entries_of(self, nodes: list[int]) -> Indices:
        """All entries of some sub-images."""
        order, start = self._by_node
        parts = [order[start[node] : start[node + 1]] for node in nodes]
        return np.concatenate(parts) if parts else np.empty(0, np.int64)

    def seen_in(self, nodes: list[int]) -> tuple[Indices, Indices, Bools]:
        """The points that some of these sub-images see, how many do, and whether a finest is among
        them."""
        entries = self.entries_of(nodes)
        points, which, views = np.unique(
            self.point[entries], return_inverse=True, return_counts=True
        )
        has_fine = np.zeros(len(points), bool)
        has_fine[which[self.fine[entries]]] = True
        return points, views, has_fine

    def covered_by(self, nodes: list[int]) -> Indices:
        """The points that a cluster of these sub-images covers."""
        points, views, has_fine = self.seen_in(nodes)
        return points[has_fine & (views >= self.enough[points])]


def clusters(
    workspace: Workspace, *, cluster_size: int = 20, progress: Progress = Progress()
) -> list[list[str]]:
    """Groups the sub-images of a workspace; writes clusters.json and clusters/cluster_NNNN.txt.

    Earlier clusters are removed, with the groups that PMVS had of them: export again for PMVS.

    Every sub-image is in at least one cluster. One without points that others see too joins a cluster
    of its neighbours in the photograph.

    Args:
        workspace: with its sub-images and models (see `cut`).
        cluster_size: sub-images of a cluster, at most; at least 3.

    Returns:
        The names of each cluster's sub-images.

    Raises:
        InputError: the folder is no workspace, or the size is too small.
    """
    _check_size(cluster_size)
    natives = workspace.natives
    seen = visibility(natives, read_native_scene(workspace))
    groups = cover(seen, cluster_size)
    add_pointless(groups, natives, cluster_size)
    groups = sorted(sorted(group) for group in groups)
    names = [sub.name for _, sub in workspace.sub_images()]
    if note := names_note(names, sources=False):
        progress.note(note)
    named = [[names[node] for node in group] for group in groups]
    _write(workspace, named, [len(seen.covered_by(group)) for group in groups], cluster_size)
    return named


def visibility(natives: tuple[NativeImage, ...], scene: NativeScene) -> Visibility:
    """Who sees what, from the observations in the cores of the sub-images."""
    points, nodes, sampling = [], [], []
    node = 0
    for native in natives:
        seen = scene.observations[native.name]
        # A point is seen once by a photograph, whatever a track says.
        point, first = np.unique(seen.point, return_index=True)
        x, y = seen.pixel[first].T
        gsd = seen.depth[first] / scene.cameras[native.name].intrinsics[0, 0]
        for sub in native.sub_images:
            core = sub.core
            inside = (x >= core.x0) & (x < core.x1) & (y >= core.y0) & (y < core.y1)
            points.append(point[inside])
            nodes.append(np.full(int(inside.sum()), node))
            sampling.append(gsd[inside])
            node += 1
    return _of_several(
        node, np.concatenate(points), np.concatenate(nodes), np.concatenate(sampling)
    )


def _of_several(sub_images: int, point: Indices, node: Indices, gsd: Floats) -> Visibility:
    """The entries of points that at least two photographs see."""
    order = np.lexsort((node, point))
    point, node, gsd = point[order], node[order], gsd[order]
    _, number, views = np.unique(point, return_inverse=True, return_counts=True)
    several = views[number] >= 2
    node, gsd = node[several], gsd[several]
    _, point = np.unique(point[several], return_inverse=True)
    if len(point) == 0:
        return Visibility(sub_images, point, node, np.zeros(0, bool))
    finest = np.minimum.reduceat(gsd, _starts(point, int(point[-1]) + 1)[:-1])
    return Visibility(sub_images, point, node, gsd <= _AS_FINE * finest[point])


def read_clusters(workspace: Workspace) -> list[list[str]]:
    """Names of the sub-images of each cluster that was written; empty where none were.

    Raises:
        InputError: clusters.json is damaged.
    """
    try:
        return read_json(
            workspace.clusters_index,
            lambda index: [list(map(str, one["sub_images"])) for one in index["clusters"]],
            "run `sirpy clusters` again",
        )
    except FileNotFoundError:
        return []


def cover(seen: Visibility, cluster_size: int) -> list[list[int]]:
    """Groups of at most `cluster_size` sub-images that cover every point (see the head of the module).

    Sub-images without points are in no group. The same input gives the same groups.
    """
    _check_size(cluster_size)
    groups = _partition(seen, max(1, int(_FILLED * cluster_size)))
    covered = np.zeros(len(seen.enough), bool)
    for group in groups:
        covered[seen.covered_by(group)] = True
    _add_images(seen, groups, covered, cluster_size)
    while not covered.all():
        groups.append(_new_group(seen, covered, cluster_size))
    return groups


def _partition(seen: Visibility, most: int) -> list[list[int]]:
    """Groups of at most `most` sub-images; those that share the most points merge first (average
    linkage)."""
    near = _affinities(seen)
    members = {node: [node] for node in near}
    best = [(-weight, a, b) for a, row in near.items() for b, weight in row.items() if a < b]
    heapq.heapify(best)
    numbers = count(seen.sub_images)
    while best:
        _, a, b = heapq.heappop(best)
        if a not in members or b not in members:
            continue
        if len(members[a]) + len(members[b]) > most:
            continue
        new = next(numbers)
        members[new] = members.pop(a) + members.pop(b)
        row = near.pop(a)
        for other, weight in near.pop(b).items():
            row[other] = row.get(other, 0.0) + weight
        row.pop(a, None)
        row.pop(b, None)
        near[new] = row
        for other, weight in row.items():
            del_from = near[other]
            del_from.pop(a, None)
            del_from.pop(b, None)
            del_from[new] = weight
            size = len(members[new]) * len(members[other])
            heapq.heappush(best, (-weight / size, other, new))
    return sorted(sorted(group) for group in members.values())


def _affinities(seen: Visibility) -> dict[int, dict[int, float]]:
    """Shared points of sub-images, as a share of their own: 1 where two see the same points."""
    stride = -(-len(seen.enough) // _POINTS_OF_AFFINITY) or 1
    chosen = seen.point % stride == 0
    point, node = seen.point[chosen], seen.node[chosen]
    own = np.bincount(node, minlength=seen.sub_images)
    keys, shared = [], []
    for step in count(1):
        same = point[step:] == point[:-step]
        if not same.any():
            break
        pairs = node[:-step][same] * seen.sub_images + node[step:][same]
        key, number = np.unique(pairs, return_counts=True)
        keys.append(key)
        shared.append(number)
    near: dict[int, dict[int, float]] = {int(one): {} for one in np.unique(seen.node)}
    if not keys:
        return near
    key, which = np.unique(np.concatenate(keys), return_inverse=True)
    total = np.bincount(which, np.concatenate(shared))
    a, b = key // seen.sub_images, key % seen.sub_images
    weight = total / np.sqrt(own[a] * own[b])
    for i, j, w in zip(a.tolist(), b.tolist(), weight.tolist(), strict=True):
        near[i][j] = w
        near[j][i] = w
    return near


def _add_images(
    seen: Visibility, groups: list[list[int]], covered: Bools, cluster_size: int
) -> None:
    """Adds the image that completes the most points to the group where it does, until none helps."""
    best = [
        (-gain, number, node)
        for number, group in enumerate(groups)
        for gain, node in [_best_addition(seen, group, covered, cluster_size)]
        if gain > 0
    ]
    heapq.heapify(best)
    while best:
        gain, number, node = heapq.heappop(best)
        # Other groups may have covered the points since, so gains only shrink.
        now = _best_addition(seen, groups[number], covered, cluster_size)
        if now == (-gain, node):
            groups[number].append(node)
            covered[seen.covered_by(groups[number])] = True
            now = _best_addition(seen, groups[number], covered, cluster_size)
        if now[0] > 0:
            heapq.heappush(best, (-now[0], number, now[1]))


def _new_group(seen: Visibility, covered: Bools, cluster_size: int) -> list[int]:
    """A group around the sub-image that is the finest of the most points that are not covered yet."""
    wanted = seen.fine & ~covered[seen.point]
    group = [int(np.bincount(seen.node[wanted], minlength=seen.sub_images).argmax())]
    while True:
        gain, node = _best_addition(seen, group, covered, cluster_size)
        if gain == 0:
            return group
        group.append(node)
        covered[seen.covered_by(group)] = True


def _best_addition(
    seen: Visibility, group: list[int], covered: Bools, cluster_size: int
) -> tuple[float, int]:
    """(gain, sub-image): a point that becomes covered counts 1, one that still needs n images 8^-n.

    Points that need more than there is room for count nothing, so a group never grows in vain.
    """
    points, views, has_fine = seen.seen_in(group)
    lacking = np.maximum(seen.enough[points] - views, ~has_fine)
    open_ = ~covered[points] & (lacking <= cluster_size - len(group))
    points, views, has_fine, lacking = (a[open_] for a in (points, views, has_fine, lacking))
    if len(points) == 0:
        return 0.0, 0
    length = seen.start[points + 1] - seen.start[points]
    which = np.repeat(np.arange(len(points)), length)
    entries = np.arange(len(which)) + np.repeat(
        seen.start[points] - np.cumsum(length) + length, length
    )
    still = np.maximum(
        seen.enough[points][which] - views[which] - 1, ~(has_fine[which] | seen.fine[entries])
    )
    credit = np.where(still < lacking[which], 0.125 ** still.clip(min=0), 0.0)
    gain = np.bincount(seen.node[entries], credit, minlength=seen.sub_images)
    gain[group] = 0
    node = int(gain.argmax())
    return float(gain[node]), node


def add_pointless(
    groups: list[list[int]], natives: tuple[NativeImage, ...], cluster_size: int
) -> None:
    """Gives each sub-image that is in no group yet to a group of its neighbour, if one has room."""
    homes: dict[int, list[list[int]]] = {}
    for group in groups:
        for node in group:
            homes.setdefault(node, []).append(group)

    def settle(node: int, neighbour: int | None) -> None:
        candidates = homes[neighbour] if neighbour is not None else []
        home = next((group for group in candidates if len(group) < cluster_size), None)
        if home is None:
            home = []
            groups.append(home)
        home.append(node)
        homes[node] = [home]

    first = 0
    for native in natives:
        places = {(sub.row, sub.column): first + i for i, sub in enumerate(native.sub_images)}
        first += len(places)
        left = {place for place, node in places.items() if node not in homes}
        frontier = deque(place for place in places if place not in left)
        while left:
            if not frontier:
                frontier.append(min(left))
                left.remove(frontier[0])
                settle(places[frontier[0]], None)
            row, column = frontier.popleft()
            for step_y, step_x in ((-1, 0), (0, -1), (0, 1), (1, 0)):
                near = row + step_y, column + step_x
                if near in left:
                    left.remove(near)
                    settle(places[near], places[row, column])
                    frontier.append(near)


def _write(
    workspace: Workspace, named: list[list[str]], points: list[int], cluster_size: int
) -> None:
    workspace.remove_clusters()
    digits = max(4, len(str(len(named) - 1)))
    index = []
    for number, (names, covered) in enumerate(zip(named, points, strict=True)):
        name = f"cluster_{number:0{digits}}"
        with written_whole(workspace.cluster(name)) as path:
            listed = filter(is_listable, names)
            path.write_text("".join(f"{one}\n" for one in listed), encoding="utf-8")
        index.append({"name": name, "points": covered, "sub_images": names})
    write_json(
        workspace.clusters_index, {"version": 1, "cluster_size": cluster_size, "clusters": index}
    )


def _check_size(cluster_size: int) -> None:
    if cluster_size < _ENOUGH:
        raise InputError(
            f"--cluster_size {cluster_size} is not possible: a point needs {_ENOUGH} sub-images, so "
            f"choose {_ENOUGH} or more"
        )


def _starts(ordered: Indices, number: int) -> Indices:
    """Where each of 0 to number - 1 begins in an ordered array, and the end."""
    starts = np.zeros(number + 1, np.int64)
    np.cumsum(np.bincount(ordered, minlength=number), out=starts[1:])
    return starts
