"""Named outputs of a scene, from the motion of a few nodes."""
