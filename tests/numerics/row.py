"""One row of the stress suite's table; every module nXX has `run(cases) -> Row`, called small by pytest and large by `make stress`."""

from typing import NamedTuple


class Row(NamedTuple):
    """What a test found."""

    test: str  # N1 ..
    what: str
    cases: int
    failures: int
    worst: float  # largest error met, in the unit of the bound; 0 where there is only right and wrong
    bound: float
    note: str = ""

    def line(self) -> str:
        """The row as text."""
        worst = f"{self.worst:.3g} / {self.bound:.3g}" if self.bound else ""
        verdict = "FAIL" if self.failures or self.worst > self.bound else "ok"
        return f"{self.test:4s} {verdict:4s} {self.cases:>12,d} cases {self.failures:>6d} failures  {worst:22s} {self.what}{'; ' + self.note if self.note else ''}"

    @property
    def good(self) -> bool:
        """No failure, and no error above the bound."""
        return self.failures == 0 and self.worst <= self.bound
