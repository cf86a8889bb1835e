"""The OpenAPI document: complete, with examples that are true, and an API that keeps to it."""

from typing import Any

import jsonschema
import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)
from service_farm import Farm, serve

WANTED = {
    "/v1/jobs": {"post", "get"},
    "/v1/jobs/{job_id}": {"get", "delete"},
    "/v1/jobs/{job_id}/events": {"get"},
    "/v1/jobs/{job_id}/cancel": {"post"},
    "/v1/jobs/{job_id}/scene": {"get"},
    "/v1/jobs/{job_id}/result.png": {"get"},
    "/v1/jobs/{job_id}/result.exr": {"get"},
    "/v1/jobs/{job_id}/preview.png": {"get"},
    "/v1/jobs/{job_id}/report": {"get"},
    "/v1/assets:missing": {"post"},
    "/v1/assets/{sha256}": {"put"},
    "/v1/schema": {"get"},
    "/v1/workers": {"get"},
    "/healthz": {"get"},
    "/readyz": {"get"},
    "/metrics": {"get"},
}


@pytest.fixture(scope="module")
def document(farm: Farm) -> dict[str, Any]:
    return dict(farm.client.get("/openapi.json").json())


def test_every_row_of_the_table_is_there(document: dict[str, Any]) -> None:
    found = {path: set(operations) for path, operations in document["paths"].items()}
    assert found == WANTED


def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    def walk(value: Any) -> None:
        if isinstance(value, dict):
            reference = value.get("$ref")
            if isinstance(reference, str):
                assert reference.removeprefix("#/components/schemas/") in document["components"]["schemas"], reference
            for item in value.values():
                walk(item)
        elif isinstance(value, list):
            for item in value:
                walk(item)

    walk(document)
    assert "HTTPValidationError" not in document["components"]["schemas"]


def media_types(document: dict[str, Any]) -> Any:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            if "requestBody" in operation:
                for media_type, content in operation["requestBody"]["content"].items():
                    yield f"{method} {path} body", media_type, content
            for status, answer in operation["responses"].items():
                for media_type, content in answer.get("content", {}).items():
                    yield f"{method} {path} {status}", media_type, content


def test_examples_are_valid_and_everywhere(document: dict[str, Any]) -> None:
    n_examples = 0
    for where, media_type, content in media_types(document):
        examples = [content["example"]] if "example" in content else []
        examples += [example["value"] for example in content.get("examples", {}).values()]
        if media_type.endswith("json") and not where.endswith(("default", "/scene 200", "/schema 200")):
            assert examples or content["schema"].get("examples"), where
        for example in examples:
            n_examples += 1
            if media_type.endswith("json"):
                jsonschema.Draft202012Validator({**content["schema"], "components": document["components"]}).validate(
                    example
                )
    assert n_examples > 40


def test_the_examples_of_schema_and_metrics_are_true(farm: Farm, document: dict[str, Any]) -> None:
    def example(path: str, media_type: str) -> Any:
        return document["paths"][path]["get"]["responses"]["200"]["content"][media_type]["example"]

    schema = farm.client.get("/v1/schema").json()
    assert example("/v1/schema", "application/schema+json").items() <= schema.items()
    scraped = farm.client.get("/metrics").text
    kinds = [line for line in example("/metrics", "text/plain").splitlines() if line.startswith("#")]
    assert kinds
    assert set(kinds) <= set(scraped.splitlines())


def test_the_example_of_a_request_is_accepted(farm: Farm, document: dict[str, Any]) -> None:
    body = document["paths"]["/v1/jobs"]["post"]["requestBody"]["content"]["application/json"]
    for example in body["examples"].values():
        assert farm.post(body=example["value"]).status_code == 202
    estimate = farm.post(body=example["value"], params={"validate_only": True}).json()
    shown = document["paths"]["/v1/jobs"]["post"]["responses"]["200"]["content"]["application/json"]["examples"]
    assert set(estimate) == set(shown["validate_only"]["value"])


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory, redis_url: str) -> Any:
    with serve(tmp_path_factory.mktemp("fuzzed"), redis_url) as farm:
        yield schemathesis.openapi.from_url(f"{farm.url}/openapi.json")


@pytest.mark.parametrize(
    ("path", "method"),
    [
        (path, method)
        for path in WANTED
        for method in sorted(WANTED[path])
        if path.rpartition("/")[2] not in {"events", "metrics", "readyz"}
    ],
)
def test_the_api_keeps_to_its_document(fuzzed: Any, path: str, method: str) -> None:
    checks = [not_a_server_error, status_code_conformance, content_type_conformance, response_schema_conformance]

    @settings(max_examples=10, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(case=fuzzed[path][method.upper()].as_strategy())
    def fuzz(case: Any) -> None:
        for name in [name for name in case.headers or {} if name.lower() == "prefer"]:
            case.headers[name] = "wait=1"  # nobody renders here, so a longer wait only takes its time
        case.call_and_validate(checks=checks, timeout=60)

    fuzz()
