"""The cluster of `docker-compose.yml` on a Docker engine, in a project of its own that leaves nothing behind."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
from tests.support.server import free_port
from tests.support.tree import PROJECT

PROJECT_NAME = "drivecal-test"
TAG = "test"
FILE = "docker-compose.yml"
WORKER_FILE = "deploy/docker-compose.worker.yml"
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
    """A compose project: commands to it, and requests to its API."""

    def __init__(
        self,
        folder: Path,
        project: str = PROJECT_NAME,
        files: Sequence[str] = (FILE,),
        settings: Mapping[str, str] | None = None,
    ) -> None:
        """`folder` takes the secrets; `settings` go into `.env`."""
        self.folder = folder
        self.project = project
        self.files = tuple(files)
        self.secrets = folder / "secrets"
        self.environment = {name: value for name, value in os.environ.items() if not name.startswith(("DRIVECAL_", "COMPOSE_"))}
        self.environment |= {"DRIVECAL_SECRETS": str(self.secrets), "DRIVECAL_PORT": str(free_port()), "DRIVECAL_TAG": TAG}
        self.environment |= dict(settings or {})
        told = self.run("sh", "-c", 'eval "$(deploy/secrets.sh)"; echo "$DRIVECAL_URL $DRIVECAL_TOKEN"')
        self.url, self.token = told.split()
        self.http = httpx.Client(base_url=self.url, headers={"Authorization": f"Bearer {self.token}"}, timeout=60.0)

    def run(
        self, *words: str, check: bool = True, environment: Mapping[str, str] | None = None, given: bytes | None = None
    ) -> str:
        """Returns what a command says on standard output, with `given` on its standard input. AssertionError with all that it said where it
        fails."""
        done = subprocess.run(
            words,
            cwd=PROJECT,
            env=self.environment | dict(environment or {}),
            input=given,
            capture_output=True,
            timeout=3600,
            check=False,
        )
        out, errors = done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace")
        assert done.returncode == 0 or not check, f"{' '.join(words)}: {done.returncode}\n{out[-2000:]}\n{errors[-4000:]}"
        return out if check else out + errors

    def compose(
        self,
        *words: str,
        check: bool = True,
        more: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
        given: bytes | None = None,
    ) -> str:
        """`docker compose` on the cluster; `more` files on top of its own."""
        files = [word for file in (*self.files, *more) for word in ("-f", file)]
        command = ("docker", "compose", "-p", self.project, "--env-file", os.devnull, *files, *words)
        return self.run(*command, check=check, environment=environment, given=given)

    @contextmanager
    def changed(self, service: str, **document: Any) -> Iterator[None]:
        """A service that is started anew with changes to the compose file, and as it was afterwards."""
        file = self.folder / "changes.json"  # JSON is YAML
        file.write_text(json.dumps(document))
        self.compose("up", "-d", "--no-deps", "--force-recreate", "--timeout", "10", service, more=(str(file),))
        try:
            yield
        finally:
            self.compose("up", "-d", "--no-deps", "--force-recreate", "--timeout", "10", service)

    def problems(self) -> str:
        """Returns what `/readyz` has to say; nothing where it does not answer."""
        with suppress(httpx.HTTPError, ValueError):
            return " ".join(self.http.get("/readyz").json().get("problems", []))
        return ""

    def is_ready(self) -> bool:
        """As `/readyz` says."""
        with suppress(httpx.HTTPError):
            return self.http.get("/readyz").status_code == httpx.codes.OK
        return False

    def restarts(self, container: str) -> int:
        """How often the engine has started a container again."""
        return int(self.run("docker", "inspect", "-f", "{{.RestartCount}}", container))

    def drivecal(self, *words: str) -> str:
        """The command, as its user runs it: next to the cluster, with address and token."""
        client = {"DRIVECAL_URL": self.url, "DRIVECAL_TOKEN": self.token, "DRIVECAL_HOME": str(self.folder)}
        return self.run(sys.executable, "-m", "drivecal.cli", *words, environment=client)

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
            result: list[dict[str, Any]] = self.get("/api/v1/workers")["items"]
        except httpx.HTTPError:
            return []
        return result

    def ready_nodes(self) -> set[str]:
        """The nodes whose workers have started."""
        return {worker["node"] for worker in self.workers() if worker["state"] != "starting"}

    def until(self, condition: Callable[[], object], what: str, seconds: float = PATIENCE_SECONDS) -> float:
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
        result: dict[str, set[int]] = {}
        for line in self.compose("ps", "--format", "json").splitlines():
            one = json.loads(line)
            ports = {int(each["PublishedPort"]) for each in one["Publishers"] or [] if each["PublishedPort"]}
            result.setdefault(one["Service"], set()).update(ports)
        return result

    def close(self) -> None:
        """Ends everything, and forgets its data."""
        self.http.close()
        self.compose("down", "--volumes", "--timeout", "5", check=False)


class Machine:
    """One more machine with a node: it knows a network, the head's address in it and the token, and nothing else of the cluster."""

    def __init__(self, head: Cluster, name: str, network: str) -> None:
        """The machine joins `network`, to which the head belongs."""
        self.name = name
        self._head = head
        secrets = head.folder / name
        secrets.mkdir(mode=0o700)
        (secrets / "ray_token").write_bytes((head.secrets / "ray_token").read_bytes())
        (secrets / "ray_token").chmod(0o644)
        self._settings = {
            "DRIVECAL_SECRETS": str(secrets),
            "DRIVECAL_NETWORK": network,
            "DRIVECAL_NODES": "1",
            "DRIVECAL_RAY_ADDRESS": "ray-head:6379",
        }

    def compose(self, *words: str, check: bool = True) -> str:
        """`docker compose` on this machine."""
        command = ("docker", "compose", "-p", f"{self._head.project}-{self.name}", "--env-file", os.devnull, "-f", WORKER_FILE)
        return self._head.run(*command, *words, check=check, environment=self._settings)

    def join(self) -> str:
        """Its node's name, as soon as the node has started."""
        self.compose("up", "-d", "--wait")
        return self.node

    @property
    def container(self) -> str:
        """The id of the node's container."""
        return self.compose("ps", "-aq").strip()

    @property
    def node(self) -> str:
        """Its node's name, as `drivecal workers` shows it."""
        return self.container[:12]


@contextmanager
def cluster_on_engine(folder: Path) -> Iterator[Cluster]:
    """Built and started; gone when the block is left."""
    with closing(Cluster(folder, settings={"DRIVECAL_ALLOW_PUSH": "true"})) as running:
        begin = time.monotonic()
        running.compose("build", "--quiet")
        built = time.monotonic()
        running.up()
        print(f"built in {built - begin:.0f} s, ready {time.monotonic() - built:.0f} s later", flush=True)
        yield running
