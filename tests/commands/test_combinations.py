"""Features with kinds of mechanism through a chain of commands: each works, or is refused by name with its cure.

Every feature once, every kind with four or five of them; ``python tests/combinations.py`` tries all with all.
"""

import pytest
from capability_table import table, verdict
from combinations import FEATURES, KINDS, outcome
from conftest import ROOT

from pgmp_petsc.mechanism.capabilities import Purpose

PURPOSES = {
    "check": Purpose.CHECK, "check --effects": Purpose.SIZES, "build": Purpose.BUILD, "modes": Purpose.MODES,
    "simulate": Purpose.REDUCED, "simulate --full": Purpose.FULL, "simulate --components": Purpose.COMPONENTS,
    "montecarlo": Purpose.REDUCED, "montecarlo --full": Purpose.FULL, "montecarlo --components": Purpose.COMPONENTS,
}  # fmt: skip
CHOSEN = [
    (kind, feature) for k, kind in enumerate(KINDS) for f, feature in enumerate(FEATURES) if (f + k) % len(KINDS) == 0
]
CHOSEN = list(dict.fromkeys(CHOSEN + [(f"{count} coordinates", "sampling tolerance") for count in ("two", "three")]))


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize(("kind", "feature"), CHOSEN, ids=[", ".join(pair) for pair in CHOSEN])
def test_it_works_or_is_refused_by_name(kind: str, feature: str) -> None:
    found = outcome(kind, feature)
    assert not {command: result for command, result in found.items() if result.startswith(("TRACEBACK", "failed"))}
    for result in found.values():
        # "refused: entry: why; cure", the entry as a user writes it or the command
        assert result == "fine" or ": " in result.removeprefix("refused: "), result
    # what the checks say beforehand, and docs/capabilities.md with them, is what happens
    said = {command: verdict(kind, feature, purpose) for command, purpose in PURPOSES.items()}
    assert {command for command, why in said.items() if why} == {c for c, r in found.items() if r != "fine"}


def test_the_page_is_what_the_checks_say() -> None:
    assert (ROOT / "docs" / "capabilities.md").read_text() == table() + "\n"


def test_every_feature_and_every_kind_is_chosen() -> None:
    assert {feature for _, feature in CHOSEN} == set(FEATURES) and {kind for kind, _ in CHOSEN} == set(KINDS)
