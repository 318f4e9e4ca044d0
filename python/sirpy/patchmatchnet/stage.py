"""A stage of learned PatchMatch (Wang et al., CVPR 2021, section 3.2).

Hypotheses of depth for every pixel, their similarity to the sources, adaptive aggregation over neighbours on the same
surface, regression. Maps are in pixels of the stage; what is per pixel is worked on in bands of rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from sirpy._core import group_correlation
from sirpy.patchmatchnet.bands import Bands
from sirpy.patchmatchnet.features import CHANNELS
from sirpy.patchmatchnet.layers import PointwiseNet
from sirpy.patchmatchnet.sampling import (
    Frame,
    SourceMap,
    at_neighbours,
    neighbour_positions,
    warped,
)

INITIAL = 48  # bins of inverse depth that the first hypotheses are drawn from
_NEIGHBOURS = 9  # that costs are aggregated over


@dataclass(frozen=True)
class Settings:
    """What a stage does, as the published weights were trained."""

    stage: int
    groups: int  # of feature channels
    iterations: int
    samples: int  # around the depth so far
    interval: float  # between them, share of the range of inverse depths
    propagated: int  # neighbours whose depth is tried
    dilation: int  # of the learned offsets, and distance of the neighbours, pixels

    @property
    def reach(self) -> int:
        """Pixels that have a say in a pixel, beside what offsets the network has learned."""
        propagation = {0: 0, 8: self.dilation, 16: 2 * self.dilation}[self.propagated]
        aggregation = self.dilation  # its neighbours are a pixel nearer, and interpolated
        return self.iterations * (propagation + aggregation)


SETTINGS = (
    Settings(3, groups=8, iterations=2, samples=16, interval=0.025, propagated=16, dilation=2),
    Settings(2, groups=8, iterations=2, samples=8, interval=0.0125, propagated=8, dilation=4),
    Settings(1, groups=4, iterations=1, samples=8, interval=0.005, propagated=0, dilation=6),
)


@dataclass(frozen=True)
class InverseRange:
    """Inverse depths [h, w] between which a pixel's hypotheses lie: of the nearest and the farthest."""

    near: Tensor
    far: Tensor


@dataclass(frozen=True)
class Problem:
    """What a stage is given, beside the depth so far.

    Attributes:
        reference: features [C, h, w].
        frame: where they lie in the map of the whole image.
    """

    reference: Tensor
    sources: Sequence[SourceMap]
    range: InverseRange
    frame: Frame


@dataclass(frozen=True)
class Found:
    """What a stage finds.

    Attributes:
        depths: [h, w], one of each iteration.
        view_weights: [S, h, w], how much each source sees of a pixel.
        confidence: [h, w], of the last stage: the published one, probability of the four hypotheses
            around the depth. It depends on how far these are apart.
    """

    depths: list[Tensor]
    view_weights: Tensor
    confidence: Tensor | None = None


class Evaluation(nn.Module):
    """Similarities of groups of channels to a matching cost, and to how much a source sees."""

    def __init__(self, groups: int) -> None:
        super().__init__()
        self.similarity_net = PointwiseNet(groups)
        self.pixel_wise_net = PointwiseNet(groups, "conv2")


