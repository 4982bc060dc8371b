"""The process of a worker: answers the calls that arrive on a connection. Runs as `python -m ... DESCRIPTOR PULSE STARTS NAME`."""

import os
import signal
import sys
from contextlib import suppress
from multiprocessing.connection import Connection

from drivecal.cluster import pulse
from drivecal.cluster.guard import end_with_parent
from drivecal.domain.errors import DrivecalError, describe
from drivecal.execution.processes.calls import START, RemoteAnswer, RemoteCall
from drivecal.runtime.bundles import BundleSessions
from drivecal.runtime.cache import BundleCache, cache_folder
from drivecal.runtime.worker import Worker


def main() -> int:
    """Serves calls until the other end of the connection is closed."""
    descriptor, starts, name = int(sys.argv[1]), int(sys.argv[3]), sys.argv[4]
    os.set_inheritable(descriptor, False)
    os.set_inheritable(starts, False)
    pulse.show(int(sys.argv[2]))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the coordinator ends its workers
    end_with_parent(signal.SIGKILL)
    connection = Connection(descriptor)

    def begins(cell: int) -> None:
        with suppress(OSError):  # a full disk
            os.write(starts, START.pack(call.number, cell))

    worker = Worker(name, BundleSessions(BundleCache(cache_folder()), begins=begins))
    while True:
        try:
            call: RemoteCall = connection.recv()
        except (EOFError, OSError):
            return 0  # the coordinator has closed it
        os.lseek(starts, 0, os.SEEK_SET)
        os.ftruncate(starts, 0)  # answered calls said themselves what they began
        answer = _answer(worker, call)
        if call.number:
            connection.send(answer)


def _answer(worker: Worker, call: RemoteCall) -> RemoteAnswer:
    try:
        return RemoteAnswer(call.number, getattr(worker, call.method)(*call.arguments))
    except (Exception, SystemExit) as error:  # noqa: BLE001  # whatever it is, the worker answers
        return RemoteAnswer(call.number, None, str(error) if isinstance(error, DrivecalError) else describe(error))


if __name__ == "__main__":
    sys.exit(main())
