"""Scenes with something wrong in them, and what `pgmp check` may answer: a report, or a message that names an entry.

    .venv/bin/python tests/fuzz/mutated_scenes.py 10000 --seed 1      prints what went wrong, and counts

The cases of a seed are always the same: ``--first N`` with a count of 1 does one of them again.
"""

import argparse
import copy
import math
import os
import random
import signal
import sys
import tempfile
import time
import tomllib
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w
from coupled_scenes import CAM, GEARED, RACK, ROTORS, ROTORS_IN_SPACE, SCREW
from elastic_scenes import ROTOR
from machine_scenes import EVERYTHING, IN_PLANE, cart
from mpi4py import MPI
from offset_scenes import clamped_beam, offset

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.studies.check import describe_scene
from pgmp_petsc.studies.inputs import read_scene
from scenes import tables

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 60  # s of processor time of a case, against loops
WAITING = 600  # s of a case, against waiting for ever on a busy machine
LONGEST_LINE = 1500  # characters
NUMBERS = (
    0, -1, 1, 2, 3, 7, 10**18, -(10**18), 10**400, 0.0, -0.0, 1e-320, 5e-324, 1e-30, 1e-9, 1e-3, 0.5, 1.5, -2.5, 1e3,
    1e9, 1e29, 1e30, 1e100, 1e300, 1.7e308, math.inf, -math.inf, math.nan,
)  # fmt: skip
TEXTS = (
    "", " ", "x", "theta", "crank", "ground", "ground:origin", "crank:tip", "crank:0", "crank:999", "rod:-1", ":",
        "a:b:c",
    "spline", "auto", "circle", "N" * 5000, "é", "\u0000", "a\nb", "../" * 50, "/dev/zero", "/dev/null", "/",
        "nothing.msh",
    "pipe.msh", "directory.msh", "words.msh", "half.msh", "words.off", "words.ply", "words.vtu", "norm", "GPa", "mm",
        "K",
    "m**9**9", "5 mm", "30 deg", "1 kg", "9 mmm", "-", "%", "N" * 200 + "/x.msh", "1e400", "true",
    "torque.csv", "unsorted.csv", "words.csv", "columns.csv", "semicolons.csv", "directory.msh/x.csv", "mesh", "input",
    "sin(s", "s / 0", "1 / (s - s)", "s" * 200, "min(s)", "__import__('os')", "9 ** 9 ** 9", "2 Hz", "1 N m",
)  # fmt: skip
STRUCTURES: tuple[Any, ...] = (
    True, False, [], {}, [[]], [1], [1, 2], [0.0, 1.0], [1, 2, 3], [[0, 1], [1, 2]], {"a": 1},
)  # fmt: skip
#: What tables of scenes name, in the folder of the scene.
CSV = {
    "torque.csv": "t (s),T (N m)\n0.0,0.0\n0.1,0.5\n1.0,0.5\n",
    "unsorted.csv": "0.0,1.0\n0.2,1.0\n0.1,2.0\n",
    "words.csv": "t,T\n0.0,0.0\n0.1,much\n",
    "columns.csv": "t,T,P\n0.0,0.0,1.0\n0.1,0.5,2.0\n",
    "semicolons.csv": "0,0;1,5\n1,0;2,5\n",
}
#: A belt with parameters for its pulleys, with tables in files and over another joint; gears that give way; an arm that
#: slides in the plane, with texts in units; a sum of motions.
BELT = ROTORS.replace('"gear"', '"belt"').replace("ratio = -0.37", 'radii = ["r", 0.1]')
BELT += """
[parameters]
r = { nominal = 40.0, unit = "mm", bounds = [30.0, 50.0] }
[effects]
measured = { type = "torque", joint = "output", table = "torque.csv" }
named = { type = "torque", joint = "output", table = { file = "columns.csv", x = "t", y = "T" }, scale = 0.5 }
gas = { type = "torque", joint = "output", over = "input", table = [["0 deg", 0.2], [1.0, "100 N mm"]] }
cogging = { type = "law", joint = "output", over = "input", force = "A * sin(12 * s) - t", constants = { A = 0.1 } }
"""
GEARS = (
    ROTORS_IN_SPACE
    + """
[joints.mesh.elastic]
stiffness = "k"
damping = 0.1
[parameters]
k = { nominal = 500.0, unit = "N m/rad", distribution = { name = "norm", loc = 500.0, scale = 20.0 } }
"""
)
PRESS = (
    IN_PLANE
    + """
[parameters]
c = { nominal = 2.0, unit = "N s/m" }
[effects]
push = { type = "force", joint = "rail", over = "rail", table = [["-200 mm", 5.0], ["0.5 m", "2 N"]] }
law = { type = "law", joint = "rail", force = "-c * v - 10 * max(s - 0.1, 0) ** 1.5", constants = { c = "c" } }
slide = { type = "point_friction", point = "arm:tip", direction = [1.0, 0.0], limit = 0.1, speed = "10 mm/s" }
stop = { type = "end_stop", joint = "rail", lower = "-15 cm", upper = 0.4, stiffness = "5 N/mm", damping = 0.0 }
held = { type = "bushing", points = ["ground:origin", "arm:tip"], reference = [[1.0, 0.0]], stiffness = [0.0, 5.0] }
[fields.modulus]
body = "arm"
quantity = "E"
variation = 0.1
length = "20 cm"
terms = 2
"""
)
MESH = 'type = "gear"\njoints = ["input", "output"]\nratio = -1.0'
SUM = GEARED.replace(MESH, 'type = "coupling"\nterms = { input = 1.0, output = "share" }')
SUM += "\n[parameters]\nshare = { nominal = 1.0, bounds = [0.9, 1.1] }\n"
BYTES = (b"\0", b"\xff", b"\xef\xbb\xbf", b"[", b"]", b"\n", b'"', b"=", b"9" * 5000)


