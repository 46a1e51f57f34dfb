"""TCP servers on loopback, at ports that no other program shares, and one with a thread for each client."""

import socket
import socketserver
import threading

LOOPBACK = "127.0.0.1"
WAITING_CLIENTS = 64
OWN_PORT = getattr(socket, "SO_EXCLUSIVEADDRUSE", socket.SO_REUSEADDR)
"""The option of a listening socket. On Windows SO_REUSEADDR lets another program listen at the same port and take its clients;
SO_EXCLUSIVEADDRUSE keeps it out. Elsewhere no program shares a port at which another one listens, and SO_REUSEADDR only frees
the port of a program that has ended from its last connections."""


def listening_socket(port: int = 0) -> socket.socket:
    """A socket that listens on loopback, at a free port if `port` is 0. Raises OSError."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, OWN_PORT, 1)
        listener.bind((LOOPBACK, port))
        listener.listen(WAITING_CLIENTS)
    except OSError:
        listener.close()
        raise
    return listener


class LoopbackServer:
    """Server that listens after construction and serves after `start`; a `handler` per connection."""

    def __init__(self, name: str, handler: type[socketserver.BaseRequestHandler], port: int = 0) -> None:
        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True
            request_queue_size = WAITING_CLIENTS

            def server_bind(self) -> None:
                self.socket.setsockopt(socket.SOL_SOCKET, OWN_PORT, 1)
                super().server_bind()

        self._server = Server((LOOPBACK, port), handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name=name, daemon=True)

    @property
    def port(self) -> int:
        """Port number."""
        return int(self._server.server_address[1])

    def start(self) -> None:
        """Start serving."""
        self._thread.start()

    def stop(self) -> None:
        """Accept no more clients and release the port. The handlers end open connections."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()
