"""Executors by name, for the command line: ``local`` or ``local:N`` (threads), ``processes:N``, ``dask:ADDRESS``.

A sweep runs on anything that is a :class:`concurrent.futures.Executor`. Threads are the default: the kernels release
Python's lock, the images are not copied, and there is nothing to start. Who outgrows a machine points it at a
``dask.distributed`` scheduler.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager

from stereocal.base.errors import InputError


@contextmanager
def open_executor(name: str = "local") -> Iterator[Executor]:
    """Open an executor by name, and close it.

    Parameters
    ----------
    name : str
        ``"local"`` (a thread a core), ``"local:N"`` (N threads), ``"processes:N"``, or ``"dask:ADDRESS"`` of a
        scheduler, such as ``"dask:tcp://10.0.0.1:8786"``.

    Yields
    ------
    Executor

    Raises
    ------
    InputError
        If the name is not known, ``distributed`` is not installed, or the scheduler does not answer.
    """
    kind, _, rest = name.partition(":")
    if kind == "dask" and rest:
        with _dask(rest) as executor:
            yield executor
        return
    if kind not in ("local", "processes") or (rest and not rest.isdigit()) or rest == "0":
        raise InputError(f"executor must be local, local:N, processes:N or dask:ADDRESS, not {name!r}")
    workers = int(rest) if rest else os.cpu_count()
    pool: Executor = ThreadPoolExecutor(workers) if kind == "local" else ProcessPoolExecutor(workers)
    with pool:
        yield pool


@contextmanager
def _dask(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            'dask:ADDRESS needs dask.distributed; install it with pip install "stereocal[dask]"'
        ) from error
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"no dask scheduler answers at {address}; start one with dask scheduler") from error
    with client, client.get_executor() as executor:
        yield executor