@dataclass(frozen=True)
class Case:
    """A scene file and options of the command line."""

    content: bytes
    overrides: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()


class Hang(BaseException):
    """A case took longer than `LIMIT` or `WAITING`."""


def prepare(folder: Path) -> Path:
    (folder / "meshes").symlink_to(ROOT / "meshes")
    (folder / "scenes").mkdir()
    scenes = folder / "scenes"
    os.mkfifo(scenes / "pipe.msh")
    (scenes / "directory.msh").mkdir()
    for name in ("words.msh", "words.off", "words.ply", "words.vtu"):
        (scenes / name).write_text("these are words\n1 2 3\n")
    for name, text in CSV.items():
        (scenes / name).write_text(text)
    whole = (ROOT / "meshes" / "crank_5.msh").read_bytes()
    (scenes / "half.msh").write_bytes(whole[: len(whole) // 2])
    return scenes / "scene.toml"


#: Outputs of fatigue and of forces, behind the tables of a scene with a body `rod`.
WEAR = tables("""
outputs.worn_by: type = "stress"; body = "rod"; quantity = "stress_max"
outputs.damage: type = "rainflow"; of = "worn_by"; curve = { exponent = 5.0, reference = 1e8, cycles = 1e6 };
    mean_stress = "goodman"; ultimate = 6e8
outputs.life: type = "rainflow"; of = "worn_by"; curve = { table = [[1e7, 1e9], [1e8, 1e6]] }; quantity = "life";
    run_out = 1e12
""")


def bases() -> list[dict[str, Any]]:
    """Return the tables of the shipped scenes, and of machines with all that slides, with couplings, with joints that
    are elastic or off, with tables in files, texts with units, in mm, and with what wears; with short ranges, so that
    assembling takes no time."""
    found = []
    texts = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "scenes").glob("*.toml"))]
    off = clamped_beam(offset("right", place=[1e-5, "d"], turn=[1e-4]), "parameters.d={nominal=1e-5}")
    texts += [scene_to_toml(cart(*EVERYTHING)), RACK, SCREW, CAM, scene_to_toml(off), BELT, GEARS, PRESS, SUM, ROTOR]
    texts.append(RACK.replace("[scene]", '[scene]\nunits = "mm"'))
    texts.append((ROOT / "scenes" / "slider_crank.toml").read_text(encoding="utf-8") + WEAR)
    for data in map(tomllib.loads, texts):
        for name, coordinate in data["coordinates"].items():
            start = data.get("simulation", {}).get("initial", {}).get(name, {}).get("position", 0.5)
            coordinate.update(range=[start - 0.05, start + 0.05], periodic=False)
            data.setdefault("simulation", {}).setdefault("initial", {}).setdefault(name, {})["position"] = start
        for effect in data.get("effects", {}).values():
            if effect["type"] == "prescribed_motion":
                data["simulation"]["initial"].pop(effect["coordinate"])
        found.append(data)
    return found


