"""Places on the way of a search whose runs stop before their end: the search turns back from there, and says so."""

from __future__ import annotations

from dataclasses import dataclass

from pgmp_petsc.runtime.errors import PgmpError
from pgmp_petsc.runtime.remarks import Remark, warning


@dataclass
class TurnedBack:
    """What a search turned back from.

    Attributes
    ----------
    count
        How often.
    first
        The first place and the reason, in words.
    """

    count: int = 0
    first: str = ""

    def add(self, error: PgmpError) -> None:
        """Take in one more."""
        self.count, self.first = self.count + 1, self.first or str(error)

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """What the reader of a result has to know."""
        if not self.count:
            return ()
        often = "once" if self.count == 1 else f"{self.count} times"
        return (
            warning(
                f"the search turned back {often} from where no run comes to its end, first {self.first}; what lies "
                "beyond was not searched, and what was found may stand at its edge: begin there (--set), or let bounds "
                "leave such places out"
            ),
        )
