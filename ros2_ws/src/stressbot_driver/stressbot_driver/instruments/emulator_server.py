"""The emulated instrument on a TCP port, as the real one offers it for raw SCPI."""

import contextlib
import socket
import socketserver
import threading

from stressbot_driver.instruments.emulator import Emulator, Port


class EmulatorServer:
    """Serves one emulator to any number of connections, each on a thread of its own.

    `lock` is held while a message is executed; whoever else touches the emulator takes it too.
    """

    def __init__(self, emulator: Emulator, host: str = "127.0.0.1", port: int = 0) -> None:
        """Listen on `host` and `port` (0: any free one, told by `port`). Raises OSError."""
        self.lock = threading.Lock()
        self._connections: set[socket.socket] = set()
        outer = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                outer._connections.add(self.request)
                connected = Port(emulator)
                try:
                    while data := self.request.recv(65536):
                        with outer.lock:
                            answer = connected.feed(data)
                        if answer:
                            self.request.sendall(answer)
                except OSError:
                    pass  # the other side is gone
                finally:
                    outer._connections.discard(self.request)

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = True
            daemon_threads = True

        self._server = Server((host, port), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="instrument", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        return self._server.server_address[1]

    def disconnect(self) -> None:
        """Cut every connection, as a pulled cable would."""
        for connection in list(self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Stop listening and cut every connection."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
        self.disconnect()
