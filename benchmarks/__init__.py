"""Measurements beside the commands: paper, scaling, estimates of errors, costs of effects. Run from the checkout."""