def case_of(seed: int, number: int, scenes: list[dict[str, Any]]) -> Case:
    rng = random.Random(f"{seed}:{number}")
    data = copy.deepcopy(rng.choice(scenes))
    kind = rng.random()
    if kind < 0.15:  # changes of the text
        return Case(_garbled(tomli_w.dumps(data).encode(), rng))
    if kind < 0.35:  # the command line
        overrides = tuple(_override(data, rng) for _ in range(rng.choice((1, 1, 1, 2, 4))))
        settings = (rng.choice(("", "=", "r1", "r1=", "r1=x", "r1=1e400", "r1=-1", "q=1", "r1=5e-3", "r1=nan")),)
        return Case(tomli_w.dumps(data).encode(), overrides, settings if rng.random() < 0.2 else ())
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        rng.choice(MUTATIONS)(data, rng)
    return Case(_toml(data).encode("utf-8", "surrogatepass"))


def failure_of(case: Case, path: Path) -> tuple[str, str]:
    """Check a case as ``pgmp check`` does: how it ended (accepted, warned of, refused or wrong), and what is wrong."""
    path.write_bytes(case.content)

    def hang(*_: object) -> None:
        raise Hang

    before = {number: signal.signal(number, hang) for number in (signal.SIGALRM, signal.SIGPROF)}
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    signal.setitimer(signal.ITIMER_REAL, WAITING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            scene, meshes = read_scene(path, case.overrides, case.settings, MPI.COMM_SELF, Purpose.CHECK)
            describe_scene(scene, meshes)
    except InputError as error:
        strange = _message(str(error))
        return "wrong" if strange else "refused", strange
    except Hang:
        return "wrong", f"takes more than {LIMIT} s of processor time, or waits for {WAITING} s"
    except BaseException as error:  # whatever it is, a user should not see it
        return "wrong", "".join(traceback.format_exception(error.__cause__ or error)[-4:])
    finally:
        for timer in (signal.ITIMER_PROF, signal.ITIMER_REAL):
            signal.setitimer(timer, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
    return "warned of" if getattr(scene, "remarks", ()) else "accepted", ""


def _message(text: str) -> str:
    if not text.strip():
        return "an empty message"
    if "Traceback" in text or "\0" in text:
        return f"a strange message: {text[:300]!r}"
    if len(text.splitlines()) > 20 or max(map(len, text.splitlines())) > LONGEST_LINE:
        return f"a long message: {text[:300]!r}"
    named = text.startswith("--") or any(sign in text for sign in (": ", " = "))
    return "" if named else f"no entry named: {text[:300]!r}"


def _places(data: dict[str, Any]) -> list[tuple[Any, Any]]:
    """Return all entries of nested tables and lists, as their holder and key."""
    found, waiting = [], [data]
    while waiting:
        holder = waiting.pop()
        for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
            found.append((holder, key))
            if isinstance(holder[key], (dict, list)):
                waiting.append(holder[key])
    return found


def _delete(data: dict[str, Any], rng: random.Random) -> None:
    holder, key = rng.choice(_places(data) or [({0: 0}, 0)])
    del holder[key]


def _number(data: dict[str, Any], rng: random.Random) -> None:
    numeric = [p for p in _places(data) if isinstance(p[0][p[1]], (int, float))] or [({0: 0}, 0)]
    holder, key = rng.choice(numeric)
    value = holder[key] if abs(holder[key]) < 1e290 else 1e290  # an integer that no float holds
    holder[key] = rng.choice((*NUMBERS, value * 10.0 ** rng.randint(-12, 12), -value))


def _type(data: dict[str, Any], rng: random.Random) -> None:
    holder, key = rng.choice(_places(data) or [({0: 0}, 0)])
    holder[key] = copy.deepcopy(rng.choice((*NUMBERS, *TEXTS, *STRUCTURES)))


def _text(data: dict[str, Any], rng: random.Random) -> None:
    texts = [p for p in _places(data) if isinstance(p[0][p[1]], str)] or [({0: 0}, 0)]
    holder, key = rng.choice(texts)
    others = [h[k] for h, k in texts]
    holder[key] = rng.choice(TEXTS) if rng.random() < 0.5 else rng.choice(others)


def _swap(data: dict[str, Any], rng: random.Random) -> None:
    places = _places(data) or [({0: 0}, 0)]
    (a, i), (b, j) = rng.choice(places), rng.choice(places)
    a[i], b[j] = copy.deepcopy(b[j]), copy.deepcopy(a[i])


def _rename(data: dict[str, Any], rng: random.Random) -> None:
    tables = [p for p in _places(data) if isinstance(p[0], dict) and isinstance(p[1], str)] or [({"a": 0}, "a")]
    holder, key = rng.choice(tables)
    name = rng.choice(
        (key[:-1] or "x", key + "s", key.upper(), "", "a b", "a.b", "/", "..", "x" * 300, "ground", "time")
    )
    holder[name] = holder.pop(key)


def _duplicate(data: dict[str, Any], rng: random.Random) -> None:
    tables = [p for p in _places(data) if isinstance(p[0], dict) and isinstance(p[0][p[1]], dict)] or [({"a": 0}, "a")]
    holder, key = rng.choice(tables)
    for k in range(rng.choice((1, 1, 2, 30))):
        holder[f"{key}_{k}"] = copy.deepcopy(holder[key])


def _nest(data: dict[str, Any], rng: random.Random) -> None:
    holder, key = rng.choice(_places(data) or [({0: 0}, 0)])
    for _ in range(rng.choice((1, 3, 20, 60))):
        holder[key] = [holder[key]] if rng.random() < 0.5 else {"a": holder[key]}


def _add(data: dict[str, Any], rng: random.Random) -> None:
    """Add entries that scenes have elsewhere."""
    joints = data.get("joints")
    named = list(joints) if joints and isinstance(joints, dict) else ["a"]
    extra = rng.choice(
        (
            ("effects", "extra", {"type": rng.choice(("gravity", "end_stop", "joint_friction", "mode_inertia",
                "point_mass", "law", "base_motion", "force", "torque", "bushing", "free_play",
                                                      "geometric_stiffening", "spring_damper", "structural_damping"))}),
            ("parameters", "extra", {"nominal": rng.choice(NUMBERS), "unit": rng.choice(TEXTS)}),
            ("parameters", "r1", {"nominal": 5.6, "unit": rng.choice(("mm", "m", "GPa", "in", "kg", "deg"))}),
            ("reduction", "tolerance", rng.choice(NUMBERS)),
            ("simulation", "tolerance", rng.choice(NUMBERS)),
            ("reduction", "sampling_tolerance", rng.choice(NUMBERS)),
            ("simulation", "initial", {"theta": {"position": rng.choice(NUMBERS), "velocity": rng.choice(NUMBERS)}}),
            ("ensemble", "bins", rng.choice(NUMBERS)),
            ("joints", "extra", {"type": rng.choice(("gear", "belt", "rack", "screw", "cam", "coupling", "prismatic")),
                                 "joints": [rng.choice(named) for _ in "ab"],
                                 "ratio": rng.choice(NUMBERS)}),
            ("scene", "units", rng.choice(("mm", "SI", "inch", 1))),
            ("initial", "equilibrium", True),
            ("materials", "extra", {"E": rng.choice(NUMBERS), "nu": 0.3, "rho": rng.choice(NUMBERS)}),
        )
    )  # fmt: skip
    table = data.setdefault(extra[0], {})
    if isinstance(table, dict):
        table[extra[1]] = extra[2]


MUTATIONS: tuple[Callable[[dict[str, Any], random.Random], None], ...] = (
    _delete, _number, _number, _number, _type, _text, _text, _swap, _rename, _duplicate, _nest, _add, _add,
)  # fmt: skip


def _toml(data: dict[str, Any]) -> str:
    try:
        return tomli_w.dumps(data)
    except Exception:  # what TOML cannot say, such as a number for a key
        return f"x = {str(data)[:200]}"


def _garbled(content: bytes, rng: random.Random) -> bytes:
    """Return a text with bytes changed, left out, repeated or cut off."""
    content = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 5, 20))):
        place, n = rng.randrange(len(content) + 1), rng.choice((1, 1, 5, 100))
        choice = rng.randrange(7)
        if choice == 0:
            content[place : place + 1] = bytes([rng.randrange(256)])
        elif choice == 1:
            del content[place : place + n]
        elif choice == 2:
            content[place:place] = content[place : place + n]
        elif choice == 3 and rng.random() < 0.3:
            del content[place:]
        elif choice == 4:
            content[place:place] = rng.choice(BYTES)
        elif choice == 5:
            content[0:0] = rng.choice((b"\xef\xbb\xbf", b"\xff\xfe", b""))
        elif choice == 6 and rng.random() < 0.1:
            content[place:place] = b"x = " + b"[" * 3000 + b"]" * 3000 + b"\n"
    return bytes(content)


