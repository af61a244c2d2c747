"""Tasks on a Dask cluster that is there already."""

import asyncio
import logging
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from virtual_sensor.errors import InputError

_PATIENCE_S = 10.0  # until a scheduler must have answered
_FIRST_WORKER_S = 60.0


def completed(scheduler: str, tasks: Sequence[Any]) -> Iterator[tuple[str, Any]]:
    """Run Dask's delayed tasks; give key and result of each, as they come.

    The result is None where the task's workers were lost, one after the other.  A single lost
    worker's tasks are run by the others.

    Raises
    ------
    InputError
        If there is no such scheduler, it has no workers, they lack a package, or it is lost.
    """
    with _client(scheduler) as client:
        from distributed import KilledWorker, as_completed

        try:
            client.wait_for_workers(1, timeout=_FIRST_WORKER_S)
        except TimeoutError:
            raise InputError(
                f"--scheduler {scheduler}: has no workers; start some with"
                f" `dask worker {scheduler} --nthreads 1`"
            ) from None
        for future in as_completed(client.compute(list(tasks))):
            try:
                result = future.result()
            except KilledWorker:
                result = None
            except (CancelledError, OSError) as error:
                raise InputError(
                    f"--scheduler {scheduler}: was lost ({error!r}); finished cases stay, and"
                    " the same command goes on"
                ) from None
            except ImportError as error:
                raise InputError(
                    f"--scheduler {scheduler}: a worker lacks a package ({error}); install"
                    " virtual-sensor where the workers run"
                ) from None
            yield future.key, result


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    """A connection to a cluster that is there already."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--scheduler needs Dask's cluster: pip install 'virtual-sensor[cluster]'"
        ) from None
    try:
        with ThreadPoolExecutor(1) as aside:  # a notebook's thread has a loop of its own
            aside.submit(asyncio.run, _answers(scheduler)).result()
        client = Client(scheduler, timeout=_PATIENCE_S)
    except (OSError, ValueError, MemoryError) as error:  # the last by a web server's answer
        said = str(error) or f"nothing was said within {_PATIENCE_S:g} s"
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({said}); start one with"
            " `dask scheduler`, and give the address that it prints"
        ) from None
    # It logs a traceback when a scheduler is lost, which is an error of one line here.
    for name in ("distributed.client", "distributed.utils"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with client:
        yield client


async def _answers(scheduler: str) -> None:
    """Ask for Dask's greeting: a client would wait for ever for that of any other server."""
    from distributed.comm import connect

    comm = await asyncio.wait_for(connect(scheduler, timeout=_PATIENCE_S), _PATIENCE_S)
    comm.abort()
