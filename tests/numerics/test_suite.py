"""The stress suite, small: what `make stress` runs at full size."""

import pytest
from mutants import REPOSITORY, apply
from suite import ELSEWHERE, TESTS, WAITING

from tests.numerics.mutant_list import MUTANTS


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


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_mutants_fit_the_sources(mutant, tmp_path):
    """Each changes a file, and what has to notice exists."""
    path = tmp_path / mutant.file
    path.parent.mkdir(parents=True, exist_ok=True)
    before = (REPOSITORY / "tracer" / mutant.file).read_text()
    path.write_text(before)
    apply(mutant, tmp_path)
    assert path.read_text() != before
    if mutant.tests.startswith("tests/"):
        assert (REPOSITORY / mutant.tests.partition("::")[0]).is_file()
    else:
        assert set(mutant.tests.split(",")) <= set(TESTS)


def test_a_mutant_that_no_longer_fits_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="no longer holds"):
        apply(MUTANTS[0]._replace(file="gone.py", before="nowhere"), _made(tmp_path / "gone.py"))


def _made(path):
    path.write_text("")
    return path.parent
