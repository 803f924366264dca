"""What contacts cost, measured on a small scene."""

from pathlib import Path

import pytest
from runs import rom_of

from benchmarks import contacts
from pgmp_petsc.base.errors import InputError
from scenes import slider_crank

SMALL = (
    "reduction.modes=2", "reduction.angles=12", "simulation.duration=0.1", "simulation.step=1e-3",
    "parameters.r1={nominal=5.6e-3,distribution={name='norm',loc=5.6e-3,scale=1e-4}}",
)  # fmt: skip
STOP = (
    "effects.stop={type='end_stop',joint='slider',upper=0.97,stiffness=2e4}",
    "simulation.initial.theta={position=0.5,velocity=-2.0}",
)


def test_contacts_are_counted_and_timed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contacts, "REPEATS", 1)
    path = tmp_path / "rom.h5"
    rom_of(slider_crank(*SMALL, *STOP)).write(path)
    table = contacts.measure(path, [2, 3])
    assert [row[0] for row in table.rows] == ["2", "3"]
    # each sample enters the stop once, and leaves it
    assert [row[4] for row in table.rows] == ["4", "6"]
    assert all(float(row[1]) > 0.0 and float(row[3]) > 0.0 for row in table.rows)


def test_a_scene_without_stops_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rom.h5"
    rom_of(slider_crank(*SMALL)).write(path)
    with pytest.raises(InputError, match="has no end_stop; give a ROM of one that has"):
        contacts.measure(path, [2])
