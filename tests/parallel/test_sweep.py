"""Every scene that comes with the program, every command: what a new user meets, in small (`sweep` has it whole)."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure
from sweep import SCENES, sweep, table

# on two ranks, where asked for (`scripts/test --thorough`): all effects, and solids in the plane; the script takes all
ON_TWO_RANKS = ("slider_crank_effects", "slider_crank_solid2d")
# what the suite has: all effects, joints in space, a loop of three coordinates, and more coordinates than reduced
# models have. Gaps and controllers are in commands/test_combinations.py, runs of the others are compared with full
# order elsewhere, and commands on several ranks in test_more_ranks_than_work.py
IN_SUITE = ("slider_crank_effects", "rssr_beams", "platform_3rrr", "six_joint_arm")
CASES = [(scene, 1) for scene in SCENES] + [(scene, 2) for scene in SCENES if scene.stem in ON_TWO_RANKS]
ROWS = [
    pytest.param(
        scene, n, id=f"{scene.stem}-{n}", marks=() if n == 1 and scene.stem in IN_SUITE else pytest.mark.thorough
    )
    for scene, n in CASES
]


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize(("scene", "ranks"), ROWS)
def test_every_command_ends_as_it_should(scene: Path, ranks: int, tmp_path: Path, monkeypatch) -> None:
    if scene.stem != "rssr_beams":  # whose pictures are drawn
        monkeypatch.setattr(Figure, "savefig", lambda _, path, **given: path.touch())
    endings = sweep(scene, ranks, tmp_path)
    print("\n".join(table(endings, ranks)))
    assert not [(ending.command, ending.faults) for ending in endings if ending.faults]
