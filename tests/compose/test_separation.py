"""Secrets of the services of the cluster, and services that hang."""

import json

import pytest
from tests.support.compose import Cluster

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]

STOP = """
import os, pathlib, signal, sys
for process in pathlib.Path("/proc").glob("[0-9]*"):
    words = (process / "cmdline").read_bytes().split(bytes(1))
    names = {pathlib.Path(os.fsdecode(word)).name for word in words}
    if int(process.name) != os.getpid() and sys.argv[1] in names and "drivecal.cluster.guard" not in names:
        os.kill(int(process.name), signal.SIGSTOP)
        print(process.name)
"""
"""Stops the processes with a word in their command; the images have no tool for that."""
STOP_DATABASE = "kill -STOP $(head -n 1 /var/lib/postgresql/data/postmaster.pid)"
PROCESSES = {"api": "drivecal.api", "dispatcher": "drivecal.dispatch", "ray-head": "gcs_server", "ray-worker": "raylet"}
ATTEMPTS = """
import json, pathlib, psycopg
password = pathlib.Path("/run/secrets/dispatcher_password").read_text().strip()
attempts = {
    "reads rows": "SELECT count(*) FROM campaigns",
    "writes rows": "DELETE FROM campaigns WHERE false",
    "drops a table": "DROP TABLE campaigns",
    "empties a table": "TRUNCATE campaigns CASCADE",
    "reads passwords": "SELECT rolpassword FROM pg_authid",
    "makes itself a superuser": "ALTER ROLE dispatcher SUPERUSER",
    "takes the owner's password": "ALTER ROLE drivecal PASSWORD 'x'",
    "reads a file": "SELECT pg_read_file('/run/secrets/postgres_password')",
    "runs a program": "COPY (SELECT 1) TO PROGRAM 'true'",
}
results = {}
for name, statement in attempts.items():
    with psycopg.connect(host="db", user="dispatcher", password=password, dbname="drivecal") as connection:
        try:
            connection.execute(statement)
            results[name] = "done"
        except psycopg.errors.InsufficientPrivilege:
            results[name] = "refused"
        connection.rollback()
print(json.dumps(results))
"""


def test_who_has_the_token_of_ray_has_rows_and_not_the_database(cluster: Cluster) -> None:
    """The token runs code on every node, the dispatcher's among them, as that container's user."""
    for service, held in {"ray-worker": {"ray_token"}, "dispatcher": {"ray_token", "dispatcher_password"}}.items():
        assert set(cluster.compose("exec", "-T", service, "ls", "/run/secrets").split()) == held
    done = json.loads(cluster.compose("exec", "-T", "dispatcher", "python", "-c", ATTEMPTS))
    assert {name for name, end in done.items() if end == "done"} == {"reads rows", "writes rows"}


SECLUDED = """
from pathlib import Path
from drivecal.adapters.seclusion import Seclusion
try:
    profile = Path("/proc/self/attr/current").read_text()
except OSError:  # a kernel without profiles
    profile = ""
print(Seclusion.make([], 1 << 20) is not None, "docker-default" in profile)
"""


def test_simulators_on_nodes_have_mount_namespaces_unless_apparmor_forbids_mounts(cluster: Cluster) -> None:
    is_secluded, is_forbidden = cluster.compose("exec", "-T", "ray-worker", "python", "-c", SECLUDED).split()
    assert is_secluded != is_forbidden


ANOTHER_USER = """
import ctypes, os
def ends(attempt):
    child = os.fork()
    if child == 0:
        try:
            attempt()
            os._exit(0)
        except OSError:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
def in_namespace():
    if ctypes.CDLL(None, use_errno=True).unshare(0x10000000):
        raise OSError
    with open("/proc/self/uid_map", "w") as file:
        file.write("10002 10002 1")
print(ends(lambda: os.setuid(10002)), ends(in_namespace))
"""


def test_no_process_of_a_node_becomes_another_user(cluster: Cluster) -> None:
    """Why simulators have the uid of their worker."""
    assert cluster.compose("exec", "-T", "ray-worker", "python", "-c", ANOTHER_USER).split() == ["1", "1"]


def test_the_database_has_checksums(cluster: Cluster) -> None:
    """An image whose entry point reads no POSTGRES_INITDB_ARGS cannot have them: the official one does."""
    read = cluster.compose(
        "exec", "-T", "db", "grep", "-c", "POSTGRES_INITDB_ARGS", "/usr/local/bin/docker-entrypoint.sh", check=False
    )
    shown = cluster.compose("exec", "-T", "db", "psql", "-U", "drivecal", "-Atc", "SHOW data_checksums").strip()
    assert (shown == "on") == (int(read.split()[0]) > 0)


@pytest.mark.parametrize("service", [*PROCESSES, "db"])
def test_a_service_that_hangs_is_started_again(cluster: Cluster, service: str) -> None:
    container = cluster.containers(service)[0]
    before = cluster.restarts(container)
    if service == "db":
        cluster.compose("exec", "-T", "db", "sh", "-c", STOP_DATABASE)
    else:
        assert cluster.run("docker", "exec", container, "python", "-c", STOP, PROCESSES[service]).split()
    took = cluster.until(lambda: cluster.restarts(container) > before, f"that {service} is started again")
    ready = cluster.until(cluster.is_ready, "that campaigns can be carried out")
    print(
        f"{service} was started again {took:.0f} s after it hung; campaigns could be carried out {ready:.0f} s later",
        flush=True,
    )
