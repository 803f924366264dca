"""Samples from a file: what is read, and what is refused with its line."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sample_file import read_samples
from pgmp_petsc.ensemble.sampling import Sampler, sampler_remarks
from pgmp_petsc.scene import Scene
from scenes import slider_crank

RADII = [5e-3, 5.5e-3, 6e-3]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return slider_crank(
        'parameters.r1={nominal=5.6e-3, bounds=[1e-3, 12e-3], distribution={name="norm", loc=5.6e-3, scale=1e-3}}',
        'parameters.r1.unit="m"', "parameters.rho={nominal=7800.0}", 'materials.steel.rho="rho"',
    )  # fmt: skip


def csv(folder: Path, text: str) -> Path:
    path = folder / "s.csv"
    path.write_text(text)
    return path


def test_columns_of_parameters_are_taken_and_others_named(scene: Scene, tmp_path: Path) -> None:
    path = csv(tmp_path, "\ufeffrun, rho, r1\n1, 7800, 5e-3\n\n2, 7900.5, 5.5e-3\n3, 7700, 6e-3\n")
    file = read_samples(path, scene, None)
    sampler = Sampler(scene, Plan(3, 0, file=file))
    assert sampler.kind == "file" and sampler.names == ["r1", "rho"] and sampler.extends
    found = sampler.draw(1, 3)
    np.testing.assert_array_equal(found["r1"], RADII[1:])
    np.testing.assert_array_equal(found["rho"], [7900.5, 7700.0])
    texts = [remark.text for remark in sampler_remarks(scene, Plan(3, 0, file=file))]
    assert f"columns of '{path}' that are no parameters have no part: run" in texts
    assert any("which nothing here can check" in text for text in texts)
    np.testing.assert_array_equal(read_samples(path, scene, 2).values["r1"], RADII[:2])
    identity = file.identity
    path = csv(tmp_path, "sample,status,r1 (m),angle (rad)\n0,0,5e-3,0.1\n1,0,5.5e-3,0.2\n2,0,6e-3,0.3\n")
    file = read_samples(path, scene, None)
    assert file.identity != identity
    np.testing.assert_array_equal(file.values["r1"], RADII)
    assert [remark.text for remark in file.remarks] == [
        f"columns of '{path}' that are no parameters have no part: sample, status, angle (rad)"
    ]
    np.testing.assert_array_equal(Sampler(scene, Plan(2, 0, file=file)).draw(0, 2)["rho"], 7800.0)


@pytest.mark.parametrize("group", ["", "parameters/"])
def test_data_sets_are_columns(scene: Scene, tmp_path: Path, group: str) -> None:
    path = tmp_path / "s.h5"
    with h5py.File(path, "w", userblock_size=512) as file:  # as results of this program have
        file[f"{group}r1"] = RADII
        file[f"{group}other"] = ["a", "b", "c"]
    found = read_samples(path, scene, None)
    np.testing.assert_array_equal(found.values["r1"], RADII)
    assert list(found.values) == ["r1"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "there is no column 'r1', an uncertain parameter; it has none at all"),
        ("r_1\n5e-3\n", "there is no column 'r1', an uncertain parameter; did you mean 'r_1'?"),
        ("r1\n", "there are no samples in it, only a first line of names"),
        ("r1\n5e-3\nthick\n", "line 3: r1 = 'thick'; a number is needed"),
        ("rho,r1\n7800,5e-3\n7800,\n", "line 3: r1 = nothing; a number is needed"),
        ("rho,r1\n7800,5e-3\n7800\n", "line 3 has 1 entries; the first line names 2 columns"),
        ("r1\n5e-3\nnan\n", "line 3: r1 = nan; a finite number is needed"),
        ("r1\n5e-3\n\ninf\n", "line 4: r1 = inf; a finite number is needed"),
        ("r1\n5e-3\n0.5e-3\n", "line 3: r1 = 0.0005; must lie in parameters.r1.bounds, [0.001, 0.012]"),
        ("r1,rho\n5e-3,-1\n", "line 2: rho = -1; must be positive for what uses it"),
        ("r1 (mm)\n5\n", "the column 'r1 (mm)' has to be in m: convert it, and name it 'r1'"),
        ("r1,rho (g/cm3)\n5e-3,7.8\n", "the column 'rho (g/cm3)' has to be in kg/m3: convert it, and name it"),
        ("rho;r1\n7800;0,005\n", "columns are separated by semicolons ('rho;r1'); commas are needed"),
        ("r1,r1\n5e-3,5e-3\n", "2 columns are called 'r1'; one is needed"),
        ("r1\n" + "1\n" * 20, "... and 2 more problems"),
    ],
)
def test_a_bad_table_is_one_message_with_its_line(scene: Scene, tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_samples(csv(tmp_path, text), scene, None)
    assert message in str(caught.value)
    assert str(caught.value).startswith("--samples ")


def test_negative_damping_is_refused_with_its_line(tmp_path: Path) -> None:
    loss = 'effects.loss={type="joint_damping",joint="crank_hinge",coefficient="c"}'
    scene = slider_crank("parameters.c={nominal=1.0}", loss, "parameters.r1.distribution={name='norm',scale=1e-3}")
    with pytest.raises(InputError, match="line 3: c = -2; must not be negative for what uses it"):
        read_samples(csv(tmp_path, "r1,c\n5e-3,0\n5e-3,-2\n"), scene, None)


def test_ends_of_a_stop_that_cross_are_refused_with_their_line(tmp_path: Path) -> None:
    stop = 'effects.stop={type="end_stop",joint="crank_hinge",stiffness=10.0,lower=-1.0,upper="end"}'
    scene = slider_crank("parameters.end={nominal=1.0}", stop, "parameters.r1.distribution={name='norm',scale=1e-3}")
    with pytest.raises(InputError, match=r"line 3: effects\.stop\.lower = -1; must be below upper, -2"):
        read_samples(csv(tmp_path, "r1,end\n5e-3,0.5\n5e-3,-2\n"), scene, None)
    # lines beyond -n are not looked at
    assert read_samples(csv(tmp_path, "r1,end\n5e-3,0.5\n5e-3,-2\n"), scene, 1).values["end"].tolist() == [0.5]


def test_a_data_set_in_another_unit_is_refused(scene: Scene, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "s.h5", "w") as file:
        file["r1"] = np.full(2, 5e-3)
        file["r1"].attrs["unit"] = "m"
    assert read_samples(tmp_path / "s.h5", scene, None).values["r1"].tolist() == [5e-3, 5e-3]
    with h5py.File(tmp_path / "s.h5", "a") as file:
        file["r1"].attrs["unit"] = "mm"
    with pytest.raises(InputError, match=r"the column 'r1 \(mm\)' has to be in m: convert it"):
        read_samples(tmp_path / "s.h5", scene, None)


def test_no_table_at_all(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        read_samples(tmp_path / "no.csv", scene, None)
    (tmp_path / "b.csv").write_bytes(b"r1\n\xff\xfe\n")
    with pytest.raises(InputError, match="it cannot be read as CSV or HDF5"):
        read_samples(tmp_path / "b.csv", scene, None)
    with pytest.raises(InputError, match=r"-n 4: --samples .* has 1 samples; give at most so many"):
        read_samples(csv(tmp_path, "r1\n5e-3\n"), scene, 4)
    fixed = slider_crank()
    with pytest.raises(InputError, match="none of its columns is a parameter of the scene"):
        read_samples(csv(tmp_path, "x\n5e-3\n"), fixed, None)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"r1": np.zeros((2, 2))}, r"data set '/r1' has shape \(2, 2\)"),
        ({"r1": np.array([b"a"])}, r"data set '/r1' has shape \(1,\) and type"),
        ({"r1": np.zeros(0)}, r"data set '/r1' has shape \(0,\)"),
        ({"r1": np.full(2, 5e-3), "rho": np.full(3, 7e3)}, "columns differ in length: r1 2, rho 3"),
        ({"r1": np.array([5e-3, np.nan])}, "sample 1: r1 = nan; a finite number is needed"),
    ],
)
def test_bad_data_sets(scene: Scene, tmp_path: Path, content: dict, message: str) -> None:
    with h5py.File(tmp_path / "s.h5", "w") as file:
        for name, values in content.items():
            file[name] = values
    with pytest.raises(InputError, match=message):
        read_samples(tmp_path / "s.h5", scene, None)
