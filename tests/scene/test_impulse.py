"""The impulse of a table, compared with the sum over all steps."""

import numpy as np
import pytest
from scipy.integrate import trapezoid

from pgmp_petsc.scene.references import impulse_of

TABLES = {
    "ramp": [(0.0, 0.0), (0.25, 0.5), (1.0, 0.5)],
    "pulse within a step": [(0.1, 0.0), (0.101, 8.0), (0.102, 0.0)],
    "changes of sign": [(-0.3, 1.0), (0.21, -2.0), (0.5, 3.0), (0.73, -1.0), (2.0, 0.4)],
    "one row": [(0.5, 2.0)],
    "before": [(-2.0, 1.0), (-1.0, 3.0)],
    "after": [(2.0, 1.0), (3.0, 3.0)],
    "rows at the ends of steps": [(0.1, 0.0), (0.2, 1.0), (0.3, 0.0)],
}


@pytest.mark.parametrize("n_steps", [1, 7, 10, 1000])
@pytest.mark.parametrize("name", TABLES)
def test_against_all_steps(name: str, n_steps: int) -> None:
    table, duration = TABLES[name], 1.0
    times, values = np.array(table).T
    ends = np.linspace(0.0, duration, n_steps + 1)
    fine = np.union1d(np.linspace(0.0, duration, 200_001), times[(times > 0) & (times < duration)])
    found = impulse_of(table, duration, n_steps)
    seen = np.interp(ends, times, values)
    scale = np.max(np.abs(values))
    assert found.seen == pytest.approx(trapezoid(seen, ends), abs=1e-13 * scale)
    assert found.largest == pytest.approx(np.max(np.abs(seen)), abs=1e-13 * scale)
    on_fine = np.interp(fine, times, values)
    assert found.exact == pytest.approx(trapezoid(on_fine, fine), abs=1e-13 * scale)
    # the grid misses where the sign changes by up to a spacing of 5e-6 s
    assert found.whole == pytest.approx(trapezoid(np.abs(on_fine), fine), abs=1e-8 * scale)


def test_a_thousand_million_steps() -> None:
    """Time and memory do not grow with the number of steps: an array of them would have 8 GB."""
    assert impulse_of(TABLES["ramp"], 1.0, 10**9).seen == pytest.approx(0.4375, rel=1e-12)
