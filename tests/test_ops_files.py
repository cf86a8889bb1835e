"""Dockerfile, .dockerignore and docker-compose.yml: parsed, and checked against the commands and files that they name.

No engine runs here. What a parser can see is seen: images, stages, users, ports, commands down to their options.
"""

import fnmatch
import json
import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.main import get_command

from client.cli import app
from service.settings import ServiceSettings
from worker.settings import FarmSettings

ROOT = Path(__file__).parents[1]
INSTRUCTIONS = {
    "ARG", "CMD", "COPY", "ENTRYPOINT", "ENV", "EXPOSE", "FROM", "HEALTHCHECK", "RUN", "STOPSIGNAL", "USER", "VOLUME", "WORKDIR",
}  # fmt: skip
IMAGE = re.compile(r"[a-z0-9]+(?:[._-][a-z0-9]+)*(?:/[a-z0-9]+(?:[._-][a-z0-9]+)*)?(?::[\w.-]+)?")


def read_dockerfile() -> list[tuple[str, str]]:
    """Instructions and their arguments, continued lines joined."""
    text = "\n".join(
        line for line in (ROOT / "Dockerfile").read_text().splitlines() if not line.lstrip().startswith("#")
    )
    lines = [line.strip() for line in text.replace("\\\n", " ").splitlines()]
    return [(line.partition(" ")[0], line.partition(" ")[2].strip()) for line in lines if line]


DOCKERFILE = read_dockerfile()
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]


def final_stage() -> list[tuple[str, str]]:
    last = max(number for number, (name, _) in enumerate(DOCKERFILE) if name == "FROM")
    return DOCKERFILE[last:]


def last(instruction: str) -> str:
    return [argument for name, argument in final_stage() if name == instruction][-1]


def check_smalti_arguments(arguments: list[str]) -> dict[str, Any]:
    """Parse arguments as `smalti` would; a wrong option or value raises."""
    command = get_command(app)
    name, *rest = arguments
    sub_command = command.commands[name]  # type: ignore[attr-defined]
    return dict(sub_command.make_context(name, rest).params)


def is_plain_image(name: str) -> bool:
    """A name without a registry's host: the first part has neither dot nor colon."""
    first, slash, _ = name.partition("/")
    return IMAGE.fullmatch(name) is not None and not (slash and ("." in first or ":" in first or first == "localhost"))


def test_every_line_is_a_known_instruction() -> None:
    assert {name for name, _ in DOCKERFILE} <= INSTRUCTIONS
    assert DOCKERFILE[0][0] == "ARG"


def test_images_are_plain_pinned_names_and_stages_exist() -> None:
    arguments = dict(one.split("=", 1) for name, one in DOCKERFILE if name == "ARG")
    stages: list[str] = []
    for argument in (one for name, one in DOCKERFILE if name == "FROM"):
        image, _, stage = argument.partition(" AS ")
        image = arguments[image[2:-1]] if image.startswith("${") else image
        assert is_plain_image(image), image
        assert ":" in image
        stages.append(stage)
    assert stages == ["build", "final"]
    for argument in (one for name, one in DOCKERFILE if name == "COPY" and one.startswith("--from=")):
        assert argument.split()[0].removeprefix("--from=") in stages


def test_copied_files_exist_and_are_not_ignored() -> None:
    patterns = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and not line.startswith("#")]
    for argument in (one for name, one in DOCKERFILE if name == "COPY" and not one.startswith("--from=")):
        *sources, _ = argument.split()
        for source in sources:
            assert (ROOT / source).exists(), source
            ignored = False
            for pattern in patterns:  # the last pattern that fits decides
                if fnmatch.fnmatch(source, pattern.removeprefix("!")):
                    ignored = not pattern.startswith("!")
            assert not ignored, source


def test_every_package_goes_into_the_image() -> None:
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]["find"]["include"]
    copied = {source for name, one in DOCKERFILE if name == "COPY" for source in one.split()[:-1]}
    assert {name for name in packages if "." not in name} <= copied


def test_requirements_are_installed_by_hash() -> None:
    lines = [one for name, one in DOCKERFILE if name == "RUN" and "-r requirements.lock" in one]
    assert len(lines) == 1
    assert "--require-hashes" in lines[0]


def test_the_process_is_not_root_and_owns_what_it_writes() -> None:
    assert last("USER") == "smalti"
    useradd = next(one for name, one in final_stage() if name == "RUN" and "useradd" in one)
    assert "--uid 10001" in useradd
    assert "--owner smalti" in useradd
    for folder in ("/data", "/var/cache/smalti"):
        assert folder in useradd
    assert last("VOLUME") == "/data"


def test_kernels_are_compiled_in_the_image_for_a_portable_processor() -> None:
    names = [name for name, _ in final_stage()]
    warm = next(number for number, step in enumerate(final_stage()) if step == ("RUN", "smalti warm"))
    assert names.index("USER") < warm, "the user who renders must own the cache"
    environment = " ".join(one for name, one in final_stage()[:warm] if name == "ENV")
    assert "NUMBA_CPU_NAME=${NUMBA_CPU_NAME}" in environment
    assert "SMALTI_CACHE=/var/cache/smalti" in environment
    assert ("ARG", "NUMBA_CPU_NAME=x86-64-v3") in final_stage()


