"""Tests of what the compose files promise: limits, health, no privileges, nothing published but the API, and images from the lock."""

import ast
import re
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.tree import PROJECT, parsed, statements

from drivecal.configuration.settings import Settings

COMPOSE = PROJECT / "docker-compose.yml"
WORKERS = PROJECT / "deploy" / "docker-compose.worker.yml"
MACHINES = PROJECT / "deploy" / "docker-compose.machines.yml"
PLUGINS = PROJECT / "deploy" / "docker-compose.plugins.yml"
IMAGES = PROJECT / "deploy" / "images"
ONE_SHOT = {"migrate", "roles"}
ROLES = ("api", "dispatcher", "ray-head", "ray-worker")
OF_CLIENTS = {"url", "token"}
FIXED = {"home", "database_url", "database_password_file", "tokens_file", "ray_address", "backend"}
"""Settings that the compose file gives its services itself."""


@cache
def document(path: Path = COMPOSE) -> dict[str, Any]:
    result: dict[str, Any] = yaml.safe_load(path.read_text())
    return result


def services() -> list[tuple[str, dict[str, Any]]]:
    here = list(document()["services"].items())
    return here + [(f"{name} elsewhere", one) for name, one in document(WORKERS)["services"].items()]


every_service = pytest.mark.parametrize(("name", "service"), services(), ids=lambda each: each if isinstance(each, str) else "")


@every_service
def test_a_service_has_limits_and_a_health_check_and_comes_back(name: str, service: dict[str, Any]) -> None:
    assert {"cpus", "memory", "pids"} <= service["deploy"]["resources"]["limits"].keys()
    assert service["init"]
    assert service["logging"]["options"]["max-size"]
    if name in ONE_SHOT:
        assert (service["restart"], service["healthcheck"]) == ("no", {"disable": True})
    else:
        assert service["restart"] == "unless-stopped"
        assert {"test", "interval", "timeout", "retries", "start_period"} <= service["healthcheck"].keys()


@every_service
def test_a_service_may_gain_nothing_and_is_in_networks_that_lead_nowhere(name: str, service: dict[str, Any]) -> None:
    gains, *filters = service["security_opt"]
    assert gains == "no-new-privileges:true"
    assert bool(filters) == name.startswith("ray-worker")
    assert "privileged" not in service
    assert "network_mode" not in service
    assert ("ports" in service) == (name == "api")
    if name not in {"api", "ray-worker elsewhere"}:
        assert all(document()["networks"][network]["internal"] for network in service["networks"])
    if name != "db":  # the official image gives its rights up by itself
        assert service["read_only"]
        assert service["cap_drop"] == ["ALL"]
        assert ("user" in service) == (name == "roles"), "its image is root's"


def test_the_api_is_published_on_loopback_unless_somebody_says_otherwise() -> None:
    assert document()["services"]["api"]["ports"] == ["${DRIVECAL_BIND:-127.0.0.1}:${DRIVECAL_PORT:-8000}:8000"]
    assert document()["services"]["api"]["environment"]["DRIVECAL_TOKENS_FILE"] == "/run/secrets/tokens"


@every_service
def test_secrets_are_files_and_no_environment_holds_one(name: str, service: dict[str, Any]) -> None:
    environment = service.get("environment", {})
    for setting, value in environment.items():
        if re.search(r"PASSWORD|TOKEN|SECRET", setting) and not str(value).startswith("/run/secrets/"):
            assert setting.endswith("MODE"), setting
    if "ray_token" in service["secrets"]:
        assert environment["RAY_AUTH_MODE"] == "token"
        assert service["shm_size"] == "128m"
        assert "postgres_password" not in service["secrets"], "Ray's token runs code beside what this service holds"
    assert ("ray_token" in service["secrets"]) == (name.removesuffix(" elsewhere") in {"ray-head", "ray-worker", "dispatcher"})


def test_nothing_starts_before_the_database_is_at_its_revision() -> None:
    result = document()["services"]
    assert result["migrate"]["depends_on"] == {"db": {"condition": "service_healthy"}}
    assert result["api"]["depends_on"] == {"migrate": {"condition": "service_completed_successfully"}}
    completed = {"condition": "service_completed_successfully"}
    assert result["roles"]["depends_on"] == {"migrate": completed}
    healthy = {name: {"condition": "service_healthy"} for name in ("api", "ray-head")}
    assert result["dispatcher"]["depends_on"] == {"roles": completed, **healthy}
    assert result["ray-worker"]["depends_on"] == {"ray-head": {"condition": "service_healthy"}}


