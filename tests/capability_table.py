"""What works with which kind of mechanism, as a table: asked of the checks that every command passes.

    .venv/bin/python tests/capability_table.py > docs/capabilities.md

Each cell is a scene of `combinations`, read and checked as every command does it. That the cells are true is what
`combinations` tries.
"""

from combinations import FEATURES, KINDS, scene_of

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.scene import scene_from_toml, scene_to_toml

OF_REDUCED = (Purpose.BUILD, Purpose.REDUCED)
MODELS = ("reduced", "full", "components")
#: Commands that are a feature of their own, tried on plain scenes with some overrides.
COMMANDS = {
    "`pgmp check --effects`": (Purpose.SIZES,),
    "`pgmp build` by tolerance": (Purpose.BUILD, "reduction.tolerance=0.01"),
    "`pgmp tradeoff`": (Purpose.TRADEOFF,),
    "`pgmp export`": (Purpose.EXPORT,),
}
OPENING = (
    "# What works with which kind of mechanism\n"
    "\n"
    "**all**: in reduced, full-order and component runs (`--components`), single and in ensembles; otherwise the "
    "models\n"
    "that have it, or **no**: none of them. A number tells the reason below, as the program says it of a small scene "
    "of that\n"
    "kind; beside **all** it is that of `pgmp modes`. A mechanism whose bodies are all rigid has no reduced model.\n"
    "\n"
    "`python tests/capability_table.py > docs/capabilities.md` makes this page from the checks that every command "
    "passes;\n"
    "`python tests/combinations.py` tries every cell.\n"
)


def verdict(kind: str, feature: str, purpose: Purpose) -> str:
    """Return why a command refuses a feature with a kind of mechanism; empty where it takes it."""
    try:
        check_capabilities(scene_of(kind, feature), purpose)
    except InputError as error:
        return str(error)
    return ""


def cell(kind: str, feature: str) -> tuple[str, tuple[str, ...]]:
    """Return which models have it, in words, and the reasons why not more."""
    of_reduced = next(filter(None, (verdict(kind, feature, purpose) for purpose in OF_REDUCED)), "")
    others = (verdict(kind, feature, purpose) for purpose in (Purpose.FULL, Purpose.COMPONENTS))
    reasons = dict(zip(MODELS, (of_reduced, *others)))
    having = [name for name, reason in reasons.items() if not reason]
    if "all are rigid, so there is nothing to reduce" in reasons["reduced"]:
        del reasons["reduced"]
    of_modes = verdict(kind, feature, Purpose.MODES) if reasons.get("reduced") == "" else ""
    why = tuple(dict.fromkeys(filter(None, (*reasons.values(), of_modes))))
    return "all" if len(having) == len(MODELS) else ", ".join(having) or "no", why


def of_command(kind: str, purpose: Purpose, *overrides: str) -> tuple[str, tuple[str, ...]]:
    """Return whether a command takes plain scenes of a kind, with some overrides, and why not."""
    try:
        scene = scene_from_toml(scene_to_toml(scene_of(kind, "nothing")), ".", overrides)
        check_capabilities(scene, purpose)
    except InputError as error:
        return "no", (str(error),)
    return "yes", ()


def table() -> str:
    reasons: list[str] = []
    rows = {feature: [cell(kind, feature) for kind in KINDS] for feature in FEATURES if feature != "nothing"}
    rows |= {name: [of_command(kind, *asked) for kind in KINDS] for name, asked in COMMANDS.items()}
    lines = [OPENING, f"| | {' | '.join(KINDS)} |", f"|{'---|' * (len(KINDS) + 1)}"]
    for name, cells in rows.items():
        shown = []
        for word, why in cells:
            reasons += [reason for reason in why if reason not in reasons]
            shown.append(" ".join([word, *(f"[{reasons.index(reason) + 1}]" for reason in why)]))
        lines.append(f"| {name} | {' | '.join(shown)} |")
    lines += ["", *(f"{number}. {reason}" for number, reason in enumerate(reasons, 1))]
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
