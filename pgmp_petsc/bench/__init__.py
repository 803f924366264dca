"""The test bench: settings of models run at cases of a scene, their errors and times, and what is chosen by these.

In comes a scene with its meshes (`reference.Subject`). A `history.Case` is the scene under some loads with the values
of some samples, a `history.Setting` a model with a step; `bench.Bench` runs settings at cases, dealt over ranks, and
takes up what an earlier run of the program has finished (`finished`). There is one error (`history.errors_between`),
one cost (`bench.Bench.seconds`), and one reference that says how far it may be off itself (`reference`).

Out come choices: bases, angles and steps for a tolerance (`choice`, from those of `prices`, and `step_choice`, which
says what prevents one), and what accuracy costs in time (`tradeoff`, with `advice`). Begin with `history` and `bench`.
"""
