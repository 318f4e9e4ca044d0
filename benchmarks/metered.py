"""What a command costs, all its processes together: one JSON line.

    python benchmarks/metered.py COMMAND...

The meter is a process of its own, so that nothing but the command and 8 MB of Python is counted. What the command
prints goes to standard error.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from typing import TypedDict

from sirpy.resources import Meter


class Cost(TypedDict):
    status: int
    wall_s: float
    cpu_s: float
    peak_gb: float


def main() -> None:
    with Meter() as meter:
        status = subprocess.run(sys.argv[1:], check=False, stdout=sys.stderr).returncode
    # The kernel knows the peak of the largest single process, which falls between two samples when short.
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    cost: Cost = {
        "status": status,
        "wall_s": round(meter.wall_s, 2),
        "cpu_s": round(meter.cpu_s, 2),
        "peak_gb": round(max(meter.peak_bytes or 0, largest) / 1e9, 3),
    }
    print(json.dumps(cost))


def measured(*words: object) -> Cost:
    """Runs a command; what it prints goes to standard error."""
    command = [sys.executable, __file__, *map(str, words)]
    printed = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    cost: Cost = json.loads(printed)
    return cost


def run_sirpy(*words: object) -> Cost:
    """Runs `sirpy WORDS` as a user would. Ends the program where the command fails.

    What makes a model of photographs may end with status 2 and have a result all the same, without some of them.
    """
    cost = measured(sys.executable, "-m", "sirpy", *words)
    if cost["status"] not in ((0, 2) if words[0] in ("reconstruct", "sfm") else (0,)):
        sys.exit(f"sirpy {words[0]} ended with status {cost['status']}")
    return cost


if __name__ == "__main__":
    main()
