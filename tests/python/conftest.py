"""What several test modules share."""

from __future__ import annotations

from pathlib import Path

import pytest
from sirpy.synthetic import render_scene


@pytest.fixture(scope="session")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small synthetic scene with exact cameras: 6 photographs of 360x240 pixels."""
    folder = tmp_path_factory.mktemp("town")
    return render_scene(folder, image_count=6, size=(360, 240), camera_model="OPENCV", seed=3)
