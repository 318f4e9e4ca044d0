"""A cut workspace for the tests of what other engines read, and what its cameras must say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray
from sirpy.cut_tasks import PixelOptions
from sirpy.cutting import cut
from sirpy.native_scene import NativeCamera, NativeScene, Observations, read_native_scene
from sirpy.progress import Progress
from sirpy.rectangle import Grid
from sirpy.windows import write_map
from sirpy.workspace import Workspace


class Notes(Progress):
    """What a user would be told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


def cut_town(town: Path, output: Path, same_size: int = 0, masks: Path | None = None) -> Workspace:
    """The 6 photographs of `town` in 3 x 2 sub-images each, off centre and with overlap."""
    return cut(
        town / "images",
        town / "sparse",
        output,
        grid=Grid(3, 2),
        overlap=8,
        same_size=same_size,
        masks=masks,
        pixels=PixelOptions(format="jpg"),
    )


def expected_pixels(workspace: Workspace) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Of each sub-image, in order: the sparse points it must show, (n, 3), and where, (n, 2).

    pycolmap projects with the whole native camera; the origin of the rectangle is taken off. COLMAP's
    coordinates.
    """
    model = pycolmap.Reconstruction(workspace.native_model)
    images = {model.image(i).name: model.image(i) for i in model.reg_image_ids()}
    world = np.array([model.point3D(i).xyz for i in sorted(model.point3D_ids())])
    found = []
    for native, sub in workspace.sub_images():
        image = images[native.name]
        pixels = np.array([image.project_point(xyz) for xyz in world])
        pixels -= [sub.stored.x0, sub.stored.y0]
        inside = ((pixels >= 0) & (pixels < [sub.stored.width, sub.stored.height])).all(axis=1)
        found.append((world[inside], pixels[inside]))
    return found


def assert_numbered_images_are(workspace: Workspace, paths: list[Path]) -> None:
    """`paths`, by number, hold the bytes of the sub-images in their order."""
    for (_, sub), path in zip(workspace.sub_images(), paths, strict=True):
        assert path.read_bytes() == workspace.image(sub).read_bytes()


def write_plane_maps(workspace: Workspace, stereo: Path, names: list[str]) -> None:
    """COLMAP's depth and normal maps of the plane z = 0, exact at pixel centres, under the names."""
    scene = read_native_scene(workspace)
    for (native, sub), name in zip(workspace.sub_images(), names, strict=True):
        camera = scene.cameras[native.name]
        x0, y0, width, height = sub.stored.as_list()
        y, x = np.mgrid[y0 : y0 + height, x0 : x0 + width]
        pixels = np.column_stack([x.ravel() + 0.5, y.ravel() + 0.5])
        rays = camera.world(pixels, np.ones(len(pixels))) - camera.centre
        depth = (-camera.centre[2] / rays[:, 2]).reshape(height, width)
        normal = camera.cam_from_world[:, 2][:, None, None] * np.ones((1, height, width))
        for kind, planes in (("depth", depth), ("normal", normal)):
            path = stereo / f"{kind}_maps" / f"{name}.geometric.bin"
            write_map(path, np.ascontiguousarray(planes, np.float32))


def without_points(scene: NativeScene, name: str, x_range: tuple[float, float]) -> NativeScene:
    """The scene in which one native image sees no points at x in the range."""
    seen = scene.observations[name]
    x = seen.pixel[:, 0]
    keep = (x < x_range[0]) | (x >= x_range[1])
    observations = dict(scene.observations)
    observations[name] = Observations(seen.point[keep], seen.pixel[keep], seen.depth[keep])
    return NativeScene(scene.cameras, scene.points, observations)


def moved(scene: NativeScene, shift: NDArray[np.float64]) -> NativeScene:
    """The scene in a world frame whose origin lies at -shift."""
    cameras = {
        name: NativeCamera(
            name,
            camera.width,
            camera.height,
            camera.intrinsics,
            np.column_stack(
                [
                    camera.cam_from_world[:, :3],
                    camera.cam_from_world[:, 3] - camera.cam_from_world[:, :3] @ shift,
                ]
            ),
        )
        for name, camera in scene.cameras.items()
    }
    return NativeScene(cameras, scene.points + shift, scene.observations)
