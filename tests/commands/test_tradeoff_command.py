"""``pgmp tradeoff`` as users run it: its file, what is printed, what `info` and `plot` make of it; on 1 and 3 ranks."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from runs import PAPER_SCENE, PGMP, besides_progress, overridden, pgmp

from pgmp_petsc.results import Tradeoff

# a part of the revolution in a fiftieth of the time: enough for everything but accuracy
SMALL = overridden(
    "reduction.modes=4", "reduction.angles=24", "simulation.duration=0.02", "ensemble.batch=8",
    'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}',
)  # fmt: skip
ATTRIBUTES = ("format_version", "program_version", "kind", "scene", "parameters", "seed", "ranks", "remarks")
OUTPUTS = ["crank_angle", "slider_position", "slider_deformation"]


@pytest.fixture(scope="module")
def printed(folder: Path) -> str:
    """Return what the short study prints; its file is ``f.h5``."""
    done = pgmp("tradeoff", PAPER_SCENE, "--quick", "-n", 500, "-o", folder / "f.h5", *SMALL)
    assert besides_progress(done.stderr) == "", "no bar without a terminal"
    return done.stdout


def test_what_is_printed(printed: str, folder: Path) -> None:
    said, *lines = printed.splitlines()
    study = Tradeoff.read(folder / "f.h5")
    assert said == study.reference and said.startswith("reference: the mesh; its runs are predicted to take")
    assert study.reference_model == "full" and not (folder / "f.h5.partial").exists()
    assert lines[0] == f"{folder / 'f.h5'}: {len(study.families)} settings, errors at 8 values of r1, 1 rank(s)"
    assert "crank_angle" in lines[1] and "500 in s" in lines[1]
    for words in ("reference, the scene's meshes", "mesh error, 10 cells", "in every output", "times"):
        assert words in printed
    assert sum(line.startswith(">") for line in lines) >= 1, "the scene as it is"


def test_the_file_keeps_the_contract(printed: str, folder: Path) -> None:
    with h5py.File(folder / "f.h5") as file:
        assert set(ATTRIBUTES) <= set(file.attrs) and file.attrs["kind"] == "tradeoff"
        assert len(file["timings"]) == 3 and file.attrs["samples"] == 500 and file.attrs["quick"]
        n = len(file["settings/family"])
        assert n > 15
        for name in ("errors", "pareto"):
            assert file[name].shape == (n, 3)
        for name in ("offline", "online/batch", "online/single", *(f"settings/{name}" for name in file["settings"])):
            assert file[name].shape == (n,)

        def described(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset):
                assert item.attrs["unit"] and item.attrs["description"], name

        file.visititems(described)
    study = Tradeoff.read(folder / "f.h5")
    assert study.outputs == OUTPUTS
    assert study.record.parameters == {"r1": 5.6e-3}
    assert np.isfinite(study.errors[0]).all()


def test_info_shows_the_table_and_the_advice(printed: str, folder: Path) -> None:
    shown = pgmp("info", folder / "f.h5").stdout
    assert "trade-off study" in shown and "/settings/modes" in shown
    without_times = [line.strip() for line in printed.splitlines()[2:] if not line.endswith(" s")]
    assert set(without_times) <= {line.strip() for line in shown.splitlines()}


def test_plot_draws_three_pictures(printed: str, folder: Path, undrawn: None) -> None:
    done = pgmp("plot", folder / "f.h5", "-o", folder / "out")
    names = ("tradeoff.png", "tradeoff_total.png", "tradeoff_mesh.png")
    assert done.stdout.splitlines() == [str(folder / "out" / name) for name in names]


def test_three_ranks_find_the_same_errors(mpirun: Callable, printed: str, folder: Path) -> None:
    done = mpirun(3, *PGMP, "tradeoff", PAPER_SCENE, "--quick", "-o", folder / "three.h5", *SMALL)
    assert done.stdout.count("3 rank(s)") == 1 and besides_progress(done.stderr) == ""
    one, three = Tradeoff.read(folder / "f.h5"), Tradeoff.read(folder / "three.h5")
    assert three.record.ranks == 3 and three.flags == one.flags and three.reasons == one.reasons
    np.testing.assert_array_equal(three.references.step, one.references.step)
    assert all((times > 0.0).all() for times in (three.wall.offline, three.wall.batch))
    found, expected = ((of.errors, of.references.moved, of.mesh.errors) for of in (three, one))
    for several, alone in zip(found, expected):
        # the eigensolver's random start changes the last digits
        np.testing.assert_allclose(several, alone, rtol=1e-6, atol=1e-12)


def test_pasting_the_advice_gives_the_setting(printed: str, folder: Path) -> None:
    study = Tradeoff.read(folder / "f.h5")
    row = study.families.index("reduced", 3)
    flags = study.flags[row].replace("'", "").split()
    done = pgmp("build", PAPER_SCENE, "-o", folder / "rom.h5", *SMALL, *flags)
    assert f"{study.columns['angles'][row]} angles, {study.columns['coordinates'][row] - 1} modes" in done.stdout
