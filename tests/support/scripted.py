"""A client and a server that gives the answers of a script."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from drivecal.client import Client
from drivecal.contracts.campaign import Campaign

Answer = tuple[int, dict[str, str], bytes]
"""Status, headers, body."""


@dataclass
class Script:
    """The answers to give, one after the other, and the requests that came."""

    answers: list[Answer]
    requests: list[tuple[str, str, dict[str, str], bytes]] = field(default_factory=list)


@contextmanager
def server(*answers: Answer) -> Iterator[tuple[Client, Script]]:
    script = Script(list(answers))

    class Handler(BaseHTTPRequestHandler):
        def reply(self) -> None:
            body = self.rfile.read(int(self.headers.get("content-length", 0)))
            headers = {name.lower(): value for name, value in self.headers.items()}
            script.requests.append((self.command, self.path, headers, body))
            status, wanted, content = script.answers.pop(0)
            self.send_response(status)
            for name, value in wanted.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_POST = do_DELETE = reply  # noqa: N815  # the base class asks for these names

        def log_message(self, *_: Any) -> None:
            return None

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        with Client(f"http://127.0.0.1:{http.server_port}/") as client:
            yield client, script
    finally:
        http.shutdown()
        thread.join()
        http.server_close()


def problem(status: int, detail: str = "it does not fit", errors: list[dict[str, str]] | None = None) -> Answer:
    document = {"type": "about:blank", "title": "x", "status": status, "detail": detail, "errors": errors or []}
    return status, {"Content-Type": "application/problem+json"}, json.dumps(document).encode()


def campaign(state: str, **headers: str) -> Answer:
    return 200, headers, Campaign(id="0" * 32, name="mine", state=state).model_dump_json().encode()
