"""A TCP server on loopback, one thread for each client: the base of the control port and the USB/IP endpoint."""

import socketserver
import threading

LOOPBACK = "127.0.0.1"
WAITING_CLIENTS = 64


class LoopbackServer:
    """Listens from the beginning, serves from `start` on; every connection is a `handler`'s."""

    def __init__(self, name: str, handler: type[socketserver.BaseRequestHandler], port: int = 0) -> None:
        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True
            allow_reuse_address = True
            request_queue_size = WAITING_CLIENTS

        self._server = Server((LOOPBACK, port), handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name=name, daemon=True)

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.server_address[1])

    def start(self) -> None:
        """Serves from now on."""
        self._thread.start()

    def stop(self) -> None:
        """Takes no more clients; the port is free again. Connections that are open are their handlers' to end."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()