def test_a_node_elsewhere_is_the_same_as_a_node_here() -> None:
    here, there = dict(document()["services"]["ray-worker"]), dict(document(WORKERS)["services"]["ray-worker"])
    filters = [PROJECT / "deploy" / "images" / "seccomp.json"] * 2
    assert [PROJECT / of["security_opt"][1].replace("seccomp:", at) for of, at in ((here, ""), (there, "deploy/"))] == filters
    for differing in ("build", "command", "depends_on", "healthcheck", "security_opt"):
        here.pop(differing, None)
        there.pop(differing, None)
    assert there == here


def variables(*paths: Path) -> set[str]:
    return {name for path in paths for name in re.findall(r"\$\{(DRIVECAL_[A-Z_]+)", path.read_text())}


def test_the_example_of_settings_has_each_of_them_with_its_default() -> None:
    text = (PROJECT / ".env.example").read_text()
    given = dict(re.findall(r"^(?:# )?(DRIVECAL_[A-Z_]+)=(.*)$", text, flags=re.MULTILINE))
    assert set(given) == variables(COMPOSE, WORKERS, MACHINES, PLUGINS)
    defaults = dict(re.findall(r"\$\{(DRIVECAL_[A-Z_]+):-([^}]*)\}", COMPOSE.read_text()))
    assert {name: given[name] for name in defaults} == defaults


def test_plug_ins_reach_every_service_that_loads_them_and_no_other() -> None:
    services = document(PLUGINS)["services"]
    assert set(services) == {"api", "dispatcher", "ray-worker"} < set(document()["services"])
    for service in services.values():
        [volume] = service["volumes"]
        assert volume.endswith(f":{service['environment']['PYTHONPATH']}:ro")


def test_every_setting_of_the_server_can_be_made_in_the_cluster() -> None:
    passed = {name.removeprefix("DRIVECAL_").lower() for name in variables(COMPOSE)}
    assert set(Settings.model_fields) - OF_CLIENTS - FIXED <= passed


PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs" / "pages" / "how-to").glob("*.md"))]


def test_a_setting_in_the_documentation_is_one() -> None:
    known = {f"DRIVECAL_{name.upper()}" for name in Settings.model_fields} | variables(COMPOSE, WORKERS, MACHINES, PLUGINS)
    text = "".join(page.read_text() for page in PAGES)
    of_workers = {"DRIVECAL_BUNDLE_CACHE", "DRIVECAL_SEED", "DRIVECAL_SIMULATOR_FOLDERS"}
    assert set(re.findall(r"DRIVECAL_[A-Z_]+[A-Z]", text)) <= known | of_workers


@cache
def locked(path: Path) -> dict[str, frozenset[str]]:
    """The hashes of each requirement."""
    lines = path.read_text().replace("\\\n", " ").splitlines()
    entries = [line.split("--hash=") for line in lines if line.strip() and not line.lstrip().startswith("#")]
    return {entry[0].split(";")[0].strip(): frozenset(item.strip() for item in entry[1:]) for entry in entries}


@pytest.mark.parametrize("role", [*ROLES, "build"])
def test_an_image_holds_what_is_locked_and_nothing_else(role: str) -> None:
    mine, all_of_them = locked(IMAGES / f"{role}.lock"), locked(PROJECT / "deploy" / "requirements.lock")
    assert mine
    assert {name for name, hashes in mine.items() if not hashes or hashes != all_of_them.get(name)} == set()
    names = {line.split("[")[0] for line in (IMAGES / f"{role}.in").read_text().splitlines() if not line.startswith("#")}
    assert names <= {name.partition("==")[0].split("[")[0] for name in mine}


BEGIN = {
    "api": ("api.__main__",),
    "dispatcher": ("dispatch.__main__",),
    "ray-head": ("cluster.__main__",),
    "ray-worker": ("cluster.__main__", "runtime.__main__", "adapters.kinds", "adapters.fmu_driver", "highway.drive.driver"),
}
"""Modules at which the programs of each role begin, those included that are named in command lines only."""
COMMAND_LINE = {"api": ("cli.__main__", "cli.commands.db")}
"""Modules that `drivecal db` loads at once; what other commands import late is not needed."""


def source(module: str) -> Path | None:
    """The file of a module of ours; None for a name in a module."""
    path = Path(*module.split("."))
    files = (
        PROJECT / root / each
        for root in ("shared", "services", "workers")
        for each in (path.with_suffix(".py"), path / "__init__.py")
    )
    return next((file for file in files if file.is_file()), None)


