"""Controllers a scene may have: classes that are found, one a type, with states beside the mechanics.

In: a table ``[controllers.NAME]`` (`scene.controllers`). Out: a `law.ControlLaw`, the rates of the states and the force
on a joint as expressions; and `running.Controls`, which takes the states through the steps of a model. Controllers
are in `pid` and `formula`; begin with `law`.
"""
