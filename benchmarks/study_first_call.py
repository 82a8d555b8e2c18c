"""What the first call after an installation costs, compilation included, and what it costs in every later process.

    python benchmarks/study_first_call.py [runs]

Each call is made in a fresh process whose folder of compiled kernels is empty; then in another one that finds them
there. Wall time of the call alone, without the import of stereocal (milliseconds), with that of Numba, which the first
call brings. "One process" is with STEREOCAL_COMPILE_AHEAD=0, as on a machine with one processor; see
``stereocal.base.compile_ahead``. The least of the runs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile

PREPARE = """
import json, time
import numpy as np, stereocal as sc
board = sc.Chessboard((9, 6))
camera = sc.Camera([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]], [-0.2, 0.05, 0, 0, 0], (640, 480))
tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.4, 0.1), (0.1, -0.4, 0), (0.3, 0.3, 0.2), (-0.3, 0.3, 0)]
X = board.object_points
left = [camera.project(X, tilt, [-4, -2.5, 14]) for tilt in tilts]
right = [camera.project(X, tilt, [-5, -2.5, 14]) for tilt in tilts]
dark = np.add.outer(np.arange(7), np.arange(10)) % 2
image = np.pad(np.kron(230 - 200 * dark, np.ones((30, 30))), 60, constant_values=230).astype(np.uint8)
begin = time.perf_counter()
{call}
print(json.dumps(time.perf_counter() - begin))
"""

CALLS = {
    "calibrate_camera": "sc.calibrate_camera(X, left, camera.image_size)",
    "calibrate_stereo": "sc.calibrate_stereo(X, left, right, camera.image_size)",
    "detect_chessboard": "sc.detect_chessboard(image, board)",
}


def seconds(call: str, folder: str, *, ahead: bool) -> float:
    """Return the wall time of a call in a process of its own, its kernels kept in `folder`."""
    environment = os.environ | {"NUMBA_CACHE_DIR": folder}
    environment["STEREOCAL_COMPILE_AHEAD"] = "1" if ahead else "0"
    command = [sys.executable, "-c", PREPARE.format(call=call)]
    return float(json.loads(subprocess.run(command, env=environment, check=True, capture_output=True).stdout))


def main(count: int = 3) -> None:
    """Print a table in seconds."""
    print("| first call of | first process | first process, one processor | later processes |")
    print("|---|---:|---:|---:|")
    for name, call in CALLS.items():
        runs = []
        for _ in range(count):
            with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
                first = seconds(call, one, ahead=True)
                runs.append((first, seconds(call, other, ahead=False), seconds(call, one, ahead=True)))
        print(
            f"| {name} | " + " | ".join(f"{min(column):.2f}" for column in zip(*runs, strict=True)) + " |", flush=True
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
