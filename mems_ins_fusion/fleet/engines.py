"""Engines that run jobs: processes on this machine, or the workers of a Dask cluster, with the same results.

An engine is a context manager with `each(function, items)`, which yields (item, result of `function`) in the order in
which items are finished, or (item, DIED) for an item whose worker ended twice.
"""
from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import wait

from ..errors import InputError

#: result of an item whose worker ended
DIED = object()
#: number of attempts for an item whose worker ends
TRIES = 2
#: environment of a worker with one thread: the other cores are used by other workers
_ONE_THREAD = dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')
#: PR_SET_PDEATHSIG of linux/prctl.h
_END_WITH_PARENT = 1
#: s, time for a worker to end by itself
PATIENCE = 0.5


class EngineError(InputError):
    """An engine that is not available; the text is one line with the reason."""


def engine(scheduler: str, workers: int):
    """The engine that `scheduler` names: 'local', or the address of a Dask scheduler."""
    if scheduler == 'local':
        return local_cluster(workers) if _has_dask() else Pool(workers)
    if '://' not in scheduler:
        raise EngineError(f"--scheduler must be local or an address such as tcp://host:8786, got '{scheduler}'")
    if not _has_dask():
        raise EngineError(f'--scheduler {scheduler}: Dask is not installed; pip install "mems_ins_fusion[fleet]"')
    return cluster(scheduler)


def _has_dask() -> bool:
    try:
        import distributed  # noqa: F401
    except ImportError:
        return False
    return True


class Pool:
    """Processes on this machine, one thread each. A process that ends is replaced, and the others continue.

    `concurrent.futures` is not used because its whole pool fails when one process ends.
    """

    def __init__(self, workers: int):
        self._size = workers
        self._context = multiprocessing.get_context('spawn')
        self._workers: list[_Worker] = []

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *exception) -> None:
        for worker in self._workers:
            worker.dismiss()
        for worker in self._workers:
            worker.end()

    def each(self, function: Callable, items: Iterable) -> Iterator[tuple]:
        left = deque((item, 1) for item in items)
        while left or any(worker.busy for worker in self._workers):
            self._give(function, left)
            for ready in wait([end for w in self._workers if w.busy for end in (w.pipe, w.process.sentinel)]):
                worker = next((w for w in self._workers if w.busy and ready in (w.pipe, w.process.sentinel)), None)
                if worker is None:  # both its pipe and its sentinel were ready, and it was handled already
                    continue
                item, tries = worker.has
                try:
                    answer = worker.take()
                except EOFError:
                    self._workers.remove(worker)
                    worker.end()
                    if tries < TRIES:
                        left.appendleft((item, tries + 1))
                        continue
                    answer = DIED
                yield item, answer

    def _give(self, function, left) -> None:
        while left and (free := self._free()) is not None:
            free.give(function, *left.popleft())

    def _free(self) -> _Worker | None:
        for worker in self._workers:
            if not worker.busy:
                return worker
        if len(self._workers) < self._size:
            self._workers.append(_Worker(self._context))
            return self._workers[-1]
        return None


class _Worker:
    """A process and its current item. has: the item and the number of the attempt."""

    def __init__(self, context):
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        with _environment_of_one_thread():
            self.process.start()
        theirs.close()
        self.has = None

    @property
    def busy(self) -> bool:
        return self.has is not None

    def give(self, function, item, tries: int) -> None:
        self.has = item, tries
        with suppress(OSError):  # it has ended, which `take` handles
            self.pipe.send((function, item))

    def take(self):
        try:
            answer = self.pipe.recv()
        except OSError:
            raise EOFError from None
        self.has = None
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def dismiss(self) -> None:
        """Let the process end, at once if it has an item, which then is not finished."""
        self.pipe.close()
        if self.has is not None:
            self.process.kill()

    def end(self) -> None:
        self.dismiss()
        self.process.join(PATIENCE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.has = None


@contextmanager
def _environment_of_one_thread() -> Iterator[None]:
    """Set the environment for child processes: NumPy reads it when it is imported."""
    former = dict(os.environ)
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(former)


def _serve(pipe) -> None:
    """Main loop of a worker, until its pipe is closed or its parent process has ended. Interruptions are for the
    parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(AttributeError, OSError):  # Linux only: elsewhere it ends after its current item
        ctypes.CDLL(None).prctl(_END_WITH_PARENT, signal.SIGKILL)
    while True:
        try:
            function, item = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            answer = function(item)
        except Exception as error:  # noqa: BLE001 raised again by who asked
            answer = error
        pipe.send(answer)


@contextmanager
def local_cluster(workers: int) -> Iterator[_Dask]:
    """Dask on this machine: a scheduler in this process, workers in processes of their own, one thread each."""
    import dask
    from distributed import Client, LocalCluster

    # attempts are counted by `_Dask`
    settings = {'distributed.scheduler.allowed-failures': 0, 'distributed.logging.distributed': 'critical',
                'distributed.nanny.pre-spawn-environ': _ONE_THREAD}
    with dask.config.set(settings):
        local = LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=':0',
                             memory_limit=None, silence_logs='CRITICAL', scheduler_kwargs={'dashboard': False})
        client = Client(local, set_as_default=False)
        patience = 30.0
        try:
            yield _Dask(client)
        except BaseException:  # after an interruption, do not wait for an orderly end
            patience = PATIENCE
            for nanny in local.workers.values():
                with suppress(Exception):
                    nanny.process.process._process.kill()
            raise
        finally:
            for end in (client, local):
                with suppress(Exception):  # workers that are late end with this process
                    end.close(timeout=patience)


@contextmanager
def cluster(address: str) -> Iterator[_Dask]:
    """The workers of the Dask scheduler at `address`. EngineError if it does not answer."""
    from distributed import Client

    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise EngineError(f'--scheduler {address}: no Dask scheduler answers ({type(error).__name__})') from None
    try:
        if not client.scheduler_info(n_workers=-1)['workers']:
            raise EngineError(f'--scheduler {address}: the scheduler has no workers; start some with: '
                              f'dask worker {address} --nthreads 1')
        yield _Dask(client)
    finally:
        with suppress(Exception):
            client.close(timeout=PATIENCE)


class _Dask:
    """`each` with the workers of a cluster.

    When a worker ends, Dask suspects all items that it had, including those that had not begun. So each of them is
    tried once more with a worker of its own, which shows whose fault it was.
    """

    def __init__(self, client):
        self._client = client

    def each(self, function: Callable, items: Iterable) -> Iterator[tuple]:
        items, suspects = list(items), []
        if items:
            yield from self._done(self._client.map(function, items, pure=False), items, suspects)
        while suspects:
            self._client.wait_for_workers(1)
            places = list(self._client.scheduler_info(n_workers=-1)['workers'])
            some, suspects = suspects[:len(places)], suspects[len(places):]
            died: list = []
            yield from self._done([self._client.submit(function, item, pure=False, workers=[place],
                                                       allow_other_workers=True)
                                   for item, place in zip(some, places)], some, died)
            yield from ((item, DIED) for item in died)

    def _done(self, futures: list, items: list, lost: list) -> Iterator[tuple]:
        """(item, result) in the order in which items are finished; items whose worker ended are added to `lost`."""
        from distributed import KilledWorker, as_completed

        left = {future.key: (future, item) for future, item in zip(futures, items)}
        for future in as_completed(futures, loop=self._client.loop):
            _, item = left.pop(future.key)
            try:
                yield item, future.result()
            except KilledWorker:
                lost.append(item)
            future.release()
