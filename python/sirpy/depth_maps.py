"""The depth maps of a workspace, ours or COLMAP's, and what belongs to them: read by windows.

No map has to be held; the page cache of the system keeps what is read again.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.errors import InputError
from sirpy.files import file_identity
from sirpy.native_images import LeftOut, NativeImage, SubImage
from sirpy.native_scene import Floats
from sirpy.rectangle import Rectangle
from sirpy.windows import FloatMap, open_map, read_map_window
from sirpy.workspace import Pass, Workspace


class DepthMaps:
    """The maps that are there and sound.

    Attributes:
        natives: by name, with the sub-images that have a depth map.
        left_out: sub-images that have none, or a damaged one, and why.
        unused: what is said of damaged maps of normals and confidence.
    """

    def __init__(self, workspace: Workspace) -> None:
        """Raises InputError where there is no sound depth map at all."""
        self._workspace = workspace
        self._pass = _pass_of(workspace)
        self.natives: dict[str, NativeImage] = {}
        self.left_out: list[LeftOut] = []
        self.unused: list[str] = []
        self._normals: set[str] = set()  # sub-images that have a map of them
        self._confidences: set[str] = set()
        self._sigmas: set[str] = set()
        for native in workspace.natives:
            sound = tuple(sub for sub in native.sub_images if self._is_sound(sub))
            if sound:
                self.natives[native.name] = replace(native, sub_images=sound)
                for sub in sound:
                    self._look_for(self._normals, sub, workspace.normal_map(sub, self._pass), 3)
                    self._look_for(self._confidences, sub, workspace.confidence_map(sub), 1)
                    self._look_for(self._sigmas, sub, workspace.sigma_map(sub), 1)
        # Sure and unsure depths can be told apart where all of them say how sure they are.
        self.has_sigma = all(
            sub.name in self._sigmas
            for native in self.natives.values()
            for sub in native.sub_images
        )
        if not self.natives:
            reason = f": {self.left_out[0].reason}" if self.left_out else ""
            raise InputError(
                f"{workspace.folder} has no depth map that can be used{reason}; run `sirpy stereo` first"
            )

    def identity(self) -> list[tuple[str, int, int]]:
        """What changes when a map does."""
        found = []
        for native in self.natives.values():
            for sub in native.sub_images:
                found.append(file_identity(self._workspace.depth_map(sub, self._pass)))
                if sub.name in self._normals:
                    found.append(file_identity(self._workspace.normal_map(sub, self._pass)))
                if self.has_sigma:
                    found.append(file_identity(self._workspace.sigma_map(sub)))
                if sub.name in self._confidences:
                    found.append(file_identity(self._workspace.confidence_map(sub)))
        return found

    def depth(self, name: str, window: Rectangle) -> FloatMap:
        """(height, width) of a window of a native image; 0 where no map holds any."""
        return read_map_window(self._workspace, self.natives[name], window, "depth", self._pass)

    def sigma(self, name: str, window: Rectangle) -> FloatMap | None:
        """Standard deviations of the depths, (height, width); None where stereo has not given all of them."""
        if not self.has_sigma:
            return None
        return read_map_window(self._workspace, self.natives[name], window, "sigma")

    def level(self, name: str, window: Rectangle) -> npt.NDArray[np.uint8] | None:
        """Levels of the pyramid that the depths come from, (height, width); None without sigma."""
        if not self.has_sigma:
            return None
        level = read_map_window(self._workspace, self.natives[name], window, "level")
        return level.astype(np.uint8)

    def normal(
        self, name: str, sub_image: SubImage, window: Rectangle, intrinsics: Floats, threads: int
    ) -> FloatMap:
        """(3, height, width), camera frame, of a window of a sub-image's core; made from the depths where it
        has no map of them."""
        native = self.natives[name]
        if sub_image.name in self._normals:
            return read_map_window(self._workspace, native, window, "normal", self._pass)
        around = window.padded(_core.NORMAL_REACH)
        seen = around.intersection(native.rectangle)
        depth = np.zeros((around.height, around.width), np.float32)
        depth[seen.slices_in(around)] = self.depth(name, seen)
        return _core.normals_of_depth(
            depth, intrinsics=intrinsics, x0=window.x0, y0=window.y0, threads=threads
        )

    def confidence(self, name: str, sub_image: SubImage, window: Rectangle) -> FloatMap | None:
        """(height, width) of a window of a sub-image's core, 0 to 1; None where stereo has given none."""
        if sub_image.name not in self._confidences:
            return None
        return read_map_window(self._workspace, self.natives[name], window, "confidence")

    def _look_for(self, found: set[str], sub_image: SubImage, path: Path, channels: int) -> None:
        if not path.exists():
            return
        try:
            open_map(path, sub_image.stored, channels)
        except InputError as error:
            self.unused.append(str(error))
        else:
            found.add(sub_image.name)

    def _is_sound(self, sub_image: SubImage) -> bool:
        try:
            open_map(self._workspace.depth_map(sub_image, self._pass), sub_image.stored)
        except InputError as error:
            self.left_out.append(LeftOut(sub_image.name, str(error)))
            return False
        return True


def _pass_of(workspace: Workspace) -> Pass:
    """COLMAP makes photometric maps alone where its user does not ask for more."""
    of_geometric = (workspace.depth_map(sub, "geometric") for _, sub in workspace.sub_images())
    of_photometric = (workspace.depth_map(sub, "photometric") for _, sub in workspace.sub_images())
    if not any(path.exists() for path in of_geometric) and any(
        path.exists() for path in of_photometric
    ):
        return "photometric"
    return "geometric"
