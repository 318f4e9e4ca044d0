"""PatchmatchNet: Wang, Galliani, Vogel, Speciale, Pollefeys, "PatchmatchNet: Learned Multi-View Patchmatch Stereo",
CVPR 2021, as its authors publish it (inference only).

Images -> features -> learned PatchMatch at an eighth, a quarter and half of their size -> refinement at full size.
Pixel centres lie at whole numbers; depth is z in the camera; extrinsics are camera-from-world.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from sirpy.errors import InputError
from sirpy.patchmatchnet.bands import Bands
from sirpy.patchmatchnet.features import STEP, FeatureNet
from sirpy.patchmatchnet.refinement import Refinement, as_float, doubled
from sirpy.patchmatchnet.sampling import Frame, SourceMap
from sirpy.patchmatchnet.stage import INITIAL, SETTINGS, InverseRange, PatchMatchStage, Problem


@dataclass(frozen=True)
class Result:
    """What the network finds.

    Attributes:
        depth: [H, W].
        confidence: [H, W], the published one; it depends on the width of the depth range.
        stages: depths of the iterations of stages 3, 2, 1 (1/8, 1/4, 1/2 of the size).
        view_weights: [S, H / 8, W / 8], how much each source sees, 0 to 1.
    """

    depth: Tensor
    confidence: Tensor
    stages: dict[int, list[Tensor]]
    view_weights: Tensor


class PatchmatchNet(nn.Module):
    """The published network; its parameters carry the names of the published checkpoint."""

    def __init__(self) -> None:
        super().__init__()
        self.feature = FeatureNet()
        for settings in SETTINGS:
            self.add_module(f"patchmatch_{settings.stage}", PatchMatchStage(settings))
        self.upsample_net = Refinement()
        self.eval().requires_grad_(False)

    @staticmethod
    def from_checkpoint(path: Path | str, device: torch.device | str = "cpu") -> PatchmatchNet:
        """The network with the weights of a published checkpoint.

        Raises:
            InputError: the file is missing, or no checkpoint of this network.
        """
        net = PatchmatchNet()
        try:
            stored = torch.load(path, map_location="cpu", weights_only=True)["model"]
            named = {name.removeprefix("module."): value for name, value in stored.items()}
            net.load_state_dict(named, strict=True)
        except (
            *(OSError, LookupError, AttributeError, TypeError, ValueError),
            *(RuntimeError, EOFError, pickle.UnpicklingError),
        ) as error:
            raise _not_a_checkpoint(path, error) from None
        return net.to(device)

    def stage(self, number: int) -> PatchMatchStage:
        """Of 3, 2 and 1, the one that works at 2^-number of the size."""
        found = self.get_submodule(f"patchmatch_{number}")
        assert isinstance(found, PatchMatchStage)
        return found

    @torch.inference_mode()
    def forward(
        self,
        images: Sequence[Tensor],
        intrinsics: Tensor,
        extrinsics: Tensor,
        depth_min: float,
        depth_max: float,
        *,
        initial: Tensor | None = None,
        bands: Bands | None = None,
    ) -> Result:
        """Depths of the first image, exactly as published: the whole image, one depth range.

        Sides that are no multiple of 8 pixels are stretched to the nearest one, and sources of another size
        than the reference are sampled as if they had its size, which is off by their ratio.

        Args:
            images: [3, H, W] each, RGB, 0 to 1, the reference first; 16 pixels on a side at least.
            intrinsics: [V, 3, 3], pixels of these images.
            extrinsics: [V, 4, 4].
            initial: [48, H / 8, W / 8], random numbers from 0 to 1; drawn if None.
        """
        device = self.upsample_net.res.weight.device
        bands = bands or Bands(device)
        height, width = images[0].shape[1:]
        resized = [_resized(image.to(device)) for image in images]
        scaled, extrinsics = intrinsics.double().cpu().clone(), extrinsics.cpu()
        for matrix, before, after in zip(scaled, images, resized, strict=True):
            matrix[0] *= after.shape[2] / before.shape[2]
            matrix[1] *= after.shape[1] / before.shape[1]
        features: dict[int, dict[int, Tensor]] = {}

        def describe(index: int) -> None:
            features[index] = self.feature(resized[index][None])

        bands.map(describe, list(range(len(resized))))
        _, full_height, full_width = resized[0].shape

        found: dict[int, list[Tensor]] = {}
        depth = view_weights = None
        last = None
        for settings in SETTINGS:
            stage = settings.stage
            reference = features[0][stage]
            shape = reference.shape[1:]
            sources = [
                _as_published(
                    features[index][stage],
                    projection(scaled[index], extrinsics[index], stage),
                    projection(scaled[0], extrinsics[0], stage),
                    shape,
                )
                for index in range(1, len(images))
            ]
            limits = InverseRange(
                *(torch.full(shape, 1 / limit, device=device) for limit in (depth_min, depth_max))
            )
            if initial is None:
                initial = torch.rand(INITIAL, *shape, device=device)
            frame = Frame(0, 0, shape[1], shape[0])
            problem = Problem(reference, sources, limits, frame)
            last = self.stage(stage)(problem, depth, view_weights, initial.to(device), bands)
            found[stage] = last.depths
            depth, view_weights = last.depths[-1], last.view_weights
            if stage == 3:
                seen = view_weights
            if stage > 1:
                depth, view_weights = doubled(depth), doubled(view_weights)
        assert last is not None and last.confidence is not None and depth is not None
        ends = (torch.full_like(depth, limit) for limit in (depth_min, depth_max))
        refined = self.upsample_net(resized[0], depth, *ends, bands)
        if (full_height, full_width) != (height, width):
            refined = F.interpolate(refined[None, None], (height, width), mode="bilinear")[0, 0]
        confidence = F.interpolate(last.confidence[None, None], (height, width), mode="nearest")[
            0, 0
        ]
        return Result(refined, confidence, found, seen)


def projection(intrinsics: Tensor, extrinsics: Tensor, stage: int) -> Tensor:
    """[4, 4] float64: pixels of a stage times depth, depth, 1 from a point in the world, 1.

    Without a shift by half a pixel: pixel i of a convolution of stride 2 is centred on pixel 2 i.
    """
    found = extrinsics.double().clone()
    scale = torch.tensor([0.5**stage, 0.5**stage, 1.0], dtype=torch.float64)
    found[:3] = scale[:, None] * intrinsics.double() @ extrinsics[:3].double()
    return found


def source_from_reference(source: Tensor, reference: Tensor) -> Tensor:
    """[3, 4] float32 of two projections, in float64 until the end: coordinates may be large (UTM)."""
    matrix: Tensor = source @ torch.linalg.inv(reference)
    return matrix[:3].float()


def _as_published(
    features: Tensor, source: Tensor, reference: Tensor, shape: Sequence[int]
) -> SourceMap:
    """Positions in a source are stretched by the ratio of its size to that of the reference."""
    height, width = shape
    ratio_x, ratio_y = (features.shape[2] - 1) / (width - 1), (features.shape[1] - 1) / (height - 1)
    stretched = source.clone()
    stretched[0] *= ratio_x
    stretched[1] *= ratio_y
    matrix = source_from_reference(stretched, reference).to(features.device)
    return SourceMap(features, matrix, (width * ratio_x, height * ratio_y))


def _resized(image: Tensor) -> Tensor:
    """To the nearest multiples of 8 pixels."""
    image = as_float(image)
    size = [STEP * round(side / STEP) for side in image.shape[1:]]
    if list(image.shape[1:]) == size:
        return image
    return F.interpolate(image[None], size, mode="bilinear", align_corners=False)[0]


def _not_a_checkpoint(path: Path | str, error: Exception) -> InputError:
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    return InputError(
        f"{path} holds no weights of PatchmatchNet ({reason}): `sirpy weights download patchmatchnet` "
        "gets them"
    )
