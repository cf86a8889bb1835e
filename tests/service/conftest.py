"""One Valkey and one API for the tests of a process."""

from collections.abc import Iterator

import pytest
from service_farm import Farm, serve

from worker.embedded import EmbeddedServer


@pytest.fixture(scope="session")
def redis_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    server = EmbeddedServer(tmp_path_factory.mktemp("valkey"))
    server.start()
    yield server.url
    server.close()


@pytest.fixture(scope="module")
def farm(tmp_path_factory: pytest.TempPathFactory, redis_url: str) -> Iterator[Farm]:
    with serve(tmp_path_factory.mktemp("service"), redis_url, max_body_bytes=4 << 20, max_asset_bytes=3 << 20) as one:
        yield one
