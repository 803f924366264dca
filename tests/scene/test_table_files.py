"""Tables of effects, cams and curves: read from CSV files, or refused with the line; impulses against all steps."""

from pathlib import Path

import numpy as np
import pytest
from machine_scenes import CART
from refusals import refusal
from scipy.integrate import trapezoid

from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.references import impulse_of

ROWS = ((0.0, 1.5), (0.1, -2.0), (0.25, 3.0))
FORCE = 'effects.e={{type="force",joint="rail",table={}}}'
TEXTS = {
    "bare": "0,1.5\n0.1,-2\n0.25,3\n",
    "named": "t,F\n0.0, 1.5\n\n0.1,-2.0\n0.25,3.0",
    "marked": '\N{ZERO WIDTH NO-BREAK SPACE}"time (s)","force (N)"\r\n"0.0","1.5"\r\n0.1,-2e0\r\n0.25,3\r\n',
    "without a unit": "time [s],force [-]\n0,1.5\n0.1,-2\n0.25,3\n",
    "in units of its own": "time [ms],force of the rear (kN)\n0,0.0015\n100,-0.002\n250,0.003\n",
}


def read(text: str, folder: Path, table: str = '"push.csv"') -> Scene:
    (folder / "push.csv").write_text(text, encoding="utf-8")
    return scene_from_toml(CART, folder, [FORCE.format(table)])


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_the_rows_of_a_file_are_those_of_the_scene(text: str, tmp_path: Path) -> None:
    found = read(text, tmp_path)
    assert found.effects["e"].table == ROWS
    # what results keep needs no file
    assert scene_from_toml(scene_to_toml(found), "/").effects["e"].table == ROWS


def test_cams_and_curves_have_tables_in_files_too(tmp_path: Path) -> None:
    (tmp_path / "lift.csv").write_text("cam [deg],lift [mm]\n0,0\n90,10\n180,20\n270,10\n360,0\n")
    (tmp_path / "wear.csv").write_text("amplitude [MPa],cycles\n100,1e6\n200,1e4\n")
    given = (
        'joints.cam={type="cam",joints=["pivot","rail"],motion="sliding",table="lift.csv"}',
        'outputs.pull={type="stress",body="pole",quantity="stress_max"}',
        'outputs.worn={type="rainflow",of="pull",curve={table="wear.csv"}}',
    )
    found = scene_from_toml(CART, tmp_path, given)
    lift = np.array(found.joints["cam"].table)
    assert lift == pytest.approx(np.transpose([np.linspace(0.0, 2.0 * np.pi, 5), [0.0, 0.01, 0.02, 0.01, 0.0]]))
    assert found.outputs["worn"].curve.table == ((1e8, 1e6), (2e8, 1e4))


def test_columns_are_named(tmp_path: Path) -> None:
    text = "n,F,t\n1,1.5,0\n2,-2,0.1\n3,3,0.25\n"
    assert read(text, tmp_path, '{file="push.csv",x="t",y="F"}').effects["e"].table == ROWS
    motion = 'effects.e={type="prescribed_motion",coordinate="x",table={file="push.csv",x="t",y="F"}}'
    assert scene_from_toml(CART, tmp_path, [motion]).effects["e"].table == ROWS


WRONG = {
    "0,1\n0.1,a\n": "line 2 is '0.1, a'; two finite numbers are needed",
    "t,F\n0,1\n0.1,\n": "line 3 is '0.1, '; two finite numbers are needed",
    "0,1\n0.2,nan\n": "line 2 is '0.2, nan'; two finite numbers",
    "0,1e400\n": "line 1 is '0, 1e400'; two finite numbers",
    "0,1\n0.2,2\n\n0.1,3\n": "line 4: 0.1 follows 0.2; the first column must increase",
    "0,1\n0,2\n": "line 2: 0 follows 0; the first column must increase",
    "0,1,2\n": "line 1 has 3 columns; two are needed, or say which: { file, x, y }",
    "0;1\n": "line 1: columns are separated by commas, and numbers have points; this one is '0;1'",
    "0\t1\n": "line 1: columns are separated by commas",
    "0\n": "line 1 has 1 columns; two are needed",
    "": "there are no numbers in the file",
    "t,F\n": "there are no numbers in the file",
    "t [mm],F\n0,1\n": "effects.e.table[0][0] = \"0.0 mm\": 'mm' is the unit of a length; needed is a time (s)",
    "t [kg],F\n0,1\n1,2\n": "effects.e.table[0][0] = \"0.0 kg\": 'kg' is the unit of a mass; needed is a time (s)",
    "t [s],F [m]\n0,1\n": "effects.e.table[0] = \"1.0 m\": 'm' is the unit of a length; needed is a force (N)",
    "t [s],F [kNs]\n0,1\n": "the brackets in 'F [kNs]' are no unit of its numbers: no such unit; did you mean 'kN'?",
    "t,F (measured)\n0,1\n": "write that unit, or leave the brackets out",
    "0,1e99\n": "0 or a magnitude from",
}


@pytest.mark.parametrize(("text", "said"), WRONG.items(), ids=range(len(WRONG)))
def test_what_is_no_table_is_refused_with_its_line(text: str, said: str, tmp_path: Path) -> None:
    message = refusal(read, text, tmp_path)
    assert message.startswith("effects.e.table") and said in message


NAMED = {
    '{file="push.csv",x="t",y="G"}': "there is no column 'G' in its first line",
    f'{{file="push.csv",x="t",y="{"N" * 5000}"}}': "NNN ...' in its first line",
    '{file="push.csv",x="t"}': 'needed are rows, the name of a CSV file of two columns, or { file = "NAME.csv"',
    '{file="push.csv",columns=2}': "needed are rows, the name of a CSV file",
    "{file=1}": "needed are rows, the name of a CSV file",
    '"pull.csv"': 'effects.e.table = "pull.csv": the file cannot be read (No such file or directory); it is sought in',
    '"bytes.csv"': "no text file in UTF-8",
    '"."': 'effects.e.table = ".": this is a directory; a file of numbers is needed',
    '"/dev/zero"': 'effects.e.table = "/dev/zero": this is a device or a pipe; a file of numbers is needed',
}


@pytest.mark.parametrize(("table", "said"), NAMED.items(), ids=range(len(NAMED)))
def test_what_is_no_file_is_refused(table: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    message = refusal(read, "t,F\n0,1\n", tmp_path, table)
    assert message.startswith("effects.e.table") and said in message


def test_the_folder_of_a_file_that_is_missing_is_named_in_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a scene that is read from where one is, too."""
    monkeypatch.chdir(tmp_path)
    assert refusal(read, "", Path("."), '"pull.csv"').endswith(f"it is sought in {tmp_path.resolve()}")


TABLES = {
    "ramp": [(0.0, 0.0), (0.25, 0.5), (1.0, 0.5)], "pulse within a step": [(0.1, 0.0), (0.101, 8.0), (0.102, 0.0)],
    "changes of sign": [(-0.3, 1.0), (0.21, -2.0), (0.5, 3.0), (0.73, -1.0), (2.0, 0.4)], "one row": [(0.5, 2.0)],
    "before": [(-2.0, 1.0), (-1.0, 3.0)], "after": [(2.0, 1.0), (3.0, 3.0)],
    "rows at the ends of steps": [(0.1, 0.0), (0.2, 1.0), (0.3, 0.0)],
}  # fmt: skip


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
