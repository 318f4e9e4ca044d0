"""PatchmatchNet as a stereo backend: one pass at native resolution."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from contextlib import suppress
from threading import Lock

import torch

from sirpy.patchmatchnet.bands import Bands
from sirpy.patchmatchnet.features import STEP
from sirpy.patchmatchnet.network import PatchmatchNet
from sirpy.patchmatchnet.stage import SETTINGS
from sirpy.patchmatchnet.windows import FeatureStore, estimate
from sirpy.stereo_backend import (
    TORCH_BYTES,
    DepthMap,
    DepthRange,
    OutOfDeviceMemory,
    Prior,
    Setup,
    StereoBackend,
    View,
    torch_device,
    torch_device_bytes,
)
from sirpy.weights import weights_file

_THREAD_BYTES = 90_000_000  # a band of rows, or a tile whose features are found
# Per pixel of the reference: hypotheses and costs of the last stage 40, features 16, the image 6, depths and ranges;
# of a source window: features of the last stage 16, weight 1.
_PIXEL_BYTES = 75, 17


class PatchmatchNetBackend(StereoBackend):
    """The published network, its weights read at the first use."""

    step: int = STEP
    halo: int = 64  # 99.8 % of the depths are within 0.1 % of those of a whole photograph
    loaded_bytes: int = TORCH_BYTES
    cpu_us: tuple[float, float] = (3.5, 0.35)
    # What lies farther away has no say, but for what offsets the network has learned.
    margin: int = sum(one.reach << one.stage for one in SETTINGS) + 16

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._device = torch_device(setup.options.device)
        self._bands = Bands(self._device, setup.options.threads)
        self._weights = weights_file("patchmatchnet")
        self._loading = Lock()
        self._loaded: tuple[PatchmatchNet, FeatureStore] | None = None

    @property
    def device(self) -> str:
        return str(self._device)

    @property
    def device_bytes(self) -> int | None:
        return torch_device_bytes(self._device)

    @property
    def reads_ahead(self) -> bool:
        return self._device.type != "cpu"

    @property
    def title(self) -> str:
        return f"PatchmatchNet, {self.device}"

    def memory(self, reference_pixels: int, source_pixels: int) -> int:
        # On a GPU a band is large: what is sampled, its products, and the layers on them.
        of_bands = (
            _THREAD_BYTES * self._bands.threads
            if self._device.type == "cpu"
            else 4 * self._bands.most_bytes
        )
        return of_bands + _PIXEL_BYTES[0] * reference_pixels + _PIXEL_BYTES[1] * source_pixels

    def prepare(self, reference: View, sources: Sequence[View]) -> None:
        _, features = self._network()
        with suppress(torch.OutOfMemoryError):  # the estimate will say so
            features.find([reference, *sources])

    def estimate(
        self, reference: View, sources: Sequence[View], depth_range: DepthRange, prior: Prior
    ) -> DepthMap:
        net, features = self._network()
        seed = zlib.crc32(f"{self._setup.options.seed} {reference.name}".encode())
        try:
            return estimate(net, features, reference, sources, depth_range, seed, self._bands)
        except torch.OutOfMemoryError:
            raise OutOfDeviceMemory from None

    def _network(self) -> tuple[PatchmatchNet, FeatureStore]:
        with self._loading:  # the next window may be prepared meanwhile
            if self._loaded is None:
                assert self._setup.scratch is not None
                net = PatchmatchNet.from_checkpoint(self._weights, self._device)
                folder = self._setup.scratch / "patchmatchnet"
                half = self._device.type != "cpu"
                self._loaded = net, FeatureStore(net, folder, self._bands, half)
            return self._loaded


def patchmatchnet(setup: Setup) -> StereoBackend:
    """PatchmatchNet (Wang et al., CVPR 2021) with its published weights.

    Raises:
        InputError: the weights are not there, or the device is not.
    """
    return PatchmatchNetBackend(setup)