def _override(data: dict[str, Any], rng: random.Random) -> str:
    keys, holder = [], data
    while isinstance(holder, dict) and holder and (not keys or rng.random() < 0.9):
        key = rng.choice(list(holder))
        keys.append(key if key.replace("_", "").isalnum() else f'"{key}"')
        holder = holder[key]
    if rng.random() < 0.1:
        keys += ["a"] * rng.choice((1, 5, 2000))
    value = rng.choice((*map(repr, NUMBERS), *(f'"{text}"' for text in TEXTS if "\0" not in text), "[]", "{}", "true",
        "x",
                        "", "[" * 3000, "=", "{a = 1}", "1979-05-27", "[[0.0, 1.0], [1.0, 2.0]]",
                            "[0, 1000]"))  # fmt: skip
    return ".".join(keys) + rng.choice(("=", "=", "=", "=", "==", "", " = ")) + value


def run(n_cases: int, seed: int, first: int = 0, say: Callable[[str], None] = print) -> Counter[str]:
    """Check cases, say what is wrong, and return how many ended how."""
    counts: Counter[str] = Counter()
    scenes = bases()
    with tempfile.TemporaryDirectory() as folder:
        path = prepare(Path(folder))
        for number in range(first, first + n_cases):
            case = case_of(seed, number, scenes)
            ending, failure = failure_of(case, path)
            counts[ending] += 1
            if failure:
                say(f"case {number} of seed {seed}: {failure}")
    return counts


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("n_cases", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    start = time.perf_counter()
    result = run(given.n_cases, given.seed, given.first)
    print(f"{given.n_cases} cases in {time.perf_counter() - start:.0f} s: {dict(result)}")
    sys.exit(result["wrong"] > 0)