def imported(begin: Sequence[str], *, late: bool) -> set[str]:
    """Returns the third-party packages that these modules import, also through other modules; with `late` also inside functions."""
    waiting, seen, others = [f"drivecal.{module}" for module in begin], set(), set()
    while waiting:
        module = waiting.pop()
        file = source(module)
        if module in seen or file is None:
            continue
        seen.add(module)
        for node in statements(parsed(file)) if late else parsed(file).body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            waiting += [name for name in names if name.startswith("drivecal.")]
            others |= {name.partition(".")[0] for name in names}
    return others - {"drivecal", "_typeshed"} - sys.stdlib_module_names


@pytest.mark.slow
@pytest.mark.parametrize("role", ROLES)
def test_an_image_holds_what_its_programs_import(role: str) -> None:
    mine = {plain(name.partition("==")[0].split("[")[0]) for name in locked(IMAGES / f"{role}.lock")}
    owners = packages_distributions()
    needed = imported(BEGIN[role], late=True) | imported(COMMAND_LINE.get(role, ()), late=False)
    assert {name for name in needed if not set(map(plain, owners.get(name, []))) & mine} == set()


def plain(name: str) -> str:
    """The name of a distribution as package registries compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.parametrize(
    ("role", "absent"),
    [
        ("api", {"ray", "libsumo", "numba"}),
        ("dispatcher", {"fastapi", "uvicorn", "libsumo", "numba"}),
        ("ray-head", {"numpy", "libsumo", "numba", "sqlalchemy", "fastapi"}),
        ("ray-worker", {"sqlalchemy", "psycopg", "fastapi", "uvicorn"}),
    ],
)
def test_a_role_lacks_what_it_has_no_use_for(role: str, absent: set[str]) -> None:
    assert not absent & {name.partition("==")[0].split("[")[0] for name in locked(IMAGES / f"{role}.lock")}


def test_secrets_are_made_once_are_the_owners_alone_and_tell_how_to_reach_the_cluster(tmp_path: Path) -> None:
    def run(**environment: str) -> str:
        script = str(PROJECT / "deploy" / "secrets.sh")
        given = {"PATH": "/usr/bin:/bin", "DRIVECAL_SECRETS": str(tmp_path / "secrets"), **environment}
        return subprocess.run([script], env=given, capture_output=True, text=True, check=True).stdout

    said = run(DRIVECAL_PORT="8123")
    folder = tmp_path / "secrets"
    made = {path.name: path.read_text() for path in folder.iterdir()}
    assert set(made) == {"postgres_password", "dispatcher_password", "ray_token", "tokens"}
    assert folder.stat().st_mode & 0o777 == 0o700
    assert {path.stat().st_mode & 0o777 for path in folder.iterdir()} == {0o644}
    token = made["tokens"].split()[2]
    assert said == f"export DRIVECAL_URL='http://127.0.0.1:8123'\nexport DRIVECAL_TOKEN='{token}'\n"
    assert len({*(made[name].strip() for name in ("postgres_password", "dispatcher_password", "ray_token")), token}) == 4
    assert len(token) == 64
    assert run(DRIVECAL_PORT="8123") == said
    assert {path.name: path.read_text() for path in folder.iterdir()} == made


def test_an_author_is_made_once_where_problems_may_be_pushed(tmp_path: Path) -> None:
    def run(**environment: str) -> str:
        given = {"PATH": "/usr/bin:/bin", "DRIVECAL_SECRETS": str(tmp_path / "secrets"), **environment}
        script = str(PROJECT / "deploy" / "secrets.sh")
        return subprocess.run([script], env=given, capture_output=True, text=True, check=True).stdout

    first, tokens = run(), tmp_path / "secrets" / "tokens"
    assert [line.split()[1] for line in tokens.read_text().splitlines()] == ["write"]
    allowed = run(DRIVECAL_ALLOW_PUSH="true")
    me, author = (line.split() for line in tokens.read_text().splitlines())
    assert (me[1], author[1]) == ("write", "author")
    assert author[2] in allowed
    assert me[2] in first
    assert run(DRIVECAL_ALLOW_PUSH="true") == allowed
    assert run() == first
    assert len(tokens.read_text().splitlines()) == 2


def test_no_secret_gets_into_an_image_or_into_the_repository() -> None:
    allowed = [line[1:] for line in (PROJECT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    assert set(allowed) == {
        *("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "shared", "services", "workers"),
        *("deploy/images", "deploy/README.md", "deploy/examples", "docs", "tests/README.md"),
    }
    assert {"deploy/secrets/", "deploy/secrets-*/", ".env", "/*.env"} <= set((PROJECT / ".gitignore").read_text().splitlines())
