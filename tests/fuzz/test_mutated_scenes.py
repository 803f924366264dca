"""Mutated scenes: a report, or a message that names an entry; never a traceback, a numpy warning or a hang.

``PGMP_FUZZ_SCENES`` says how many (200 take half a minute); `tests/fuzz/mutated_scenes.py`
runs them outside of the suite.
"""

import os

from mutated_scenes import run

N_CASES = int(os.environ.get("PGMP_FUZZ_SCENES", "200"))


def test_mutated_scenes() -> None:
    said: list[str] = []
    counts = run(N_CASES, seed=2026, say=said.append)
    assert not said, "\n".join(said)
    # the generator makes all kinds of scenes
    assert min(counts["accepted"] + counts["warned of"], counts["refused"]) > N_CASES // 20
