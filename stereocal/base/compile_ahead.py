"""Kernels compiled by a second process while this one has other work: the first run on a machine waits half as long.

Numba compiles a kernel when it is first called, which takes seconds, and keeps the outcome on the disk. It compiles one
at a time: threads queue at its lock. A process of its own has a lock of its own. So where kernels that will be needed
soon are not on the disk yet, a second Python is started that compiles them there, and this one goes on, compiling other
kernels if need be. Before such a kernel is called, :func:`wait_for` sees to it that the other process is through.

Nothing depends on it. If no process can be started, or it fails, a kernel is compiled when it is called, as ever. On
one processor it would gain nothing and is not tried. The variable ``STEREOCAL_COMPILE_AHEAD=0`` turns it off.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

VARIABLE = "STEREOCAL_COMPILE_AHEAD"
# Longer than kernels take on a machine that is worth calibrating on; then this process compiles them itself.
_PATIENCE = 120.0

_processes: list[tuple[subprocess.Popen[bytes], tuple[Any, ...]]] = []
_asked: set[str] = set()
_lock = threading.Lock()


def compile_ahead(call: str, *kernels: Any) -> bool:
    """Run ``module:function(arguments)`` in a process of its own, unless all its kernels have been compiled before.

    Asks once for each `call`; later ones return at once.

    Parameters
    ----------
    call : str
        What makes the kernels compile: a module of this library, a colon, and a call of a function in it.
    *kernels : numba dispatchers
        Those that it compiles. If another process is at one of them, none is started.

    Returns
    -------
    bool
        Whether a process was started.
    """
    with _lock:  # photographs are searched by several threads
        if call in _asked:
            return False
        _asked.add(call)
    turned_off = os.environ.get(VARIABLE) == "0" or _processors() < 2
    if turned_off or any(map(is_under_way, kernels)) or all(map(has_compiled, kernels)):
        return False
    module, expression = call.split(":", 1)
    program = f"import {module} as module; module.{expression}"
    environment = os.environ | {VARIABLE: "0", "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", program], env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )  # fmt: skip
    except (OSError, ValueError):  # no Python of its own (embedded, sandboxed): the kernels compile when called
        return False
    _processes.append((process, kernels))
    return True


def is_under_way(kernel: Any) -> bool:
    """Whether another process is compiling a kernel."""
    return any(kernel in kernels and process.poll() is None for process, kernels in _processes)


def wait_for(kernel: Any) -> None:
    """Wait for the process that compiles a kernel, if there is one."""
    for process, kernels in _processes:
        if kernel in kernels and process.returncode is None:
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def has_compiled(kernel: Any) -> bool:
    """Whether a kernel has been compiled, for whatever arguments: in this process, or in an earlier one on the disk."""
    if kernel.signatures:
        return True
    folder, function = kernel.stats.cache_path, kernel.py_func
    if folder is None:
        return True  # it cannot be kept, so that another process is no help
    pattern = f"*.{function.__qualname__}-{function.__code__.co_firstlineno}.*.nbi"
    return any(Path(folder).glob(pattern))


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
