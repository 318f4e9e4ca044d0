"""A plan as tables on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from sirpy.memory import gigabytes
from sirpy.planning import Plan, StagePlan
from sirpy.progress import duration


def print_plan(plan: Plan, memory: int, console: Console | None = None) -> None:
    """Prints what will be written and what each stage will need, beside the budget (bytes)."""
    console = console or Console(highlight=False)
    console.print(_written(plan))
    console.print(_stages(plan))
    console.print(
        f"Peak {gigabytes(plan.peak)} of {gigabytes(memory)}. Times and sizes on disk are estimates."
    )
    for note in plan.notes:
        console.print(note, markup=False)


def _written(plan: Plan) -> Table:
    table = Table(title="Written", title_justify="left", show_header=False)
    mean, largest = plan.source_megapixels
    for name, value in (
        ("grid", f"{plan.grid} sub-images of each photograph"),
        ("photographs", f"{plan.photographs:,}, {plan.megapixels:,.1f} megapixels of them"),
        (
            "sub-images",
            f"{plan.sub_images:,} of at most {plan.largest[0]} x {plan.largest[1]} pixels",
        ),
        ("source windows", f"{mean:.1f} megapixels for a sub-image, {largest:.1f} at most"),
        ("files", f"about {plan.files:,}, {gigabytes(plan.written_bytes)}"),
    ):
        table.add_row(name, value)
    return table


def _stages(plan: Plan) -> Table:
    table = Table(title="Stages", title_justify="left")
    table.add_column("stage")
    for name in ("units", "bytes per pixel + of sources", "peak", "CPU time", "wall time"):
        table.add_column(name, justify="right")
    for stage in plan.stages:
        table.add_row(
            stage.name,
            f"{stage.units:,} {stage.unit}{'' if stage.units == 1 else 's'}",
            _bytes_per_pixel(stage),
            gigabytes(stage.peak),
            duration(stage.cpu_s),
            duration(stage.wall_s),
        )
    return table


def _bytes_per_pixel(stage: StagePlan) -> str:
    if stage.bytes_per_pixel is None:
        return "-"
    return f"{stage.bytes_per_pixel[0]} + {stage.bytes_per_pixel[1]}"
