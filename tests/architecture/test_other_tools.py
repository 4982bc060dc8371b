"""Files for tools of others: the dashboard asks for metrics that exist, the scripts are well formed."""

import json
import re
import subprocess
from pathlib import Path

import yaml
from tests.support.tree import PROJECT

from drivecal.cluster.settings import ALERT, OBJECT_STORE_BYTES, QUIET, VERSION_LABEL

DASHBOARD = PROJECT / "deploy" / "grafana" / "drivecal.json"
CLUSTER = PROJECT / "deploy" / "examples" / "cluster"
METRICS = PROJECT / "docs" / "pages" / "reference" / "metrics.md"


def test_the_dashboard_asks_for_documented_metrics_with_their_labels() -> None:
    rows = re.findall(r"^\| `(drivecal_[a-z_]+)` \|([a-z, ]*)\|", METRICS.read_text(), re.MULTILINE)
    labels = {name: {label.strip() for label in listed.split(",")} - {""} for name, listed in rows}
    queries = [target["expr"] for panel in json.loads(DASHBOARD.read_text())["panels"] for target in panel["targets"]]
    assert len(queries) > 10
    for query in queries:
        names = [re.sub(r"_(bucket|sum|count)$", "", name) for name in re.findall(r"drivecal_[a-z_]+", query)]
        assert names
        assert set(names) <= labels.keys(), query
        known = {"instance", "le"}.union(*(labels[name] for name in names))
        by = {label.strip() for listed in re.findall(r"by \(([^)]*)\)", query) for label in listed.split(",")}
        matched = set(re.findall(r"(\w+)=~?\"", query))
        assert by | matched <= known, query


def test_the_script_for_slurm_is_a_shell_script_that_starts_nodes_as_drivecal_does() -> None:
    script = CLUSTER / "slurm.sh"
    subprocess.run(["bash", "-n", script], check=True)
    text = script.read_text()
    assert "-m drivecal.cluster head" in text
    assert "-m drivecal.cluster worker" in text


def test_the_manifest_for_kuberay_starts_nodes_with_the_options_of_drivecals_own() -> None:
    manifest = yaml.safe_load(Path(CLUSTER / "kuberay.yaml").read_text())
    spec = manifest["spec"]
    assert (manifest["apiVersion"], manifest["kind"]) == ("ray.io/v1", "RayCluster")
    locked = (PROJECT / "deploy" / "images" / "ray-worker.lock").read_text()
    assert re.findall(r"^ray==(\S+)", locked, re.MULTILINE) == [spec["rayVersion"]]
    groups = [spec["headGroupSpec"], *spec["workerGroupSpecs"]]
    for group in groups:
        assert group["rayStartParams"]["object-store-memory"] == str(OBJECT_STORE_BYTES)
        assert group["rayStartParams"]["labels"].startswith(f"{VERSION_LABEL}=")
        [container] = group["template"]["spec"]["containers"]
        given = {each["name"]: each["value"] for each in container["env"]}
        assert given == given | QUIET | ALERT
    assert groups[0]["rayStartParams"]["num-cpus"] == "0"
