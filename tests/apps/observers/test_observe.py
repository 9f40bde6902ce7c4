"""`rtc observe` beside a real cluster: a real scrape, and a small HTTP server as the collector of traces."""

from __future__ import annotations

import gzip
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.request import urlopen

import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from prometheus_client.parser import text_string_to_metric_families

from rtc import Client
from tests.apps.cli.in_process import call
from tests.apps.observers.conftest import RTC, until

pytestmark = [pytest.mark.slow, pytest.mark.untimed]
TRACE = "0af7651916cd43dd8448eb211c80319c"
TRACEPARENT = f"00-{TRACE}-b7ad6b7169203331-01"


@contextmanager
def collector() -> Iterator[tuple[str, list]]:
    """The URL of an OTLP/HTTP collector, and the spans it has received."""
    spans: list = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            body = gzip.decompress(body) if self.headers.get("Content-Encoding") == "gzip" else body
            if self.path == "/v1/traces":
                request = ExportTraceServiceRequest.FromString(body)
                spans.extend(s for r in request.resource_spans for scope in r.scope_spans for s in scope.spans)
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}", spans
        finally:
            server.shutdown()
            thread.join()


def scrape(url: str) -> dict[tuple[str, ...], float]:
    with urlopen(url, timeout=10) as answer:
        text = answer.read().decode()
    families = text_string_to_metric_families(text)
    return {(s.name, *s.labels.values()): s.value for family in families for s in family.samples}


def test_a_cluster_is_scraped_and_traced(watched):
    with collector() as (url, spans):
        command = [*RTC, "observe", "--prometheus", "0", "--otlp", url, "--run-dir", str(watched.run_dir)]
        with (
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as observer,
            Client(watched.run_dir) as client,
        ):
            try:
                assert observer.stdout is not None
                metrics = observer.stdout.readline().split()[-1]
                until(lambda: client.run("GRAPS MACS-NEW") and ("rtc_commands_total", "refused") in scrape(metrics))
                ended = client.run("STOW LEFT-ARM", traceparent=TRACEPARENT)
                until(lambda: scrape(metrics).get(("rtc_commands_total", "succeeded"), 0) >= 1)
                until(lambda: ("rtc_arm_moving", "LEFT-ARM") in scrape(metrics))
                until(lambda: scrape(metrics).get(("rtc_broker_up",)) == 1)
                until(lambda: any(span.name == "command" and span.trace_id.hex() == TRACE for span in list(spans)))
            finally:
                observer.terminate()
        assert observer.wait() == 0
    mine = [span for span in spans if span.trace_id.hex() == TRACE]
    root = next(span for span in mine if span.name == "command")
    about = {pair.key: pair.value.string_value for pair in root.attributes}
    assert (about["rtc.command"], about["rtc.outcome"]) == (ended.command, "succeeded")
    assert root.parent_span_id.hex() in TRACEPARENT
    step = next(span for span in mine if span.name == "step")
    assert step.parent_span_id == root.span_id
    assert {"binding", "executing", "analyzing"} <= {span.name for span in mine if span.parent_span_id == step.span_id}


def test_without_an_export_the_command_is_refused(watched):
    refused = call("observe", "--run-dir", str(watched.run_dir))
    assert refused.returncode == 2
    assert "--prometheus" in refused.stderr
