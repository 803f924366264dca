"""The container's and conda-forge's recipes name what setup.cfg and scripts/setup name; what set-up refuses."""

import configparser
import re
import subprocess

import jinja2
import yaml
from conftest import ROOT, TIMEOUT_SECONDS

import pgmp_petsc

EXTRAS = ("mesh", "plot", "report", "data")
#: conda-forge's names of what has another one in setup.cfg.
ON_CONDA = {"tomli_w": "tomli-w", "matplotlib": "matplotlib-base"}
#: What needs no name in setup.cfg: the interpreter, and what comes with the PETSc at hand.
BESIDE = {"python", "petsc4py", "slepc4py", "mpi4py", "python-gmsh"}


def listed(name: str) -> list[str]:
    """Return the words of a list in scripts/setup."""
    text = (ROOT / "scripts" / "setup").read_text()
    return re.search(rf"{name}=\(\n(.*?)\n\)", text, re.DOTALL)[1].split()


def test_the_conda_recipe_names_the_requirements() -> None:
    text = (ROOT / "packaging" / "meta.yaml").read_text()
    recipe = yaml.safe_load(jinja2.Template(text, undefined=jinja2.Undefined).render(PYTHON="python"))
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    texts = [setup["options"]["install_requires"], *(setup["options.extras_require"][name] for name in EXTRAS)]
    wanted = {ON_CONDA.get(line, line) for text in texts for line in text.split("\n") if line}
    asked = {line.replace(" >=", ">=") for line in recipe["requirements"]["run"]}
    assert {line for line in asked if re.split("[<>=]", line)[0] not in BESIDE} == wanted
    assert f"python{setup['options']['python_requires']}" in asked
    assert recipe["package"]["version"] == pgmp_petsc.__version__
    assert recipe["build"]["entry_points"] == setup["options.entry_points"]["console_scripts"].strip().split("\n")
    assert "noarch" in recipe["build"] and recipe["about"]["license"] == setup["metadata"]["license"]


def test_an_option_that_set_up_does_not_have_is_refused() -> None:
    done = subprocess.run([ROOT / "scripts" / "setup", "--al"], capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    assert done.returncode == 1 and "'--al': there are --all and --tests" in done.stderr


def test_the_container_installs_the_packages_of_set_up() -> None:
    docker = (ROOT / "packaging" / "Dockerfile").read_text()
    installed = re.search(r"--no-install-recommends \\\n(.*?)&&", docker, re.DOTALL)[1].replace("\\", " ").split()
    assert sorted(installed) == sorted([*listed("debian_packages"), "libopenblas0-serial"])
    assert "fast_blas=libopenblas0-serial" in (ROOT / "scripts" / "setup").read_text()
