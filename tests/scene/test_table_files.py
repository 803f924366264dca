"""Tables of effects in CSV files: read as rows that a scene writes, or refused with the line."""

from pathlib import Path

import pytest
from machine_scenes import CART
from refusals import refusal

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml

ROWS = ((0.0, 1.5), (0.1, -2.0), (0.25, 3.0))
FORCE = 'effects.e={{type="force",joint="rail",table={}}}'
TEXTS = {
    "bare": "0,1.5\n0.1,-2\n0.25,3\n",
    "named": "t,F\n0.0, 1.5\n\n0.1,-2.0\n0.25,3.0",
    "marked": '\N{ZERO WIDTH NO-BREAK SPACE}"time (s)","force (N)"\r\n"0.0","1.5"\r\n0.1,-2e0\r\n0.25,3\r\n',
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
    "0,1e99\n": "0 or a magnitude from",
}


@pytest.mark.parametrize(("text", "said"), WRONG.items(), ids=range(len(WRONG)))
def test_what_is_no_table_is_refused_with_its_line(text: str, said: str, tmp_path: Path) -> None:
    message = refusal(read, text, tmp_path)
    assert message.startswith("effects.e.table") and said in message


NAMED = {
    '{file="push.csv",x="t",y="G"}': "there is no column 'G' in its first line",
    '{file="push.csv",x="t"}': 'needed are rows, the name of a CSV file of two columns, or { file = "NAME.csv"',
    '{file="push.csv",columns=2}': "needed are rows, the name of a CSV file",
    "{file=1}": "needed are rows, the name of a CSV file",
    '"pull.csv"': 'effects.e.table = "pull.csv": the file cannot be read (No such file or directory); it is sought in',
    '"."': 'effects.e.table = ".": this is a directory; a file of numbers is needed',
    '"/dev/zero"': 'effects.e.table = "/dev/zero": this is a device or a pipe; a file of numbers is needed',
}


@pytest.mark.parametrize(("table", "said"), NAMED.items(), ids=NAMED)
def test_what_is_no_file_is_refused(table: str, said: str, tmp_path: Path) -> None:
    message = refusal(read, "t,F\n0,1\n", tmp_path, table)
    assert message.startswith("effects.e.table") and said in message


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "push.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="no text file in UTF-8"):
        scene_from_toml(CART, tmp_path, [FORCE.format('"push.csv"')])
