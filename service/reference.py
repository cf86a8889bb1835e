"""The API reference as one HTML page, made from the OpenAPI document.

Job: show each operation with its parameters, bodies, answers and examples, and the catalogue of problems.
Invariant: no script, no resource from elsewhere; every text is escaped on its way into the markup.
"""

import json
import re
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from service.problems import CATALOGUE

_METHODS = ("post", "get", "put", "delete")


def render_reference(document: Mapping[str, Any]) -> str:
    """Return the page for an OpenAPI document."""
    info = document["info"]
    return "\n".join(
        [
            '<!doctype html><html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{_text(info['title'])}: API reference</title>",
            '<link rel="icon" href="/static/icon.svg" type="image/svg+xml">',
            '<link rel="stylesheet" href="/static/page.css"></head><body>',
            '<header><div class="brand"><img src="/static/icon.svg" width="44" height="44" alt=""><div>',
            f"<h1>API reference</h1><p>{_text(info['title'])} {_text(info['version'])}</p></div></div>",
            '<nav aria-label="Service"><a href="/">Jobs</a> <a href="/openapi.json">OpenAPI</a>',
            '<a href="/v1/schema">Scene schema</a></nav></header><main>',
            *_tags(document),
            *_problems(),
            "</main></body></html>",
        ]
    )


def _tags(document: Mapping[str, Any]) -> Iterator[str]:
    for tag in document["tags"]:
        yield f"<section><h2>{_text(tag['name'].capitalize())}</h2><p>{_text(tag['description'])}</p>"
        for path, operations in document["paths"].items():
            for method in _METHODS:
                operation = operations.get(method)
                if operation is not None and tag["name"] in operation.get("tags", ()):
                    yield from _operation(path, method, operation)
        yield "</section>"


def _operation(path: str, method: str, operation: Mapping[str, Any]) -> Iterator[str]:
    yield '<article class="operation">'
    yield f'<h3><span class="method">{_text(method.upper())}</span> <code>{_text(path)}</code></h3>'
    yield f"<p>{_text(operation['summary'])}. {_text(operation.get('description', ''))}</p>"
    parameters = operation.get("parameters", ())
    if parameters:
        yield "<table><thead><tr><th>Parameter</th><th>In</th><th>Meaning</th></tr></thead><tbody>"
        for parameter in parameters:
            yield (
                f"<tr><td><code>{_text(parameter['name'])}</code></td><td>{_text(parameter['in'])}</td>"
                f"<td>{_text(parameter.get('description', ''))}</td></tr>"
            )
        yield "</tbody></table>"
    for media_type, content in operation.get("requestBody", {}).get("content", {}).items():
        yield from _examples(f"Body, {media_type}", content)
    yield '<table class="answers"><thead><tr><th>Answer</th><th>Meaning</th></tr></thead><tbody>'
    for status, answer in operation["responses"].items():
        yield f"<tr><td>{_text(status)}</td><td>{_text(answer['description'])}"
        if status.startswith("2"):
            for media_type, content in answer.get("content", {}).items():
                yield from _examples(media_type, content)
        yield "</td></tr>"
    yield "</tbody></table></article>"


def _examples(title: str, content: Mapping[str, Any]) -> Iterator[str]:
    values = {"example": content["example"]} if "example" in content else {}
    values |= {name: example["value"] for name, example in content.get("examples", {}).items()}
    for name, value in values.items():
        shown = value if isinstance(value, str) else json.dumps(value, indent=2, ensure_ascii=False)
        yield f"<details><summary>{_text(title)}: {_text(name)}</summary>"
        yield f'<pre tabindex="0"><code>{escape(shown)}</code></pre></details>'


def _problems() -> Iterator[str]:
    yield "<section><h2>Problems</h2><p>Every error is a problem document (RFC 9457); branch on its type.</p>"
    yield "<table><thead><tr><th>Type</th><th>Status</th><th>Meaning</th></tr></thead><tbody>"
    for kind in CATALOGUE:
        yield (
            f"<tr><td><code>{_text(kind.uri)}</code></td><td>{kind.status}</td>"
            f"<td>{_text(kind.title)}. {_text(kind.meaning)}</td></tr>"
        )
    yield "</tbody></table></section>"


def _text(value: object) -> str:
    """Escape a text; words between backticks become code."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", escape(str(value)))