class PatchMatchStage(nn.Module):
    """One stage, all its iterations."""

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        self.settings = settings
        channels, dilation = CHANNELS[settings.stage], settings.dilation

        def offsets(count: int) -> nn.Conv2d:
            return nn.Conv2d(channels, count, 3, padding=dilation, dilation=dilation)

        self.propa_conv = offsets(max(2 * settings.propagated, 1))
        self.eval_conv = offsets(2 * _NEIGHBOURS)
        self.feature_weight_net = PointwiseNet(settings.groups)
        self.evaluation = Evaluation(settings.groups)

    def forward(
        self,
        problem: Problem,
        depth: Tensor | None,
        view_weights: Tensor | None,
        initial: Tensor | None,
        bands: Bands,
    ) -> Found:
        """Finds the depths of a stage.

        Args:
            depth: [h, w], None in the first stage; then
            initial: [48, h, w], random numbers from 0 to 1.
            view_weights: [S, h, w], of the stage before.
        """
        depths: list[Tensor] = []
        for _ in range(self.settings.iterations):
            if depth is None:
                assert initial is not None
                start = self.drawn(problem.range, initial)
            else:
                start = self.perturbed(problem.range, depth)
            hypotheses, cost, view_weights = self.matched(problem, start, view_weights, bands)
            depth, confidence = self.regressed(problem, hypotheses, cost, bands)
            depths.append(depth)
        assert view_weights is not None
        return Found(depths, view_weights, confidence)

    def drawn(self, limits: InverseRange, initial: Tensor) -> Tensor:
        """[48, h, w]: a depth in each of as many bins of inverse depth, the farthest first."""
        bins = torch.arange(INITIAL, device=initial.device)[:, None, None]
        return 1 / (limits.far + (initial + bins) / INITIAL * (limits.near - limits.far))

    def perturbed(self, limits: InverseRange, depth: Tensor) -> Tensor:
        """[N, h, w]: depths around `depth`, evenly in inverse depth, the farthest first."""
        half = self.settings.samples // 2
        steps = torch.arange(-half, half, device=depth.device)[:, None, None]
        step = self.settings.interval * (limits.near - limits.far)
        inverse = 1 / depth + steps * step
        return 1 / torch.minimum(torch.maximum(inverse, limits.far), limits.near)

    def propagated(self, problem: Problem, start: Tensor, rows: slice) -> Tensor:
        """[N + P, rows, w], ascending: the hypotheses, and depths of neighbours."""
        if not self.settings.propagated:
            return start[:, rows]
        offsets = _offsets(self.propa_conv, problem.reference, rows)
        fixed = _ring(self.settings.dilation, start)
        if self.settings.propagated == 16:
            fixed = torch.cat([fixed, 2 * fixed])
        x, y = neighbour_positions(offsets, fixed, rows.start)
        of_neighbours = at_neighbours(start[len(start) // 2, None], x, y, problem.frame)[0]
        return torch.cat([start[:, rows], of_neighbours]).sort(dim=0).values

    def matched(
        self, problem: Problem, start: Tensor, view_weights: Tensor | None, bands: Bands
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Hypotheses and their matching costs [D, h, w]; the view weights [S, h, w]."""
        channels, height, width = problem.reference.shape
        count = len(start) + self.settings.propagated
        hypotheses = start.new_empty(count, height, width)
        cost = start.new_empty(count, height, width)
        weights = view_weights
        if weights is None:
            weights = start.new_empty(len(problem.sources), height, width)

        def band(rows: slice) -> None:
            depth = self.propagated(problem, start, rows).contiguous()
            hypotheses[:, rows] = depth
            total = depth.new_zeros(self.settings.groups, *depth.shape)
            weight_sum = depth.new_full((), 1e-5)
            for index, source in enumerate(problem.sources):
                allowed = None if source.allowed is None else source.allowed[rows]
                if allowed is not None and not allowed.any():
                    weights[index, rows] = 0
                    continue
                similarity = self.similarity(problem.reference[:, rows], source, depth, rows.start)
                if view_weights is None:
                    seen = self.evaluation.pixel_wise_net(similarity).sigmoid_()
                    seen = seen.amax(dim=0)
                    weights[index, rows] = seen if allowed is None else seen * allowed
                weight = weights[index, rows]
                total += similarity.mul_(weight)
                weight_sum = weight_sum + weight
            cost[:, rows] = self.evaluation.similarity_net(total.div_(weight_sum))

        bands.run(band, height, 4 * channels * count * width)
        return hypotheses, cost, weights

    def similarity(
        self, reference: Tensor, source: SourceMap, depth: Tensor, first_row: int
    ) -> Tensor:
        """[G, D, h, w]: mean products of the channels of each group, for depths [D, h, w]."""
        groups = self.settings.groups
        if depth.device.type == "cpu":
            found = group_correlation(
                _pixels(reference),
                _pixels(source.features),
                source.source_from_reference.numpy(),
                depth.numpy(),
                first_row=first_row,
                behind=source.behind,
                groups=groups,
            )
            return torch.from_numpy(found)
        features = warped(source, depth, first_row)
        features.mul_(reference[:, None])
        return features.reshape(groups, -1, *depth.shape).mean(dim=1)

    def regressed(
        self, problem: Problem, hypotheses: Tensor, cost: Tensor, bands: Bands
    ) -> tuple[Tensor, Tensor | None]:
        """Depth [h, w]; in the last stage also the confidence."""
        count, height, width = hypotheses.shape
        limits = problem.range
        # Inverse depth, 0 to 1 over the window: differences keep their digits.
        low, high = limits.far.amin(), limits.near.amax()
        position = (1 / hypotheses - low) / (high - low)
        depth = hypotheses.new_empty(height, width)
        confidence = torch.empty_like(depth) if self.settings.stage == 1 else None

        def band(rows: slice) -> None:
            x, y = self.around(problem.reference, rows)
            extent = (limits.near - limits.far)[rows] / (high - low)
            weight = self.depth_weights(position, x, y, extent, problem.frame, rows)
            weight *= self.feature_weights(problem.reference, x, y, problem.frame, rows)
            weight /= weight.sum(dim=1, keepdim=True)
            score = (weight * at_neighbours(cost, x, y, problem.frame)).sum(dim=1)
            probability = F.log_softmax(score, dim=0).exp_()
            if confidence is None:
                depth[rows] = (probability * hypotheses[:, rows]).sum(dim=0)
            else:
                depth[rows] = between_ends(probability, hypotheses[:, rows])
                confidence[rows] = four_around(probability)

        bands.run(
            band, height, 4 * _NEIGHBOURS * max(4 * count, CHANNELS[self.settings.stage]) * width
        )
        return depth, confidence

    def around(self, reference: Tensor, rows: slice) -> tuple[Tensor, Tensor]:
        """x and y [9, rows, w] of the neighbours that the cost of each pixel is aggregated over."""
        offsets = _offsets(self.eval_conv, reference, rows)
        ring = _ring(self.settings.dilation - 1, reference)
        fixed = torch.cat([ring[:4], ring.new_zeros(1, 2), ring[4:]])
        return neighbour_positions(offsets, fixed, rows.start)

    def feature_weights(
        self, reference: Tensor, x: Tensor, y: Tensor, frame: Frame, rows: slice
    ) -> Tensor:
        """[9, rows, w]: how alike the neighbours look."""
        features = at_neighbours(reference, x, y, frame).mul_(reference[:, None, rows])
        alike = features.reshape(self.settings.groups, -1, *x.shape).mean(dim=1)
        found: Tensor = self.feature_weight_net(alike).sigmoid_()
        return found

    def depth_weights(
        self, position: Tensor, x: Tensor, y: Tensor, extent: Tensor, frame: Frame, rows: slice
    ) -> Tensor:
        """[D, 9, rows, w]: how near the hypotheses of the neighbours are.

        Args:
            position: [D, h, w], inverse depth in a unit of which the range of a pixel has
            extent: [rows, w].
        """
        apart = at_neighbours(position, x, y, frame).sub_(position[:, None, rows]).abs_()
        apart /= self.settings.interval * extent
        return apart.clamp_(0, 4).mul_(-2).add_(4).sigmoid_()


def between_ends(probability: Tensor, hypotheses: Tensor) -> Tensor:
    """Depth [h, w] from the mean index, linear in inverse depth between the first and last of [D, h, w]."""
    ends = 1 / hypotheses[0], 1 / hypotheses[-1]
    share = _mean_index(probability) / (len(hypotheses) - 1)
    return 1 / (ends[0] + share * (ends[1] - ends[0]))


def four_around(probability: Tensor) -> Tensor:
    """The published confidence [h, w]: probability of the four hypotheses around the mean index."""
    padded = F.pad(probability, (0, 0, 0, 0, 1, 2))
    four = sum(padded[k : k + len(probability)] for k in range(4))
    assert isinstance(four, Tensor)
    index = _mean_index(probability).long().clamp_(0, len(probability) - 1)
    return four.gather(0, index[None])[0]


def _mean_index(probability: Tensor) -> Tensor:
    index = torch.arange(len(probability), device=probability.device, dtype=probability.dtype)
    return (index[:, None, None] * probability).sum(dim=0)


def _ring(distance: int, like: Tensor) -> Tensor:
    """[8, 2] (x, y): the neighbours of a pixel row by row, so far away."""
    steps = (-distance, 0, distance)
    return like.new_tensor([(x, y) for y in steps for x in steps if x or y])


def _pixels(maps: Tensor) -> npt.NDArray[np.float32]:
    """[h, w, C] of maps [C, h, w] on the CPU; a copy unless their channels are side by side."""
    return maps.permute(1, 2, 0).contiguous().numpy()


def _offsets(convolution: nn.Conv2d, features: Tensor, rows: slice) -> Tensor:
    """The rows of a dilated 3x3 convolution of [C, h, w], with zeros around the map."""
    reach = convolution.dilation[0]
    first, end = rows.start - reach, rows.stop + reach
    inside = features[:, max(0, first) : min(end, features.shape[1])]
    above, below = max(0, -first), max(0, end - features.shape[1])
    padded = F.pad(inside, (reach, reach, above, below))
    return F.conv2d(padded[None], convolution.weight, convolution.bias, dilation=reach)[0]
