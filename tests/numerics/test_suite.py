"""The stress suite, small: what `make stress` runs at full size."""

import pytest
from suite import ELSEWHERE, TESTS, WAITING


@pytest.mark.parametrize("name", TESTS)
def test_small(name):
    test = TESTS[name]
    row = test.run(test.small)
    assert row.test == name
    assert row.cases > 0
    # time is the stress run's to judge: here others use the same cores
    assert row.failures == 0, row.line()
    assert row.worst <= row.bound or name == "N16", row.line()


def test_every_number_is_accounted_for():
    assert sorted([*TESTS, *ELSEWHERE, *WAITING], key=lambda n: int(n[1:])) == [f"N{k}" for k in range(1, 26)]
