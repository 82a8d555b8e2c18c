"""The same benchmarks in another Python, with its own OpenCV: "is 5.0 slower than 4.14 here?" in one table.

OpenCV cannot be loaded twice into one process, so the other environment runs a process of its own, which waits. The two
talk by lines of JSON over its standard input and output, one case at a time, so that the environments take turns, as
the functions do within a case::

    → {"kernels": ["match_bm"], "seconds": 0.7}      ← {"opencv": "4.14.0", "cases": [["match_bm", "640x480, …"], …]}
    → {"run": 0}                                     ← {"result": {…}}   or {"error": "…"}

The other Python needs stereocal and OpenCV installed; what is not about the same case is left out.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable
from typing import Any

from stereocal.base.errors import InputError
from stereocal.verify.bench import BenchCase, BenchResult, all_cases, run_case

_PROGRAM = "from stereocal.verify.benchmark_worker import serve; serve()"


class OtherEnvironment:
    """A Python with another OpenCV that runs the same cases.

    Parameters
    ----------
    python : str
        Its interpreter.
    kernels : iterable of str
        As for :func:`~stereocal.verify.bench.all_cases`.
    seconds : float
        About how long to measure each case.

    Raises
    ------
    InputError
        If it cannot be started, or lacks stereocal or OpenCV.
    """

    def __init__(self, python: str, kernels: Iterable[str] = (), seconds: float = 0.7) -> None:
        self.python = python
        try:
            pipe = subprocess.PIPE
            self._process = subprocess.Popen([python, "-c", _PROGRAM], stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        except OSError as error:
            raise InputError(f"{python} cannot be started ({error.strerror}); name a Python interpreter") from error
        answer = self._ask({"kernels": list(kernels), "seconds": seconds})
        self.opencv_version: str = answer["opencv"]
        self._place = {(kernel, case): index for index, (kernel, case) in enumerate(answer["cases"])}

    def run(self, case: BenchCase) -> BenchResult | None:
        """Run a case there; None if it has none of that name."""
        index = self._place.get((case.kernel, case.case))
        return None if index is None else BenchResult(**self._ask({"run": index})["result"])

    def close(self) -> None:
        """End the process."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def __enter__(self) -> OtherEnvironment:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
            answer = json.loads(line) if line else None
        except (OSError, ValueError):
            answer = None
        if not isinstance(answer, dict):
            self._process.kill()
            said = [line for line in self._process.stderr.read().splitlines() if line.strip()]
            raise InputError(f"{self.python} cannot run the benchmarks: {said[-1] if said else 'it ended'}")
        if "error" in answer:
            raise InputError(f"{self.python}: {answer['error']}")
        return answer


def serve() -> None:
    """Answer requests on standard input until it ends."""
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)  # what a library prints must not come between the answers
        cases: list[BenchCase] = []
        seconds = 0.7
        for line in sys.stdin:
            request = json.loads(line)
            try:
                if "run" in request:
                    answer: dict[str, Any] = {"result": run_case(cases[request["run"]], seconds=seconds).as_dict()}
                else:
                    import cv2

                    cases, seconds = all_cases(request["kernels"]), request["seconds"]
                    answer = {"opencv": cv2.__version__, "cases": [[case.kernel, case.case] for case in cases]}
            except (InputError, ImportError) as error:
                answer = {"error": str(error)}
            answers.write(json.dumps(answer) + "\n")
            answers.flush()
