"""Continuum bodies condensed to few unknowns: the frames of their faces, and component modes.

`condensing` takes the bodies of a scene, dealt to ranks, and is where to begin; it also puts flexible bodies, those of
beams too, into floating frames. `component_modes` condenses one with the modes and answers of its `body_problem`;
`large_deformation` adds what is of second order.
"""
