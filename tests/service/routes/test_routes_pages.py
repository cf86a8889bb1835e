"""The pages: self-contained, without a word from elsewhere."""

from html.parser import HTMLParser
from pathlib import Path

import pytest
from service_farm import Farm


class Links(HTMLParser):
    """Everything that a page loads or links to, and whatever a Content-Security-Policy would refuse."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.inline: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in {"href", "src"} and value:
                self.links.append(value)
            if name == "style" or name.startswith("on"):
                self.inline.append(f"{tag} {name}")
        if tag == "style" or (tag == "script" and "src" not in dict(attrs)):
            self.inline.append(tag)


@pytest.mark.parametrize("path", ["/", "/docs"])
def test_pages_load_nothing_from_elsewhere(farm: Farm, path: str) -> None:
    answer = farm.client.get(path)
    assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
    page = Links(answer.text)
    assert page.inline == []
    for link in page.links:
        assert link.startswith(("/", "#")), link
        if link.startswith("/") and link != "/readyz":
            assert farm.client.get(link).status_code == 200, link


def test_static_files_name_no_other_host() -> None:
    folder = Path(__file__).resolve().parents[3] / "service" / "static"
    for path in folder.iterdir():
        text = path.read_text().replace("http://www.w3.org/2000/svg", "").replace("http://localhost", "")
        assert "http" not in text.replace("https?", ""), path.name
        assert "innerHTML" not in text
