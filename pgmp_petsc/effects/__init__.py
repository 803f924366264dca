"""Effects a scene may call for; one that it does not name is not imported, assembled, stored or evaluated. Begin with
`effect`, then `law` and `action`; `of_scene` has what acts in a scene."""

from pgmp_petsc.base import given_by

__getattr__ = given_by(
    __name__,
    {
        "action": ("Action",),
        "effect": ("Effect", "Load", "Patterns"),
        "time_function": ("Motion",),
        "of_scene": (
            "AT_REST", "actions_of", "bases_of", "effects_of", "loads_of", "motions_of", "patterns_of",
            "springs_of_joints", "start_of",
        ),
    },
)  # fmt: skip
