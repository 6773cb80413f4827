"""`online.Online` in a process of its own, with a limited share of a core: `python -m
mems_ins_fusion.diagnosis.worker`.

Arguments: share of a core, pid of the process that uses it. Standard input, pickles: parameters and findings of earlier
drives, then chunks, each with the findings that the filter has dropped in it, or a request of the user (accept, reject,
reset). Standard output: the findings after each of these (with earlier findings, also before the first), those for the
filters, and whether it was a chunk. The work is done by a second process with low priority and one thread. The first
process stops it for the rest of each PERIOD in which it has used its share of CPU time, and ends it when its own parent
has ended. Large modules are imported only in the second process.
"""
from __future__ import annotations

import os
import pickle
import queue
import signal
import sys
import threading
import time

#: s, interval for which the share is kept: long compared with a switch between processes, short compared with usual
#: delays on the computer of a vehicle
PERIOD = 0.5
#: niceness of the process that works: a tenth of the weight of the node. With 19, a hundredth, it had 1 % of a core at
#: a load of 11 to 23 where 10 had 2 %, and the node the same latency (10.8 and 10.0 ms, median)
NICE = 10
#: s between two readings of the CPU time
STEP = 0.05


def supervise(worker: int, share: float, parent: int) -> int:
    """Let the process `worker` have `share` of a core until it ends, or the process `parent` has ended; its exit
    status."""
    def end(*_):
        os.kill(worker, signal.SIGKILL)
    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    left, used = 0.0, _seconds_of(worker)  # s of CPU time: left in this period, and used so far
    while True:
        ended, status = os.waitpid(worker, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status) & 0xFF
        if os.getppid() != parent:
            end()
        if share >= 1.0:
            time.sleep(PERIOD)
            continue
        left, over = min(left, 0.0) + share * PERIOD, time.monotonic() + PERIOD
        while left > 0.0 and (rest := over - time.monotonic()) > 0.0:
            os.kill(worker, signal.SIGCONT)
            time.sleep(min(max(left, STEP), rest))
            before, used = used, _seconds_of(worker)
            left -= used - before
        if left <= 0.0:
            os.kill(worker, signal.SIGSTOP)
        time.sleep(max(over - time.monotonic(), 0.0))


def _seconds_of(process: int) -> float:
    """CPU time of a process so far, s; 0 if it does not exist."""
    try:
        with open(f'/proc/{process}/stat') as file:
            return sum(map(int, file.read().rpartition(')')[2].split()[11:13])) / os.sysconf('SC_CLK_TCK')
    except (FileNotFoundError, ProcessLookupError):
        return 0.0


def process_chunks(source, sink) -> None:
    """Process chunks and requests from `source` and write findings to `sink`, files, until `source` ends. An analysis
    continues between chunks; only a chunk whose answer needs its result waits for it."""
    os.nice(NICE)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from .online import Abandoned, Online, findings_in_recording

    asked: queue.Queue = queue.Queue(maxsize=1)  # further input stays in the pipe

    def tell(is_chunk: bool) -> None:
        pickle.dump((online.quantities(), online.wanted, is_chunk), sink)
        sink.flush()

    def answer() -> bool:
        """Give the next answer; returns whether there may be more input."""
        one = asked.get()
        if one is None:
            return False
        is_chunk = not isinstance(one, str)
        if is_chunk:
            online.take(*one)
        else:
            getattr(online, one)()
        tell(is_chunk)
        online.advise()
        return True

    def between(*_) -> None:
        """Process the input that has arrived between two steps of an analysis. At the end of the input its result is
        not needed."""
        while not (asked.empty() or online.is_awaited or online.is_abandoned):
            if not answer():
                asked.put(None)  # ends the loop of `work`
                raise Abandoned
        if online.is_abandoned:
            raise Abandoned

    values, kept = pickle.load(source)
    online = Online(values, lambda part, given: findings_in_recording(part, given, between), kept=kept)
    if kept:
        tell(is_chunk=False)
    threading.Thread(target=_read, args=(source, asked), daemon=True).start()
    while answer():
        online.analyse()


def _read(source, asked: queue.Queue) -> None:
    """Put all of `source` into `asked`, then None."""
    try:
        while True:
            asked.put(pickle.load(source))
    except EOFError:
        asked.put(None)


def main(arguments: list[str]) -> int:
    """Work until standard input ends; the exit status."""
    share, parent = float(arguments[0]), int(arguments[1])
    worker = os.fork()
    if worker:
        sys.stdin.close()
        return supervise(worker, share, parent)
    sink = os.fdopen(os.dup(1), 'wb')
    os.dup2(2, 1)  # output of print must not mix with the pickles
    try:
        process_chunks(sys.stdin.buffer, sink)
    except BrokenPipeError:
        pass
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
