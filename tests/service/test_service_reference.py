"""The API reference as a page."""

from service.reference import render_reference


def test_the_reference_escapes() -> None:
    evil = "<script>alert(1)</script>"
    operation = {
        "tags": ["t"], "summary": evil, "description": evil, "parameters": [{"name": evil, "in": "query", "description": evil}],
        "responses": {"200": {"description": evil, "content": {"a/b": {"example": evil}}}},
    }  # fmt: skip
    document = {
        "info": {"title": evil, "version": evil},
        "tags": [{"name": "t", "description": evil}],
        "paths": {f"/{evil}": {"get": operation}},
    }
    page = render_reference(document)
    assert "<script" not in page
    assert page.count("&lt;script&gt;") >= 8
