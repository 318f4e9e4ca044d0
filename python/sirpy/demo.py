"""The demonstration: a synthetic aerial scene is rendered, reconstructed, and judged by its exact ground truth."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from sirpy.files import write_json
from sirpy.html_report import report
from sirpy.pipeline import DEFAULT_MEMORY, Reconstruction, reconstruct
from sirpy.progress import Progress
from sirpy.rectangle import Grid
from sirpy.synthetic import Evaluation, evaluate, render_scene

# Photographs of a demonstration are small; cut all the same, to show what is done to large ones.
_GRID = Grid(3, 2)


@dataclass(frozen=True)
class Demonstration:
    """What `demo` made, and how true it is."""

    reconstruction: Reconstruction
    evaluation: Evaluation


def demo(
    output: Path, *, memory: int = DEFAULT_MEMORY, progress: Progress | None = None
) -> Demonstration:
    """Renders a scene into OUTPUT/scene and reconstructs it in OUTPUT with its exact cameras.

    Raises:
        SirpyError: the folder cannot be written, or the memory is too little.
    """
    scene = output / "scene"
    if not (scene / "truth.npz").exists():
        render_scene(scene, progress=progress)
    made = reconstruct(
        scene / "images",
        output,
        model=scene / "sparse",
        memory=memory,
        grid=_GRID,
        progress=progress,
    )
    evaluation = evaluate(scene, made.workspace.fused)
    run = json.loads(made.workspace.run.read_text(encoding="utf-8"))
    write_json(made.workspace.run, {**run, "evaluation": evaluation.as_json()})
    report(made.workspace)
    return Demonstration(made, evaluation)
