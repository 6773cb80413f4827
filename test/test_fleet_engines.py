"""fleet: who does the work. A pool of processes, Dask on this machine and at an address; workers that are killed."""
from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fleet_support import environment
from worker_support import core_count, die, die_once, double, refuse

from mems_ins_fusion.fleet import engines


def need_dask():
    pytest.importorskip('distributed')


@pytest.fixture(params=['pool', 'dask'], scope='module')
def engine(request):
    """Two workers of each kind."""
    if request.param == 'dask':
        need_dask()
    with (engines.local_cluster(2) if request.param == 'dask' else engines.Pool(2)) as workers:
        yield workers


def test_every_item_is_done_once(engine):
    assert sorted(engine.each(double, range(20))) == [(i, 2 * i) for i in range(20)]
    assert list(engine.each(double, [])) == []


def test_a_worker_that_dies_once_costs_nothing(engine, tmp_path):
    assert list(engine.each(die_once, [str(tmp_path / 'was_here')])) == [(str(tmp_path / 'was_here'), 'done')]


def test_what_kills_its_worker_twice_is_given_up_and_the_others_are_done(engine):
    answers = dict(engine.each(die, ['a', 'die', 'b', 'c', 'd', 'e']))
    assert answers.pop('die') is engines.DIED
    assert answers == {name: name for name in 'abcde'}


def test_a_defect_in_the_work_is_not_hidden(engine):
    with pytest.raises(ValueError, match='7 is refused'):
        list(engine.each(refuse, [7]))


def test_a_worker_keeps_one_core_busy(engine):
    assert [count for _, count in engine.each(core_count, range(3))] == [1, 1, 1]


def test_a_pool_ends_with_the_block():
    with engines.Pool(2) as pool:
        list(pool.each(double, range(4)))
        processes = [worker.process for worker in pool._workers]
        assert len(processes) == 2 and all(process.is_alive() for process in processes)
    assert not any(process.is_alive() for process in processes)


def test_a_worker_ends_with_who_started_it(tmp_path):
    code = ('import sys; from worker_support import wait_for_long; from mems_ins_fusion.fleet.engines import Pool\n'
            'with Pool(1) as pool:\n    list(pool.each(wait_for_long, sys.argv[1:]))')
    parent = subprocess.Popen([sys.executable, '-c', code, str(tmp_path / 'pid')], env=environment())
    try:
        wait_until(lambda: (tmp_path / 'pid').exists() and (tmp_path / 'pid').read_text())
        worker = Path(f'/proc/{(tmp_path / "pid").read_text()}')
        assert worker.exists()
    finally:
        parent.kill()
        parent.wait()
    # in a container nobody may be there to bury it
    wait_until(lambda: not worker.exists() or ') Z ' in (worker / 'stat').read_text())


def wait_until(happened):
    until = time.monotonic() + 120
    while not happened():
        assert time.monotonic() < until
        time.sleep(0.05)


@pytest.fixture
def address():
    """A scheduler of Dask in a process of its own, with one worker in another; its address."""
    need_dask()
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        where = f'tcp://127.0.0.1:{free.getsockname()[1]}'
    dask = [sys.executable, '-m', 'dask']
    started = [subprocess.Popen([*dask, *words], env=environment(), stdout=subprocess.DEVNULL,
                                stderr=subprocess.DEVNULL) for words in (
        ['scheduler', '--host', '127.0.0.1', '--port', where.rpartition(':')[2], '--no-dashboard'],
        ['worker', where, '--nthreads', '1', '--no-dashboard'])]
    yield where
    for process in reversed(started):
        process.terminate()
    for process in started:
        process.wait(30)


def test_a_cluster_is_used_by_its_address(address):
    from distributed import Client

    with Client(address, timeout=60, set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
    with engines.engine(address, 1) as workers:
        assert sorted(workers.each(double, range(6))) == [(i, 2 * i) for i in range(6)]


def test_where_nobody_answers_is_told(monkeypatch):
    need_dask()
    import distributed

    def refused(*_, **__):
        raise OSError('nobody')

    monkeypatch.setattr(distributed, 'Client', refused)
    with pytest.raises(engines.EngineError, match='no Dask scheduler answers'):
        engines.engine('tcp://127.0.0.1:1', 1).__enter__()


def test_without_dask_a_pool_does_it_and_an_address_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    assert isinstance(engines.engine('local', 2), engines.Pool)
    with pytest.raises(engines.EngineError, match='Dask is not installed'):
        engines.engine('tcp://host:8786', 2)
