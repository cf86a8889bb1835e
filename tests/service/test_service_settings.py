"""The settings that only HTTP needs."""

from service.settings import ServiceSettings


def test_host_names_by_setting() -> None:
    assert ServiceSettings(host="127.0.0.1").host_names() == frozenset()
    assert ServiceSettings(host="::1").host_names() == frozenset()
    assert ServiceSettings(host="0.0.0.0").host_names() == {"*"}
    assert ServiceSettings(host="0.0.0.0", allowed_hosts="a.example, B.example").host_names() == {
        "a.example",
        "b.example",
    }
