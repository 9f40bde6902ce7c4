"""The HTTP server of the metrics. Its connections are few and short, whatever a client sends or leaves out.

A connection that is silent for SILENCE_S is closed. If one more than MAX_OPEN are open, the oldest is closed: a scrape
takes some milliseconds, a half-open request stays.
"""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from prometheus_client import CollectorRegistry, make_wsgi_app

SILENCE_S = 5.0
MAX_OPEN = 16  # open connections, each with a thread


class _Handler(WSGIRequestHandler):
    timeout = SILENCE_S  # of one read; see socketserver.StreamRequestHandler

    def log_message(self, *_: Any) -> None:
        pass


class ScrapeServer(ThreadingMixIn, WSGIServer):
    """Answers scrapes in threads of its own until `close`. `port` 0: a free one, then in `server_port`.

    Raises OSError for a port in use.
    """

    daemon_threads = True
    request_queue_size = 64  # connections that wait to be accepted

    def __init__(self, registry: CollectorRegistry, host: str, port: int) -> None:
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._open: dict[socket.socket, None] = {}  # the oldest first
        self._lock = threading.Lock()
        super().__init__((host, port), _Handler)
        self.set_app(make_wsgi_app(registry))
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def close(self) -> None:
        self.shutdown()
        self.server_close()

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._lock:
            self._open[request] = None
            oldest = next(iter(self._open)) if len(self._open) > MAX_OPEN else None
            if oldest is not None:
                del self._open[oldest]
                with suppress(OSError):  # its thread has just closed it
                    oldest.shutdown(socket.SHUT_RDWR)  # its thread reads the end, and ends
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self._lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing: a client that goes or stays silent is no error of the server."""
