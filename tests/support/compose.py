"""The cluster of `docker-compose.yml` on a Docker engine, in a project of its own that leaves nothing behind."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
from tests.support.server import free_port
from tests.support.tree import PROJECT

PROJECT_NAME = "drivecal-test"
PATIENCE_SECONDS = 600.0


def engine() -> str | None:
    """The engine's version; None where there is no engine, or no Compose 2."""
    try:
        version = subprocess.run(["docker", "version", "-f", "{{.Server.Version}}"], capture_output=True, text=True, check=True)
        compose = subprocess.run(["docker", "compose", "version", "--short"], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return f"{version.stdout.strip()}, Compose {compose.stdout.strip()}"


class Cluster:
    """Commands to a cluster, and requests to its API."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.secrets = folder / "secrets"
        self.environment = {name: value for name, value in os.environ.items() if not name.startswith(("DRIVECAL_", "COMPOSE_"))}
        self.environment |= {
            "DRIVECAL_SECRETS": str(self.secrets),
            "DRIVECAL_PORT": str(free_port()),
            "DRIVECAL_TAG": "test",
        }
        told = self.run("sh", "-c", 'eval "$(deploy/secrets.sh)"; echo "$DRIVECAL_URL $DRIVECAL_TOKEN"')
        self.url, self.token = told.split()
        self.http = httpx.Client(base_url=self.url, headers={"Authorization": f"Bearer {self.token}"}, timeout=60.0)

    def run(self, *words: str, check: bool = True, environment: Mapping[str, str] | None = None) -> str:
        """What a command says on standard output. AssertionError with all that it said where it fails."""
        done = subprocess.run(
            words,
            cwd=PROJECT,
            env=self.environment | dict(environment or {}),
            capture_output=True,
            text=True,
            timeout=3600,
            check=False,
        )
        assert done.returncode == 0 or not check, (
            f"{' '.join(words)}: {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
        )
        return done.stdout if check else done.stdout + done.stderr

    def compose(self, *words: str, check: bool = True) -> str:
        """`docker compose` on the cluster."""
        return self.run("docker", "compose", "-p", PROJECT_NAME, "--env-file", os.devnull, *words, check=check)

    def elsewhere(self, *words: str) -> str:
        """`docker compose` on the nodes that join from another project, as from another machine."""
        file = str(PROJECT / "deploy" / "docker-compose.worker.yml")
        named = {"DRIVECAL_NETWORK": f"{PROJECT_NAME}_cluster", "DRIVECAL_NODES": "1"}
        return self.run(
            *("docker", "compose", "-p", f"{PROJECT_NAME}-elsewhere", "--env-file", os.devnull, "-f", file, *words),
            environment=named,
        )

    def up(self, *words: str, attempts: int = 3) -> None:
        """Starts what does not run, and waits until all of it works; on a machine that has other things to do a container may be late.
        AssertionError with the logs where it does not work at last."""
        for attempt in range(1, attempts + 1):
            try:
                self.compose("up", "-d", "--wait", *words)
            except AssertionError as error:
                if attempt == attempts or "unhealthy" not in str(error):
                    raise AssertionError(f"{error}\n{self.compose('logs', '--tail', '30', check=False)[-8000:]}") from None
                print(f"after attempt {attempt}: {str(error).splitlines()[-1]}", flush=True)
            else:
                return

    def containers(self, service: str) -> list[str]:
        """The ids of a service's containers that run."""
        return self.compose("ps", "-q", service).split()

    def get(self, path: str) -> Any:
        """The API's answer."""
        return self.http.get(path).raise_for_status().json()

    def workers(self) -> list[dict[str, Any]]:
        """As the API shows them; none while it does not answer."""
        try:
            found: list[dict[str, Any]] = self.get("/api/v1/workers")["items"]
        except httpx.HTTPError:
            return []
        return found

    def ready_nodes(self) -> set[str]:
        """The nodes whose workers have started."""
        return {worker["node"] for worker in self.workers() if worker["state"] != "starting"}

    def until(self, condition: Any, what: str, seconds: float = PATIENCE_SECONDS) -> float:
        """Waits; gives the seconds that it took. AssertionError with the dispatcher's log where it takes too long."""
        begin = time.monotonic()
        while True:
            with suppress(httpx.HTTPError):
                if condition():
                    return time.monotonic() - begin
            log = self.compose("logs", "--tail", "30", "dispatcher", check=False) if time.monotonic() - begin > seconds else ""
            assert time.monotonic() - begin <= seconds, f"{what}: did not happen within {seconds:.0f} s\n{log}"
            time.sleep(0.2)

    def published(self) -> dict[str, set[int]]:
        """The ports of this machine that lead into containers, by service."""
        found: dict[str, set[int]] = {}
        for line in self.compose("ps", "--format", "json").splitlines():
            one = json.loads(line)
            ports = {int(each["PublishedPort"]) for each in one["Publishers"] or [] if each["PublishedPort"]}
            found.setdefault(one["Service"], set()).update(ports)
        return found

    def close(self) -> None:
        """Ends everything, and forgets its data."""
        self.http.close()
        with suppress(AssertionError):
            self.elsewhere("down", "--timeout", "2")
        self.compose("down", "--volumes", "--timeout", "5", check=False)


@contextmanager
def cluster_on_engine(folder: Path) -> Iterator[Cluster]:
    """Built and started; gone when the block is left."""
    running = Cluster(folder)
    try:
        begin = time.monotonic()
        running.compose("build", "--quiet")
        built = time.monotonic()
        running.up()
        print(f"built in {built - begin:.0f} s, ready {time.monotonic() - built:.0f} s later", flush=True)
        yield running
    finally:
        running.close()
