"""The catalogue of problems."""

from service_farm import Farm

from service.problems import CATALOGUE


def test_problem_types_are_unique_and_documented(farm: Farm) -> None:
    assert len({kind.slug for kind in CATALOGUE}) == len(CATALOGUE)
    page = farm.client.get("/docs").text
    for kind in CATALOGUE:
        assert kind.uri in page
