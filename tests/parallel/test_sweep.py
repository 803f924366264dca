"""Every scene that comes with the program, every command, 1 and 2 ranks: what a new user meets, in small."""

from __future__ import annotations

from pathlib import Path

import pytest
from sweep import SCENES, sweep, table


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("scene", SCENES, ids=[scene.stem for scene in SCENES])
def test_every_command_ends_as_it_should(scene: Path, ranks: int, tmp_path: Path) -> None:
    endings = sweep(scene, ranks, tmp_path)
    print("\n".join(table(endings, ranks)))
    assert not [(ending.command, ending.faults) for ending in endings if ending.faults]
