"""A TCP server on loopback, one thread for each client: the base of the channel and of the USB/IP endpoint."""

import socketserver
import threading

LOOPBACK = "127.0.0.1"
WAITING_CLIENTS = 64


class LoopbackServer:
    """Server that listens after construction and serves after `start`; a `handler` per connection."""

    def __init__(self, name: str, handler: type[socketserver.BaseRequestHandler], port: int = 0) -> None:
        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True
            allow_reuse_address = True
            request_queue_size = WAITING_CLIENTS

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
