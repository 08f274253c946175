"""The compose files: what is hardened, what is published, and that they name settings and targets that exist."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from service.settings import Settings

ROOT = Path(__file__).parents[2]
BASE = ROOT / "docker-compose.yml"
PUBLIC = ROOT / "docker" / "compose.public.yml"
POSTGRES = ROOT / "docker" / "compose.postgres.yml"
SCALE = ROOT / "docker-compose.scale.yml"
OWN_SERVICES = ["api", "worker", "worker-gpu"]


class Loader(yaml.SafeLoader):
    """YAML with compose's ``!reset``, which takes away what an earlier file said."""


Loader.add_constructor("!reset", lambda _loader, _node: "!reset")


def load(path: Path) -> dict[str, Any]:
    loaded = yaml.load(path.read_text(), Loader)
    assert isinstance(loaded, dict)
    return loaded


@pytest.fixture(scope="module")
def services() -> dict[str, Any]:
    found = load(BASE)["services"]
    assert sorted(found) == OWN_SERVICES
    return found


@pytest.fixture(scope="module")
def scaled() -> dict[str, Any]:
    found = load(SCALE)["services"]
    assert sorted(found) == sorted([*OWN_SERVICES, "database", "proxy", "storage"])
    return found


@pytest.mark.parametrize("name", OWN_SERVICES)
@pytest.mark.parametrize("path", [BASE, SCALE], ids=["one machine", "many"])
def test_a_service_is_locked_down_and_bounded(path: Path, name: str) -> None:
    service = load(path)["services"][name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["tmpfs"][0].startswith("/tmp:size=")
    assert service["volumes"] == (["data:/data"] if path == BASE else ["/data"])
    assert service["mem_limit"]
    assert service["pids_limit"]
    assert not {"privileged", "cap_add", "devices", "user"} & service.keys()


def test_only_the_api_is_published_and_only_to_this_machine(services: dict[str, Any]) -> None:
    assert services["api"]["ports"] == ["127.0.0.1:${PUBLISHED_PORT:-8000}:8000"]
    for name in ("worker", "worker-gpu"):
        assert "ports" not in services[name]
        assert services[name]["network_mode"] == "none"


def test_serving_other_machines_takes_keys_and_the_proxy() -> None:
    public = load(PUBLIC)
    api = public["services"]["api"]
    assert api["ports"] == "!reset"
    assert api["environment"]["PCDNF_ALLOW_ANONYMOUS"] == "false"
    assert api["environment"]["PCDNF_API_KEYS_FILE"] == "/run/secrets/api_keys"
    assert public["secrets"]["api_keys"]["file"].startswith("${API_KEYS_FILE:?")
    proxy = public["services"]["proxy"]
    assert proxy["read_only"] is True
    assert proxy["cap_drop"] == ["ALL"]
    assert "./docker/nginx.conf:/etc/nginx/nginx.conf:ro" in proxy["volumes"]


def test_the_proxy_keeps_metrics_inside() -> None:
    configuration = (ROOT / "docker" / "nginx.conf").read_text()
    assert re.search(r"location = /metrics \{\s+default_type application/problem\+json;\s+return 404 ", configuration)


def test_the_proxy_bounds_slow_callers_and_passes_bodies_on_as_they_come() -> None:
    directives = dict(re.findall(r"^ *(\w+) (.+);", (ROOT / "docker" / "nginx.conf").read_text(), re.MULTILINE))
    assert int(directives["client_header_timeout"].removesuffix("s")) <= 10
    assert int(directives["client_body_timeout"].removesuffix("s")) <= 60
    assert int(directives["send_timeout"].removesuffix("s")) <= 60
    assert directives["limit_conn"].startswith("callers ")
    assert directives["ssl_protocols"] == "TLSv1.2 TLSv1.3"
    assert (directives["client_max_body_size"], directives["proxy_request_buffering"]) == ("0", "off")


def test_gpu_worker_reserves_a_device_and_stays_out_by_default(services: dict[str, Any]) -> None:
    worker = services["worker-gpu"]
    assert worker["profiles"] == ["gpu"]
    assert worker["environment"]["PCDNF_REQUIRE_GPU"] == "true"
    [device] = worker["deploy"]["resources"]["reservations"]["devices"]
    assert device == {"driver": "nvidia", "count": 1, "capabilities": ["gpu"]}
    assert "profiles" not in services["worker"]


def test_workers_on_one_volume_have_slots_of_their_own(services: dict[str, Any]) -> None:
    slots = [services[name]["environment"]["PCDNF_WORKER_ID"] for name in ("worker", "worker-gpu")]
    assert len(set(slots)) == 2
    for name in ("worker", "worker-gpu"):
        override = load(POSTGRES)["services"][name]
        assert override["environment"]["PCDNF_WORKER_ID"] == ""
        assert override["network_mode"] == "!reset"


def test_a_container_gets_longer_than_the_service_needs_to_stop(services: dict[str, Any]) -> None:
    needed = Settings.model_fields["grace_seconds"].default
    for service in services.values():
        assert int(service["stop_grace_period"].removesuffix("s")) > needed


def test_every_setting_named_exists() -> None:
    known = {f"PCDNF_{name.upper()}" for name in Settings.model_fields}
    for path in (BASE, PUBLIC, POSTGRES, SCALE, ROOT / "docker" / "Dockerfile"):
        assert set(re.findall(r"PCDNF_[A-Z_]+", path.read_text())) <= known, path.name


def test_every_target_named_is_a_stage(services: dict[str, Any]) -> None:
    stages = re.findall(r"^FROM .* AS (\S+)$", (ROOT / "docker" / "Dockerfile").read_text(), re.MULTILINE)
    assert {service["build"]["target"] for service in services.values()} == {"cpu", "cuda"} <= set(stages)
    assert stages[-1] == "cpu"


def test_files_named_exist(services: dict[str, Any]) -> None:
    for service in services.values():
        assert (ROOT / service["build"]["dockerfile"]).is_file()
    assert (ROOT / "docker" / "nginx.conf").is_file()


def test_every_variable_is_documented() -> None:
    page = (ROOT / "docs" / "containers.md").read_text()
    for name in re.findall(r"\$\{([A-Z_]+):-", BASE.read_text() + SCALE.read_text()):
        assert f"`{name}`" in page
    for path in (PUBLIC, POSTGRES, SCALE):
        text = path.read_text()
        head = text[: text.index("services:")]
        for name in re.findall(r"\$\{([A-Z_]+):\?", text):
            assert f"#   {name} " in head, path.name


def test_many_machines_share_a_database_and_a_bucket_alone(scaled: dict[str, Any]) -> None:
    for name in OWN_SERVICES:
        environment = scaled[name]["environment"]
        assert environment["PCDNF_DATABASE_URL"].startswith("postgresql://")
        assert environment["PCDNF_STORAGE_URL"] == "s3://pcdnf/jobs"
        assert environment["AWS_ENDPOINT_URL"] == "http://storage:8333"
        assert environment["PCDNF_WORKER_ID"] == ""  # each replica has a name of its own
        assert set(scaled[name]["depends_on"]) == {"database", "storage"}
        Settings(storage_url=environment["PCDNF_STORAGE_URL"])
    assert "-bucket=pcdnf" in scaled["storage"]["command"]
    assert scaled["storage"]["environment"]["AWS_ACCESS_KEY_ID"] == scaled["api"]["environment"]["AWS_ACCESS_KEY_ID"]


def test_replicas_behind_one_port_of_this_machine(scaled: dict[str, Any]) -> None:
    assert scaled["api"]["deploy"]["replicas"] == scaled["worker"]["deploy"]["replicas"] == 2
    assert [name for name in scaled if "ports" in scaled[name]] == ["proxy"]
    assert scaled["proxy"]["ports"] == ["127.0.0.1:${PUBLISHED_PORT:-8000}:8080"]
    assert [name for name in scaled if "networks" not in scaled[name]] == ["proxy"]
    for name in ("worker", "worker-gpu", "database", "storage"):
        assert scaled[name]["networks"] == ["backend"]
    assert load(SCALE)["networks"]["backend"]["internal"] is True
    nginx = (ROOT / "docker" / "nginx.scale.conf").read_text()
    assert "./docker/nginx.scale.conf:/etc/nginx/nginx.conf:ro" in scaled["proxy"]["volumes"]
    assert "set $api http://api:8000;" in nginx
    assert "listen 8080;" in nginx


def test_the_proxy_asks_the_engines_own_name_service_and_another_replica(
    tmp_path: Path, scaled: dict[str, Any]
) -> None:
    nginx = (ROOT / "docker" / "nginx.scale.conf").read_text()
    assert "include /tmp/resolver.conf;" in nginx
    assert "proxy_next_upstream error timeout;" in nginx  # a replica that is gone does not refuse, it is silent
    shell, option, script = scaled["proxy"]["command"]
    names, found = tmp_path / "resolv.conf", tmp_path / "resolver.conf"
    names.write_text("search dns.podman\nnameserver 10.89.1.1\nnameserver 192.0.2.53\n")
    script = script.replace("$$", "$").replace("/etc/resolv.conf", str(names)).replace("/tmp/resolver.conf", str(found))
    subprocess.run([shell, option, script.replace("exec nginx", ": nginx")], check=True)
    assert found.read_text() == "resolver 10.89.1.1 valid=5s ipv6=off;\n"
