"""Twin devices with a serial line, on real endpoints: pseudo-terminals with stable names, and TCP.

One thread serves them all. A device is polled when bytes arrive and when it has announced that it will have something to
send; nothing polls. Pseudo-terminals exist on Linux and macOS; on Windows there is TCP.
"""

import contextlib
import os
import selectors
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

from goniotwin.mocks.serial_ends import OWED_AT_MOST, Line, OpenEnd, PtyNames, baudrate, owed
from goniotwin.protocols.clock import RealClock
from goniotwin.protocols.loopback import listening_socket
from goniotwin.twin.devices.line import SerialDevice
from goniotwin.twin.devices.tmcm6214 import UnsolicitedReply

if sys.platform != "win32":  # POSIX alone, as pseudo-terminals are
    import tty

CHUNK = 4096
LONGEST_WAIT_S = 0.5


class SerialEndpoints:
    """Lines served by one thread. `lock` is that of the virtual rig, whose devices share one plant."""

    def __init__(self, clock: RealClock, lock: threading.RLock) -> None:
        self._clock = clock
        self._lock = lock
        self._lines: dict[str, Line] = {}
        self._names = PtyNames()
        self._selector = selectors.DefaultSelector()
        self._wake_out, self._wake_in = socket.socketpair()
        self._wake_out.setblocking(False)
        self._selector.register(self._wake_out, selectors.EVENT_READ, None)
        self._todo: deque[tuple[Callable[[], None], Future[None]]] = deque()
        self._ending = False
        self._thread = threading.Thread(target=self._serve, name="serial endpoints", daemon=True)

    def add_pty(self, name: str, device: SerialDevice, link: Path) -> Path:
        """A pseudo-terminal, found under the stable name `link`, which replaces a stale one. Raises OSError."""
        line = self._line(name, device)
        self._plug_in(line, link)
        line.links.append(link)
        return link

    def add_tcp(self, name: str, device: SerialDevice, port: int = 0) -> int:
        """A listening socket on loopback; returns its port. Any number of clients may come and go."""
        listener = listening_socket(port)
        listener.setblocking(False)
        self._selector.register(listener, selectors.EVENT_READ, self._line(name, device))
        return int(listener.getsockname()[1])

    def start(self) -> None:
        """Start serving."""
        self._thread.start()

    def stop(self) -> None:
        """Stop; release ports and names."""
        self._ending = True
        self._wake()
        if self._thread.is_alive():
            self._thread.join()
        self._names.close()
        for key in list(self._selector.get_map().values()):
            self._selector.unregister(key.fileobj)
            if isinstance(key.data, OpenEnd):
                self._close(key.data)
            elif isinstance(key.fileobj, socket.socket):
                key.fileobj.close()
        self._wake_in.close()
        self._selector.close()

    def changed(self) -> None:
        """Notify that a device may have unsolicited bytes to send."""
        self._wake()

    def unplug(self, name: str) -> None:
        """Pull a line's plug: close sockets, new ones too; remove a pseudo-terminal and its name. Raises KeyError."""
        line = self._lines[name]

        def act() -> None:
            line.plugged = False
            for link in line.links:
                self._names.take(link)
            for end in list(line.ends):
                self._detach(end)
            with self._lock:
                line.device.outbox.clear()

        self._in_turn(act)

    def replug(self, name: str) -> None:
        """Plug the line in again: a new pseudo-terminal under the same name. Raises KeyError, OSError."""
        line = self._lines[name]

        def act() -> None:
            if not line.plugged:
                for link in line.links:
                    self._plug_in(line, link)
                line.plugged = True

        self._in_turn(act)

    def _in_turn(self, act: Callable[[], None]) -> None:
        """Run `act` in the serving thread; deferred if called from that thread. Raises the errors of `act`."""
        if self._ending:
            return
        if not self._thread.is_alive():
            act()
            return
        done: Future[None] = Future()
        self._todo.append((act, done))
        if threading.current_thread() is not self._thread:
            self._wake()
            done.result()

    def _plug_in(self, line: Line, link: Path) -> None:
        master, slave = os.openpty()
        try:
            tty.setraw(slave)
            os.set_blocking(master, False)
            self._names.put(link, os.ttyname(slave))
        except OSError:
            os.close(master)
            os.close(slave)
            raise
        self._attach(OpenEnd(line, master, slave=slave))

    def _line(self, name: str, device: SerialDevice) -> Line:
        return self._lines.setdefault(name, Line(name, device))

    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            self._wake_in.send(b"\0")

    def _serve(self) -> None:
        while not self._ending:
            for key, _ in self._selector.select(self._wait_s()):
                if key.data is None:
                    with contextlib.suppress(BlockingIOError):
                        self._wake_out.recv(CHUNK)
                elif isinstance(key.data, Line):
                    self._accept(key.fileobj, key.data)
                else:
                    self._hear(key.data)
            self._send_due()
            self._do_ordered()
        self._do_ordered()

    def _do_ordered(self) -> None:
        while self._todo:
            act, done = self._todo.popleft()
            try:
                act()
            except OSError as error:
                done.set_exception(error)
            else:
                done.set_result(None)

    def _wait_s(self) -> float:
        """Time until the first device has bytes to send, s."""
        with self._lock:
            due = [line.device.outbox[0][0] for line in self._lines.values() if line.device.outbox]
        if any(end.unsent for line in self._lines.values() for end in line.ends):
            return 0.01
        left = min(due, default=float("inf")) - self._clock.now()
        return min(LONGEST_WAIT_S, max(0.0, left / self._clock.speed))

    def _accept(self, listener: object, line: Line) -> None:
        assert isinstance(listener, socket.socket)
        try:
            connection, _ = listener.accept()
        except OSError:  # it has gone again already, or no descriptor is left: the others are served all the same
            return
        if not line.plugged:
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._attach(OpenEnd(line, connection.fileno(), connection))

    def _hear(self, end: OpenEnd) -> None:
        try:
            data = end.read()
        except BlockingIOError:
            return
        except OSError:
            self._detach(end)
            return
        device = end.line.device
        if end.slave is not None and baudrate(end.slave) not in (None, device.baudrate):
            return  # at another baud rate the device hears nothing that it understands
        with self._lock:
            if owed(device) < OWED_AT_MOST:
                device.receive(data, self._clock.now())
                end.line.pty_asked |= end.slave is not None

    def _send_due(self) -> None:
        for line in self._lines.values():
            due = bytearray()
            with self._lock:
                outbox = line.device.outbox
                while outbox and outbox[0][0] <= self._clock.now():
                    due += outbox.popleft()[1]
                line.pty_asked &= bool(outbox)
            for end in list(line.ends):
                try:
                    end.write(bytes(due))
                except OSError:
                    self._detach(end)

    def _attach(self, end: OpenEnd) -> None:
        end.line.ends.append(end)
        self._selector.register(end.connection if end.connection is not None else end.descriptor, selectors.EVENT_READ, end)

    def _detach(self, end: OpenEnd) -> None:
        if end in end.line.ends:
            end.line.ends.remove(end)
            self._selector.unregister(end.connection if end.connection is not None else end.descriptor)
            self._close(end)
            self._forgive(end.line)

    def _forgive(self, line: Line) -> None:
        """Discard replies to clients that have gone, where no other client is connected."""
        if not line.pty_asked and all(end.connection is None for end in line.ends):
            with self._lock:
                unasked = [each for each in line.device.outbox if isinstance(each[1], UnsolicitedReply)]
                line.device.outbox.clear()
                line.device.outbox.extend(unasked)

    @staticmethod
    def _close(end: OpenEnd) -> None:
        if end.connection is not None:
            end.connection.close()
        else:
            os.close(end.descriptor)
        if end.slave is not None:
            os.close(end.slave)


def ptys_exist() -> bool:
    """Whether this system has pseudo-terminals."""
    return sys.platform != "win32"
