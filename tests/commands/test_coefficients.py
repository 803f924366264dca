"""A beam that is given by the coefficients of its section, with nothing to read its depth from, in every command."""

from pathlib import Path

from combinations import COEFFICIENTS
from conftest import ROOT
from sweep import sweep, table


def test_every_command_takes_a_section_of_coefficients(tmp_path: Path) -> None:
    text = (ROOT / "scenes" / "slider_crank.toml").read_text()
    circle = 'material = "steel"\nsection = { shape = "circle", radius = "r1" }'
    assert text.count(circle) == 1
    # the crank's, and the parameter goes to the rod
    text = text.replace(circle, f"section = {COEFFICIENTS}").replace("radius = 5.6e-3", 'radius = "r1"')
    text = text.replace('"../meshes', f'"{ROOT}/meshes')
    scene = tmp_path / "coefficients.toml"
    scene.write_text(text)
    endings = sweep(scene, 1, tmp_path)
    print("\n".join(table(endings, 1)))
    assert not [(ending.command, ending.faults) for ending in endings if ending.faults]
    assert {"simulate", "montecarlo", "simulate --full", "montecarlo --full", "plot", "export run"} <= {
        ending.command for ending in endings
    }
    # strain is curvature times half the depth, which coefficients do not tell
    assert any("strain" in ending.out for ending in endings if ending.command == "simulate")
