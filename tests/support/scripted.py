"""A client and a server that gives the answers of a script."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from drivecal.client import Client
from drivecal.contracts.campaign import Campaign

Answer = tuple[int, dict[str, str], bytes]
"""Status, headers, body."""
Request = tuple[str, str, dict[str, str], bytes]
"""Method, path, headers with names in small letters, body."""


@dataclass
class Script:
    """The answers to give, one after the other, and the requests that came."""

    answers: list[Answer]
    requests: list[Request] = field(default_factory=list)


@contextmanager
def listening(answer: Callable[[Request], Answer]) -> Iterator[str]:
    """Serves what `answer` returns for each request; yields the address."""

    class Handler(BaseHTTPRequestHandler):
        def reply(self) -> None:
            body = self.rfile.read(int(self.headers.get("content-length", 0)))
            headers = {name.lower(): value for name, value in self.headers.items()}
            status, wanted, content = answer((self.command, self.path, headers, body))
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
        yield f"http://127.0.0.1:{http.server_port}"
    finally:
        http.shutdown()
        thread.join()
        http.server_close()


@contextmanager
def server(*answers: Answer) -> Iterator[tuple[Client, Script]]:
    script = Script(list(answers))

    def answer(request: Request) -> Answer:
        script.requests.append(request)
        return script.answers.pop(0)

    with listening(answer) as address, Client(f"{address}/") as client:
        yield client, script


def problem(status: int, detail: str = "it does not fit", errors: list[dict[str, str]] | None = None) -> Answer:
    document = {"type": "about:blank", "title": "x", "status": status, "detail": detail, "errors": errors or []}
    return status, {"Content-Type": "application/problem+json"}, json.dumps(document).encode()


def campaign(state: str, **headers: str) -> Answer:
    return 200, headers, Campaign(id="0" * 32, name="mine", state=state).model_dump_json().encode()
