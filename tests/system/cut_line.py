"""A proxy before the line of a device, which cuts a statement in the middle, and notes when which bytes went to the device."""

import contextlib
import socket
import threading
from collections.abc import Callable

from goniotwin.protocols.clock import RealClock
from goniotwin.protocols.loopback import LOOPBACK

CHUNK = 4096


class CutLine:
    """A TCP port that leads to another one. `sent` are the bytes to the device so far, with their times, s."""

    def __init__(self, port: int) -> None:
        self.sent: list[tuple[float, bytes]] = []
        self.clock = RealClock()
        self._to = port
        self._cut: tuple[bytes, int, Callable[[], None]] | None = None
        self._listener = socket.create_server((LOOPBACK, 0))
        self.port = int(self._listener.getsockname()[1])
        self._ends: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def cut(self, statement: bytes, keep: int, then: Callable[[], None]) -> None:
        """Of the next `statement` let `keep` bytes pass and no more of that connection, then call `then`."""
        self._cut = (statement, keep, then)

    def close(self) -> None:
        """End all connections, and take no more."""
        for each in (self._listener, *self._ends):
            _end(each)
        for thread in self._threads:
            thread.join()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                device = socket.create_connection((LOOPBACK, self._to))
                self._ends += [client, device]
                for action, ends in ((self._to_device, (client, device)), (self._from_device, (device, client))):
                    self._threads.append(threading.Thread(target=action, args=ends))
                    self._threads[-1].start()

    def _to_device(self, client: socket.socket, device: socket.socket) -> None:
        with contextlib.suppress(OSError), contextlib.ExitStack() as ends:
            for each in (client, device):
                ends.callback(_end, each)
            while data := client.recv(CHUNK):
                cut = self._cut
                at = -1 if cut is None else data.find(cut[0])
                if cut is not None and at >= 0:
                    data = data[: at + cut[1]]
                if data:
                    self.sent.append((self.clock.now(), data))
                    device.sendall(data)
                if cut is not None and at >= 0:
                    self._cut = None
                    cut[2]()
                    return

    def _from_device(self, device: socket.socket, client: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := device.recv(CHUNK):
                client.sendall(data)


def _end(end: socket.socket) -> None:
    with contextlib.suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)  # wakes the thread that reads it
    end.close()