def test_times_are_whole_seconds_before_anything_is_compiled() -> None:
    build = DOCKERFILE[: len(DOCKERFILE) - len(final_stage())]
    touched = next(number for number, (_, one) in enumerate(build) if "touch" in one)
    assert not any("pip install" in one for _, one in build[touched:])
    assert build[touched][1].index("touch") < build[touched][1].index("compileall")


def test_the_command_of_the_image_exists() -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    entry = json.loads(last("ENTRYPOINT"))
    assert len(entry) == 1
    assert entry[0] in scripts
    parameters = check_smalti_arguments(json.loads(last("CMD")))
    assert (parameters["host"], parameters["port"]) == ("0.0.0.0", int(last("EXPOSE")))


def test_health_is_the_file_that_the_farm_writes() -> None:
    environment = dict(word.split("=", 1) for name, one in final_stage() if name == "ENV" for word in shlex.split(one))
    ready = FarmSettings.model_config["env_prefix"] + "ready_file".upper()
    assert "ready_file" in FarmSettings.model_fields
    assert json.loads(last("HEALTHCHECK").partition(" CMD ")[2]) == ["test", "-s", environment[ready]]
    assert all("healthcheck" not in SERVICES[name] for name in ("api", "worker")), "the image's own counts for both"


@pytest.mark.parametrize("name", sorted(SERVICES))
def test_compose_services_name_only_what_is_there(name: str) -> None:
    service = SERVICES[name]
    assert is_plain_image(service["image"]), service["image"]
    for volume in service.get("volumes", []):
        assert volume.split(":")[0] in COMPOSE["volumes"]
    assert set(service["networks"]) <= set(COMPOSE["networks"])
    assert set(service.get("depends_on", {})) <= set(SERVICES)
    for dependency in service.get("depends_on", {}).values():
        assert dependency == {"condition": "service_healthy"}
    assert service["restart"] == "unless-stopped"


def test_compose_has_the_farm() -> None:
    assert set(COMPOSE) == {"name", "x-smalti", "services", "volumes", "networks"}
    assert set(SERVICES) == {"valkey", "api", "worker"}
    assert SERVICES["api"]["build"] == "."
    assert SERVICES["api"]["image"] == SERVICES["worker"]["image"]


def test_the_container_answers_to_loopback_names_only() -> None:
    environment = dict(word.split("=", 1) for name, one in final_stage() if name == "ENV" for word in shlex.split(one))
    hosts = environment[f"{ServiceSettings.model_config['env_prefix']}{'allowed_hosts'.upper()}"]
    host = check_smalti_arguments(json.loads(last("CMD")))["host"]
    assert ServiceSettings(host=host, allowed_hosts=hosts).host_names() == {"localhost"}


def test_nothing_is_published_but_the_api_on_loopback() -> None:
    assert [name for name, service in SERVICES.items() if service.get("ports")] == ["api"]
    for port in SERVICES["api"]["ports"]:
        assert port.startswith("127.0.0.1:")
        assert port.endswith(":8000")
    assert COMPOSE["networks"]["farm"] == {"internal": True}
    assert SERVICES["valkey"]["networks"] == SERVICES["worker"]["networks"] == ["farm"]


def test_valkey_neither_evicts_nor_forgets() -> None:
    command = SERVICES["valkey"]["command"]
    options = dict(zip(command[1::2], command[2::2], strict=True))
    assert command[0] == "valkey-server"
    assert options["--maxmemory-policy"] == "noeviction"
    assert options["--appendonly"] == "yes"


def test_commands_of_the_containers_exist_and_agree() -> None:
    api = check_smalti_arguments(SERVICES["api"]["command"])
    worker = check_smalti_arguments(SERVICES["worker"]["command"])
    assert SERVICES["api"]["command"][0] == "serve"
    assert SERVICES["worker"]["command"][0] == "worker"
    assert (api["redis_url"], api["store"]) == (worker["redis_url"], worker["store"])
    assert api["redis_url"].split("//")[1].split(":")[0] in SERVICES
    assert (api["workers"], worker["workers"]) == (0, None), (
        "the API's container renders nothing, the others on all cores"
    )
    assert worker["steward"] is False


def test_no_registry_and_no_secret_in_the_files() -> None:
    for name in ("Dockerfile", "docker-compose.yml", ".dockerignore"):
        text = (ROOT / name).read_text()
        assert not re.search(r"\b(?:docker|ghcr|quay|gcr|pypi|index)\.(?:io|org|com)\b|https?://", text), name
        assert not re.search(r"password|secret|token", text, re.IGNORECASE), name


def has_compose() -> bool:
    if shutil.which("docker") is None:
        return False
    return subprocess.run(["docker", "compose", "version"], capture_output=True, check=False).returncode == 0


@pytest.mark.skipif(not has_compose(), reason="the docker client with its compose plugin is not here")
def test_compose_itself_reads_the_file() -> None:
    command = ["docker", "compose", "--file", str(ROOT / "docker-compose.yml"), "config", "--quiet"]
    subprocess.run(command, check=True, timeout=60)
