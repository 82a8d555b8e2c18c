"""What a new process pays before its first disparity, the kernels being cached.

Run it by ``python benchmarks/study_second_process.py``.

Numba charges three times before it runs anything of ours: its import, the registries of what it knows of NumPy, which
it fills when the first function is called, and within these the import of scipy.linalg, by which it looks for BLAS. So
an EMPTY cached function is called first, and each matcher after it: what it takes then is ours, the loading of its
kernels from the cache. Every figure is processor time, the least of several processes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

EMPTY = "from numba import njit\n\n\n@njit(cache=True)\ndef nothing(x):\n    return x\n"

CALLS = {
    "match_bm": "sc.match_bm(left, right, num_disparities=64, block_size=21, threads=1)",
    "match_sad": "sc.match_sad(left, right, num_disparities=64, block_size=9, threads=1)",
    "match_sgm": "sc.match_sgm(left, right, num_disparities=64)",
    "filter_speckles": "sc.filter_speckles(left.astype(np.int16), max_size=50, max_difference=2, no_disparity=-16)",
}

PROCESS = """
import json, sys, time
clock = time.process_time
begin = clock()
import numpy as np
numpy = clock()
import numba
imported = clock()
sys.path.insert(0, sys.argv[1])
import empty_kernel
empty_kernel.nothing(1)
registered = clock()
import stereocal as sc
left, right = np.random.default_rng(0).integers(0, 256, (2, 120, 240)).astype(np.uint8)
started = clock()
{call}
found = clock()
{call}
ran = clock() - found
print(json.dumps([numpy - begin, imported - numpy, registered - imported, found - started - ran]))
"""


def least_of(count: int, call: str, folder: str) -> list[float]:
    """Return [import of NumPy, of Numba, the empty function, the call without its work], the least of `count` runs."""
    command = [sys.executable, "-c", PROCESS.format(call=call), folder]
    subprocess.run(command, check=True, capture_output=True)  # fills the cache
    runs = [json.loads(subprocess.run(command, check=True, capture_output=True).stdout) for _ in range(count)]
    return [min(column) for column in zip(*runs, strict=True)]


def main(count: int = 8) -> None:
    """Print a table in milliseconds."""
    print(f"| {'call':15} | import numpy | import numba | an empty cached function | its own kernels |")
    print("|---|---:|---:|---:|---:|")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "empty_kernel.py").write_text(EMPTY, encoding="utf-8")
        for name, call in CALLS.items():
            numpy, numba, registries, own = (1000 * seconds for seconds in least_of(count, call, folder))
            print(f"| {name:15} | {numpy:.0f} | {numba:.0f} | {registries:.0f} | {own:.0f} |", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
