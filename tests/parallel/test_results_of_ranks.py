"""Runs, tables of modes, models and samples on several ranks: those of one rank.

Small models are shared by ranks here, which otherwise take some thousand unknowns each.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from effect_scenes import EVERYTHING
from machine_scenes import ACROSS, cart
from runs import in_turn, overridden, pgmp

from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Ensemble, ModesTable, Trajectory
from pgmp_petsc.scene import scene_to_toml

BEAMS, EFFECTS, SOLIDS, GEARED, SPACE, SPATIAL_SOLIDS, TURNING = (
    ROOT / "scenes" / f"{name}.toml"
    for name in (
        "slider_crank", "slider_crank_effects", "slider_crank_solid2d", "geared_five_bar", "rssr_beams",
        "slider_crank_solid3d", "quick_return",
    )
)  # fmt: skip
SHARED = "import pgmp_petsc.studies.simulate as study\nstudy.UNKNOWNS_PER_RANK = 1\n"
GRAVITY = 'effects.weight={type="gravity", direction=[0.0, -1.0]}'
SETTLED = overridden("initial.equilibrium=true", "simulation.duration=0.003", "simulation.step=1e-3", GRAVITY)
FREE = (*SETTLED, *overridden('initial.coordinates="free"'))
FEW = overridden("reduction.modes=3", "reduction.angles=12", "reduction.parameter_modes=0", "ensemble.batch=2")
# let go at time zero: waves need small steps
SMALL = overridden("simulation.step=1e-4", "simulation.duration=3e-4")
# springs from the ground to the rod, from the crank to the rod, about the elbow, and a toggle of negative stiffness
PLANE = overridden(
    "effects.buffer.stiffness=2e4",
    'effects.mount={type="bushing",points=["crank:middle","rod:middle"],reference=[[1.0,0.3]],stiffness=[1e4,3e3],'
    "turning_stiffness=[20.0]}",
    'effects.turn={type="spring_damper",joint="elbow",stiffness=-3.0}',
)
IN_SPACE = overridden(
    'effects.mount={type="bushing",points=["crank:tip","rocker:tip"],reference=[[1.0,0.0,0.0],[0.0,1.0,0.0]],'
    "stiffness=[1e3,2e3,3e3],turning_stiffness=[2.0,3.0,4.0]}"
)
# beside the scene's motor, weight, dampings and stop; a softer mount, as it sets in at once
ACTING = overridden(
    "effects.mount.stiffness=[3.0,2.0,1.0]",
    'effects.jet={type="force",point="crank:tip",direction=[0.3,1.0,0.0],follows=true,table=[[0.0,5.0],[1.0,5.0]]}',
    'effects.pull={type="force",point="rocker:tip",towards="ground:pivot",table=[[0.0,1.0],[1.0,1.0]]}',
    'effects.rub={type="joint_friction",joint="rocker_hinge",limit=0.1,speed=0.3}',
    'effects.rope={type="spring_damper",points=["ground:origin","coupler:tip"],stiffness=50.0,damping=0.5,rest=0.1}',
    'effects.turn={type="spring_damper",joint="crank_hinge",stiffness=1.0,damping=0.1,rest=-0.5}',
)
MESH = overridden("joints.mesh.elastic={stiffness=3e3,damping=1.0}")
PART = overridden('coordinates.theta={joint="crank_hinge", range=[-0.6, 0.7]}', "reduction.angles=4")
STRESS = 'outputs.worst={type="stress", body="%s", quantity="von_mises"}'
# few steps, with a torque that sets in at once: all its waves are in the outputs
SUDDEN = overridden(
    "simulation.duration=0.002", "simulation.step=1e-3", "effects.motor.table=[[0.0, 0.0], [0.004, 5.0], [1.0, 5.0]]",
    STRESS % "crank",
)  # fmt: skip
STRESSED = overridden(
    "reduction.modes=3", "reduction.angles=8", "simulation.duration=0.02", "simulation.step=1e-3", STRESS % "rod"
)
OF_ROWS = "test_results_are_those_of_one_rank"
# the reduced model that settles, that of the same start, the number of ranks, the scenes of `EVERYTHING` and `ACROSS`
ROM, OWN, RANKS, EVERY, CART = (object() for _ in range(5))
# forces in the joints of a line that turns, whose nodes are on different ranks; with damping of the scheme and without
FORCED = overridden(
    "simulation.duration=0.03", "simulation.step=1e-3",
    *(f'outputs.{axis}={{type="joint_force", joint="slot", component="{axis}"}}' for axis in "xy"),
    'outputs.hinge={type="joint_force", joint="rocker_hinge", component="x"}',
)  # fmt: skip
TABLE = ("--angles", 5, "--ranks-per-angle", RANKS)
#: What some ranks make, by the files' names.
STARTS = {
    "settled": {
        "reduced": ("montecarlo", ROM, "-n", 3, "--seed", 3),
        "full": ("montecarlo", BEAMS, "--full", *FREE, *FEW, "-n", 3),
        "held": ("simulate", SOLIDS, "--full", *SETTLED, *SMALL),
        "free": ("simulate", SOLIDS, "--full", *FREE),
    },
    "springs": {
        "loaded": ("modes", EFFECTS, *PLANE, *overridden("reduction.preload=true"), *TABLE),
        "space": ("modes", SPACE, *IN_SPACE, *TABLE),
        "geared": ("modes", GEARED, *MESH, *TABLE),
        "run": ("simulate", GEARED, "--full", *MESH, *overridden("simulation.duration=0.005")),
    },
    "run in space": {
        "full": (
            "simulate",
            SPACE,
            "--full",
            *IN_SPACE,
            *ACTING,
            *overridden("simulation.duration=0.003", "simulation.step=1e-3"),
        )
    },
    "model in space": {"rom": ("build", SPACE, *PART, "--ranks-per-angle", RANKS)},
    "solids": {"full": ("simulate", SPATIAL_SOLIDS, "--full", *SUDDEN)},
    "effects": {
        "all": ("simulate", EVERY, "--full", *overridden("effects.stop.upper=0.02", "simulation.duration=0.06")),
        "damped": ("simulate", TURNING, "--full", *FORCED),
        "undamped": ("simulate", TURNING, "--full", *FORCED, *overridden("simulation.spectral_radius=1.0")),
    },
    # what leads is measured on every rank that has what it leads
    "loads": {
        "rom": ("build", CART),
        "reduced": ("simulate", OWN),
        "full": ("simulate", CART, "--full"),
        "components": ("simulate", CART, "--components"),
    },
    "stresses": {"rom": ("build", SOLIDS, "--ranks-per-angle", RANKS, *STRESSED)},
}


@pytest.fixture(scope="module")
def made(request: pytest.FixtureRequest, folder: Path) -> Callable[[str, int], Path]:
    """Return a function that gives the folder of what some ranks make: all that is asked for of them in one start."""
    own = [item for item in request.session.items if item.module is request.module]
    cases = [item.callspec.params for item in own if item.originalname == OF_ROWS]
    asked = {("stresses", 2), *((case["start"], case["n"]) for case in cases)}
    asked |= {(start, 1) for start, _ in asked}

    @cache
    def settled_rom() -> Path:
        pgmp("build", BEAMS, *FREE, *FEW, "-o", folder / "settled_rom.h5")
        return folder / "settled_rom.h5"

    (folder / "every.toml").write_text(EVERYTHING)
    over = cart(*ACROSS, "simulation.duration=0.02", "reduction.angles=6")
    (folder / "cart.toml").write_text(scene_to_toml(over))

    @cache
    def make(n: int) -> None:
        wanted, stand_for = [], {RANKS: n, EVERY: folder / "every.toml", CART: folder / "cart.toml"}
        for start in (start for start in STARTS if (start, n) in asked):
            (folder / f"{start}_{n}").mkdir()
            stand_for[OWN] = folder / f"{start}_{n}" / "rom.h5"
            for name, words in STARTS[start].items():
                words = [settled_rom() if word is ROM else stand_for.get(word, word) for word in words]
                wanted.append([*map(str, words), "-o", str(folder / f"{start}_{n}" / f"{name}.h5")])
        statuses, done = in_turn(n, wanted, before=SHARED)
        # a sample without equilibrium is a record, with exit status 1
        allowed = [{0, 1} if words[0] == "montecarlo" else {0} for words in wanted]
        said = f"{done.stdout}\n{done.stderr}"
        assert len(statuses) == len(wanted) and all(set(own) <= fine for own, fine in zip(statuses, allowed)), said

    def made_by(start: str, n: int) -> Path:
        make(n)
        return folder / f"{start}_{n}"

    return made_by


#: Of starts: ranks, files, what they hold, and the share of the largest value to which outputs and energies agree.
ROWS = [
    ("settled", (2, 3), ("reduced", "full"), Ensemble, 0.0, 0.0),
    # sums in another order, over three steps
    ("settled", (2, 3), ("held", "free"), Trajectory, 1e-8, 1e-6),
    ("springs", (2, 3), ("loaded", "space", "geared"), ModesTable, 1e-9, 0.0),
    # what Newton's method leaves, of four bodies and a spring between two joints of them
    ("springs", (2, 3), ("run",), Trajectory, 1e-8, 1e-6),
    # 240 unknowns, the nodes of a beam on different ranks, with damping: measured 1e-12
    ("run in space", (2,), ("full",), Trajectory, 1e-9, 1e-8),
    ("model in space", (2, 3), ("rom",), ReducedOrderModel, 1e-7, 0.0),
    # Newton's tolerance of 1e-12 in places is 1e-6 of what holds them; balances have the same of all effects
    ("effects", (2, 3), ("all", "damped", "undamped"), Trajectory, 1e-6, 1e-6),
    ("loads", (3,), ("reduced", "full", "components"), Trajectory, 1e-9, 1e-8),
    # 9,000 unknowns on one rank and on two
    ("solids", (2,), ("full",), Trajectory, 1e-9, 1e-8),
]  # fmt: skip
CASES = [(n, start, name, *rest) for start, ranks, names, *rest in ROWS for n in ranks for name in names]


@pytest.mark.parametrize(
    ("n", "start", "name", "kind", "share", "of_energy"),
    CASES,
    ids=[f"{n}-{start}-{name}" for n, start, name, *_ in CASES],
)
def test_results_are_those_of_one_rank(
    made: Callable, n: int, start: str, name: str, kind: type, share: float, of_energy: float
) -> None:
    one, several = (kind.read(made(start, ranks) / f"{name}.h5") for ranks in (1, n))
    if kind is ModesTable:
        assert (one.full_hz[:, 0] < 0.0).any() == (name == "loaded")
        np.testing.assert_allclose(several.full_hz, one.full_hz, rtol=share, atol=share)
        assert several.record.remarks == one.record.remarks
    elif kind is ReducedOrderModel:
        same({part: getattr(several.tables, part) for part in ("mass", "stiffness")}, vars(one.tables), share)
    elif kind is Ensemble:
        assert (one.status == 0).any()
        np.testing.assert_array_equal(several.status, one.status)
        same(several.outputs, one.outputs, share)
    else:
        # a deformation of 0.4 um is a difference of places at 1 m, which have 2.2e-16 m in their last digit
        same(several.outputs, one.outputs, share, {name: 1e-15 for name, unit in one.units.items() if unit == "m"})
        assert start != "settled" or one.balance.strain[0] > 0.0
        assert name != "all" or (len(one.balance.work) == 9 and one.balance.work["stop"][-1] < 0.0), "the stop is hit"
        for part in ("kinetic", "strain"):
            found, wanted = (getattr(run.balance, part) for run in (several, one))
            np.testing.assert_allclose(found, wanted, rtol=of_energy, atol=1e-15, err_msg=part)
        same(several.balance.work, one.balance.work, 1e-6, dict.fromkeys(one.balance.work, 1e-15))
        # free equilibria, where little pulls back, are 4e-12 m apart; a stop that is hit makes more of 1e-12
        off = {"settled": 1e-11, "effects": 1e-8 if name == "all" else 1e-10}.get(start, 1e-12)
        for body, places in one.frames.positions.items():
            np.testing.assert_allclose(several.frames.positions[body], places, atol=off)
        # stresses are derivatives: what displacements are off is ten times as large in them, beside the last digits of
        # places at 1 m, 1e-15 m over an element of 0.04 m of steel
        fields = [
            {f"{body} {name}": values for body, own in run.fields.items() for name, values in own.at_nodes.items()}
            for run in (several, one)
        ]
        largest = max((np.abs(values).max() for values in fields[1].values()), default=0.0)
        same(*fields, 0.0, dict.fromkeys(fields[1], 10.0 * share * largest + 2.1e11 * 1e-15 / 0.04))


def same(found: dict, wanted: dict, share: float, more: dict[str, float] | None = None) -> None:
    """Compare arrays, each to a share of its largest value and what round-off adds."""
    for name, values in found.items():
        allowed = (share * np.abs(wanted[name]).max() if share else 0.0) + (more or {}).get(name, 0.0)
        np.testing.assert_allclose(values, wanted[name], rtol=0, atol=allowed, err_msg=name)


def test_ranks_that_share_a_body_build_its_stresses(made: Callable) -> None:
    """The mesh's displacements are spread over the ranks while the body is condensed."""
    outputs = []
    for n in (1, 2):
        path = made("stresses", n) / "run.h5"
        pgmp("simulate", path.with_name("rom.h5"), "-o", path)
        outputs.append(Trajectory.read(path).outputs)
    # modes of the condensed body are found to 1e-9, and strains are derivatives
    same(outputs[1], outputs[0], 1e-6)
