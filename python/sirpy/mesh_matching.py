"""Two sets of polylines in one plane that are nearly the same: which place of the one is which of the other.

Where two tiles meet, each surface leaves its polylines in the vertical plane between them. They run a small part of
a cell apart, with vertices in different places. The second ones are laid onto the first: each vertex goes to the
nearest place that lies ahead of the one before it, so that nothing folds.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from sirpy.frame import Floats
from sirpy.mesh_cutting import Indices

TOLERANCE = 2.0  # cells between the surfaces of two tiles that are taken for one
_SNAP = 0.1  # cells: nearer than this to a vertex, a place is that vertex
_STRETCH = 3.0  # how much longer one polyline may be than the other between two places


@dataclass(frozen=True)
class Place:
    """On an edge of the first polylines: 0 at its beginning, 1 at its end."""

    edge: int
    part: float


@dataclass
class Match:
    """Attributes:
    places: where vertices of the second polylines lie on the first.
    inserts: the vertices of the first polylines that lie within edges of the second, in the direction of the edge.
    """

    places: dict[int, Place] = field(default_factory=dict)
    inserts: dict[int, list[int]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Chain:
    """Edges one after the other.

    Attributes:
        vertices: (n + 1,), the first again at the end where the chain is closed.
        edges: (n,).
        along: (n + 1,) length from the beginning.
    """

    vertices: Indices
    edges: Indices
    along: Floats

    @property
    def closed(self) -> bool:
        return bool(self.vertices[0] == self.vertices[-1])


def match(
    first: Floats, first_edges: Indices, second: Floats, second_edges: Indices, same: dict[int, int]
) -> Match:
    """Lays the second polylines onto the first.

    Args:
        first, second: vertices (n, 2), in cells.
        first_edges, second_edges: (e, 2) in the same direction.
        same: vertices of the second that are known to be vertices of the first (-1: to be none of them).
    """
    ours = _chains(first, first_edges)
    found = Match()
    if not ours:
        return found
    ground = _Ground(first, ours)
    links: list[tuple[float, Chain, _Run]] = []
    for chain in _chains(second, second_edges):
        steps = ground.nearest(second, chain, same)
        for run in _runs(steps, chain, ours):
            worst = max(steps[run.begin].distance, steps[run.end].distance)
            links.append((worst, chain, run))
    links.sort(key=lambda link: link[0])
    laid: dict[
        int, tuple[int, float]
    ] = {}  # vertex of the second: chain of the first, and place on it
    for _, chain, run in links:
        _lay(run, chain, ours[run.chain], ground, laid, found)
    return found


@dataclass(frozen=True)
class _Step:
    """The place of a vertex: a chain of the first (-1: none), edges from its beginning, how far away."""

    chain: int
    place: float
    distance: float


@dataclass(frozen=True)
class _Run:
    """Vertices begin to end of a chain of the second, from place to place of a chain of the first."""

    begin: int
    end: int
    chain: int
    from_place: float
    to_place: float


class _Ground:
    """The first polylines: nearest places, and what is taken already."""

    def __init__(self, points: Floats, chains: Sequence[Chain]) -> None:
        self._chains = chains
        self._chain = np.concatenate([np.full(len(one.edges), i) for i, one in enumerate(chains)])
        self._index = np.concatenate([np.arange(len(one.edges)) for one in chains])
        self._begin = points[np.concatenate([one.vertices[:-1] for one in chains])]
        self._vector = points[np.concatenate([one.vertices[1:] for one in chains])] - self._begin
        self._order = np.argsort(self._begin[:, 0] + self._vector[:, 0] / 2, kind="stable")
        self._middle = (self._begin[:, 0] + self._vector[:, 0] / 2)[self._order]
        self._reach = float(np.abs(self._vector[:, 0]).max() / 2) + TOLERANCE
        self._of_vertex = {
            int(vertex): (i, float(k))
            for i, one in reversed(list(enumerate(chains)))
            for k, vertex in reversed(list(enumerate(one.vertices)))
        }
        self._taken: dict[int, list[tuple[float, float]]] = defaultdict(list)

    def nearest(self, points: Floats, chain: Chain, same: dict[int, int]) -> list[_Step]:
        """The nearest place of each vertex of `chain` where the first polylines go in its direction."""
        at = points[chain.vertices]
        before, after = np.roll(at, 1, axis=0), np.roll(at, -1, axis=0)
        before[0], after[-1] = (at[-2], at[1]) if chain.closed else (at[0], at[-1])
        steps = []
        for vertex, place, ahead in zip(chain.vertices, at, after - before, strict=True):
            if (known := same.get(int(vertex))) is not None:
                steps.append(_Step(*self._of_vertex.get(known, (-1, 0.0)), 0.0))
            else:
                steps.append(self._nearest(place, ahead))
        if chain.closed:
            self._close(steps, at[0])
        return steps

    def _close(self, steps: list[_Step], start: Floats) -> None:
        """A ring on a ring goes from beginning to end, since both begin at their lowest first coordinate."""
        number = steps[len(steps) // 2].chain
        if number >= 0 and self._chains[number].closed:
            away = float(np.hypot(*(start - self._begin[self._chain == number][0])))
            if away <= TOLERANCE:
                end = float(len(self._chains[number].edges))
                steps[0], steps[-1] = _Step(number, 0.0, away), _Step(number, end, away)

    def _nearest(self, place: Floats, ahead: Floats) -> _Step:
        low, high = np.searchsorted(
            self._middle, [place[0] - self._reach, place[0] + self._reach], side="left"
        )
        edges = self._order[low:high]
        edges = edges[self._vector[edges] @ ahead > 0]
        if not len(edges):
            return _Step(-1, 0.0, np.inf)
        vector, away = self._vector[edges], place - self._begin[edges]
        part = (vector * away).sum(axis=1) / np.maximum((vector**2).sum(axis=1), 1e-30)
        part = np.clip(part, 0, 1)
        distance = np.hypot(*(away - part[:, None] * vector).T)
        best = int(np.argmin(distance))
        if distance[best] > TOLERANCE:
            return _Step(-1, 0.0, np.inf)
        edge = edges[best]
        return _Step(
            int(self._chain[edge]), float(self._index[edge] + part[best]), float(distance[best])
        )

    def take(self, chain: int, begin: float, end: float) -> bool:
        """Claims a part of a chain; False where some of it is taken: no edge gets a third face."""
        taken = self._taken[chain]
        at = bisect_right(taken, (begin, end))
        if at > 0 and taken[at - 1][1] > begin:
            return False
        if at < len(taken) and taken[at][0] < end:
            return False
        if end > begin:
            insort(taken, (begin, end))
        return True


def _runs(steps: Sequence[_Step], chain: Chain, ours: Sequence[Chain]) -> list[_Run]:
    """Between vertices that follow each other on one of our chains as they do on theirs."""
    kept = sorted(
        index
        for number in {step.chain for step in steps if step.chain >= 0}
        for index in _ahead(steps, number, ours[number])
    )
    runs = []
    for begin, end in pairwise(kept):
        from_step, to_step = steps[begin], steps[end]
        number = from_step.chain
        if number != to_step.chain or to_step.place < from_step.place:
            continue
        of_ours = _length(ours[number], to_step.place) - _length(ours[number], from_step.place)
        of_theirs = chain.along[end] - chain.along[begin]
        short, long = sorted((of_ours, of_theirs))
        if long <= _STRETCH * short + 2 * TOLERANCE:
            runs.append(_Run(begin, end, number, from_step.place, to_step.place))
    return runs


def _ahead(steps: Sequence[_Step], number: int, ours: Chain) -> list[int]:
    """The most vertices whose places on one chain do not go back; beyond its ends, only the next one."""
    indices = [index for index, step in enumerate(steps) if step.chain == number]
    if ours.closed:
        return _longest_rise(indices, steps)
    last = float(len(ours.edges))
    at_begin = [index for index in indices if steps[index].place == 0]
    at_end = [index for index in indices if steps[index].place == last]
    beyond = {*at_begin[:-1], *at_end[1:]}
    return _longest_rise([index for index in indices if index not in beyond], steps)


def _longest_rise(indices: Sequence[int], steps: Sequence[_Step]) -> list[int]:
    """The longest subsequence of which no place is before the one before it."""
    ends: list[float] = []
    of_length: list[int] = []
    before: dict[int, int | None] = {}
    for index in indices:
        place = steps[index].place
        at = bisect_right(ends, place)
        ends[at : at + 1] = [place]
        of_length[at : at + 1] = [index]
        before[index] = of_length[at - 1] if at else None
    rise: list[int] = []
    index_or_none = of_length[-1] if of_length else None
    while index_or_none is not None:
        rise.append(index_or_none)
        index_or_none = before[index_or_none]
    return rise[::-1]


def _lay(
    run: _Run,
    chain: Chain,
    ours: Chain,
    ground: _Ground,
    laid: dict[int, tuple[int, float]],
    found: Match,
) -> None:
    """Lays the vertices and edges of a run onto our chain, unless something lies there already."""
    vertices = [int(vertex) for vertex in chain.vertices[run.begin : run.end + 1]]
    part = (chain.along[run.begin : run.end + 1] - chain.along[run.begin]) / max(
        chain.along[run.end] - chain.along[run.begin], 1e-30
    )
    places = [
        _snapped(run.from_place + float(one) * (run.to_place - run.from_place), ours)
        for one in part
    ]
    around = float(len(ours.edges)) if ours.closed else float("inf")  # where places begin again
    for vertex, place in zip(vertices, places, strict=True):
        if laid.get(vertex, (run.chain, place % around)) != (run.chain, place % around):
            return
    if not ground.take(run.chain, places[0], places[-1]):
        return
    for vertex, place in zip(vertices, places, strict=True):
        laid[vertex] = run.chain, place % around
        edge = min(int(place), len(ours.edges) - 1)
        found.places[vertex] = Place(int(ours.edges[edge]), place - edge)
    for index, (begin, end) in enumerate(pairwise(places)):
        between = range(int(begin) + 1, int(np.ceil(end)))
        edge = int(chain.edges[run.begin + index])
        found.inserts[edge] = [int(ours.vertices[k]) for k in between]


def _snapped(place: float, chain: Chain) -> float:
    nearest = round(place)
    away = abs(_length(chain, place) - chain.along[nearest])
    return float(nearest) if away < _SNAP else place


def _length(chain: Chain, place: float) -> float:
    return float(np.interp(place, np.arange(len(chain.along)), chain.along))


def _chains(points: Floats, edges: Indices) -> list[Chain]:
    """The edges as chains, which end where they branch; closed ones begin at their lowest first coordinate."""
    out: dict[int, list[int]] = defaultdict(list)
    into: dict[int, int] = defaultdict(int)
    for edge, (begin, end) in enumerate(edges.tolist()):
        out[begin].append(edge)
        into[end] += 1
    through = {vertex for vertex in out if len(out[vertex]) == 1 and into[vertex] == 1}
    starts = [edge for edge in range(len(edges)) if int(edges[edge, 0]) not in through]
    seen: set[int] = set()
    chains = []
    for start in [*starts, *range(len(edges))]:
        chain: list[int] = []
        following: int | None = start
        while following is not None and following not in seen:
            seen.add(following)
            chain.append(following)
            end = int(edges[following, 1])
            following = out[end][0] if end in through else None
        if chain and edges[chain[0], 0] == edges[chain[-1], 1]:
            lowest = int(np.argmin(points[edges[chain, 0], 0]))
            chain = chain[lowest:] + chain[:lowest]
        if chain:
            vertices = np.append(edges[chain, 0], edges[chain[-1], 1])
            lengths = np.hypot(*np.diff(points[vertices], axis=0).T)
            chains.append(Chain(vertices, np.array(chain), np.append(0.0, np.cumsum(lengths))))
    return chains
