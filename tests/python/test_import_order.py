"""pycolmap, zlib and our own Ceres live in one process in every order of import.

Some wheels of pycolmap (4.1.0 to 4.2.1) corrupt the heap of a process that compresses after
importing them; the range of versions in pyproject.toml leaves them out, and this is what notices
when it no longer does. pycolmap has a Ceres and a glog inside, of other versions than those that bundle
adjustment links to.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import pytest

IMPORTS = {
    "pycolmap": "import pycolmap",
    "zlib": "import zlib",
    "rasterio": "import rasterio",
    "sirpy": "import sirpy.sparse_model",
    "adjustment": "import sirpy._adjustment",
}
WORK = """
import sys, warnings, zlib
import numpy as np, pycolmap, rasterio
warnings.simplefilter("ignore")
data = np.random.default_rng(0).integers(0, 255, (3, 400, 400), dtype=np.uint8)
for level in (1, 6, 9):
    assert zlib.decompress(zlib.compress(data.tobytes(), level)) == data.tobytes()
for driver, options in (("PNG", {}), ("GTiff", {"compress": "deflate"})):
    path = sys.argv[1] + "." + driver
    profile = dict(driver=driver, width=400, height=400, count=3, dtype="uint8", **options)
    with rasterio.open(path, "w", **profile) as target:
        target.write(data)
    with rasterio.open(path) as source:
        assert (source.read() == data).all()
assert len(pycolmap.Camera.create_from_model_name(1, "OPENCV", 1.0, 2, 2).params) == 8
print("sound")
"""


ADJUST = """
import numpy as np, pycolmap
from sirpy.bundle_adjustment import bundle_adjust
options = pycolmap.SyntheticDatasetOptions()
options.num_points3D = 60
model = pycolmap.synthesize_dataset(options)
known = {i: np.tile(np.eye(2), (one.num_points2D(), 1, 1)) for i, one in model.images.items()}
bundle_adjust(model, known)
pycolmap.bundle_adjustment(model, pycolmap.BundleAdjustmentOptions(print_summary=False))
assert bundle_adjust(model, known).sigma0 < 1e-3
print("sound")
"""

ORDERS = [
    *itertools.permutations(("pycolmap", "zlib")),
    *itertools.permutations(("pycolmap", "rasterio")),
    ("sirpy", "zlib", "pycolmap"),
    ("zlib", "sirpy"),
    ("pycolmap", "sirpy", "zlib"),
]


@pytest.mark.parametrize("order", ORDERS, ids="-".join)
def test_compression_works_after_imports_in_this_order(
    order: tuple[str, ...], tmp_path: Path
) -> None:
    program = "\n".join(IMPORTS[name] for name in order) + WORK
    # A corrupt heap may hang in the abort handler: run() kills with SIGKILL at the time limit.
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "image")],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout) == (0, "sound\n"), done.stderr


@pytest.mark.parametrize(
    "order", [*itertools.permutations(("pycolmap", "adjustment", "sirpy"))], ids="-".join
)
def test_both_kinds_of_ceres_work_after_imports_in_this_order(order: tuple[str, ...]) -> None:
    program = "\n".join(IMPORTS[name] for name in order) + ADJUST
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout) == (0, "sound\n"), done.stderr
